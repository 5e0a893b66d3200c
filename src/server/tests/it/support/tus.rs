//! A client for resumable uploads.

use std::io::{Read, Write};
use std::net::TcpStream;

use fled_tests::Reply;

use super::Server;

/// The media type of a piece.
pub const PIECE: (&str, &str) = ("content-type", "application/offset+octet-stream");
/// `walk.png` in upload metadata.
pub const NAMED: (&str, &str) = ("upload-metadata", "filename d2Fsay5wbmc=");

pub struct Tus<'a> {
    server: &'a Server,
    token: Option<&'a str>,
}

impl<'a> Tus<'a> {
    pub fn new(server: &'a Server) -> Self {
        let token = None;
        Self { server, token }
    }

    pub fn of(server: &'a Server, token: &'a str) -> Self {
        let token = Some(token);
        Self { server, token }
    }

    /// Sends a request with the protocol's version.
    pub fn ask(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Reply {
        let mut all = vec![("tus-resumable", "1.0.0")];
        all.extend(self.token.map(|token| ("authorization", token)));
        all.extend(headers);
        let reply = self.server.ask(method, path, &all, body);
        assert_eq!(reply.header("tus-resumable"), "1.0.0", "{method} {path}");
        reply
    }

    /// Requests a new upload of this length.
    pub fn begin(&self, name: &str, length: usize) -> Reply {
        let metadata = format!("filename {}", base64(name.as_bytes()));
        let length = length.to_string();
        let headers = [("upload-metadata", &*metadata), ("upload-length", &*length)];
        self.ask("POST", "/v1/uploads", &headers, b"")
    }

    /// Creates an upload, and returns its path.
    pub fn create(&self, name: &str, length: usize) -> String {
        let reply = self.begin(name, length).expect(201);
        reply.location()
    }

    pub fn patch(&self, path: &str, offset: usize, body: &[u8]) -> Reply {
        let offset = offset.to_string();
        let headers = [PIECE, ("upload-offset", &*offset)];
        self.ask("PATCH", path, &headers, body)
    }

    pub fn head(&self, path: &str) -> Reply {
        self.ask("HEAD", path, &[], b"")
    }

    /// The offset of an upload.
    #[track_caller]
    pub fn offset(&self, path: &str) -> usize {
        let reply = self.head(path).expect(200);
        reply.header("upload-offset").parse().expect("a number")
    }

    /// Sends a complete upload in two pieces, and returns its id.
    pub fn upload(&self, name: &str, content: &[u8]) -> String {
        let path = self.create(name, content.len());
        let (first, rest) = content.split_at(content.len() / 2);
        self.patch(&path, 0, first).expect(204);
        self.patch(&path, first.len(), rest).expect(204);
        path.trim_start_matches("/v1/uploads/").to_owned()
    }

    /// Opens a connection that sends `body` of a piece of `announced` bytes, and then stalls.
    pub fn hanging(&self, path: &str, further: &str, announced: usize, body: &[u8]) -> TcpStream {
        let address = self.server.base.trim_start_matches("http://");
        let mut stream = TcpStream::connect(address).expect("connect");
        let length = announced;
        write!(
            stream,
            "PATCH {path} HTTP/1.1\r\nHost: {address}\r\nTus-Resumable: 1.0.0\r\n\
             Content-Type: application/offset+octet-stream\r\nContent-Length: {length}\r\n\
             {further}\r\n"
        )
        .expect("head");
        stream.write_all(body).expect("body");
        stream
    }
}

/// The status of the answer on a connection.
pub fn status(stream: &mut TcpStream) -> String {
    let mut head = [0; 12];
    stream.read_exact(&mut head).expect("an answer");
    String::from_utf8_lossy(&head[9..]).into_owned()
}

pub fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let padded = [group, &[0, 0][..3 - group.len()]].concat();
        let number = padded.iter().fold(0, |sum, byte| sum << 8 | usize::from(*byte));
        for digit in 0..4 {
            let place = number >> (18 - 6 * digit) & 63;
            text.push(if digit > group.len() { '=' } else { char::from(DIGITS[place]) });
        }
    }
    text
}
