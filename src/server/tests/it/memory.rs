//! Uploads that try to exhaust memory, through a real server process.

use std::io::{ErrorKind, Write};
use std::net::TcpStream;

use crate::support::{Server, file, photographs, text};

const MIB: u64 = 1 << 20;

#[test]
fn a_text_field_of_300_mb_is_refused_without_buffering() {
    let server = Server::start();
    server.upload("/v1/captures?dry_run", &photographs(3), &[]).expect(200);
    let before = server.peak_memory();
    for head in [
        // A field that does not end, a header that does not end, and no header at all.
        "--XXXX\r\nContent-Disposition: form-data; name=\"name\"\r\n\r\n",
        "--XXXX\r\nContent-Disposition: form-data; name=\"images\"; filename=\"",
        "",
    ] {
        pour(&server, head.as_bytes(), 300 * MIB);
        let grown = server.peak_memory() - before;
        assert!(grown < 40 * MIB, "{} MiB more for {head:?}", grown / MIB);
    }
    server.get("/livez", &[]).expect(200);
}

/// Sends the head of a multipart body and then letters, until the server stops reading.
fn pour(server: &Server, head: &[u8], bytes: u64) {
    let address = server.base.trim_start_matches("http://");
    let mut stream = TcpStream::connect(address).expect("connect");
    let total = bytes + head.len() as u64;
    let request = format!(
        "POST /v1/captures HTTP/1.1\r\nHost: {address}\r\nContent-Length: {total}\r\n\
         Content-Type: multipart/form-data; boundary=XXXX\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).expect("request");
    stream.write_all(head).expect("head");
    let letters = vec![b'a'; 1 << 20];
    for _ in 0..bytes / MIB {
        match stream.write_all(&letters) {
            Err(error)
                if matches!(error.kind(), ErrorKind::BrokenPipe | ErrorKind::ConnectionReset) =>
            {
                return;
            }
            outcome => outcome.expect("send"),
        }
    }
}

#[test]
fn names_parts_and_fields_are_bounded() {
    let server = Server::start();
    let refused = |path: &str, more: crate::support::Part, pointer: &str| {
        let mut parts = photographs(3);
        parts.push(more);
        let problem = server.upload(path, &parts, &[]).expect(422).json();
        assert_eq!(problem["pointer"], pointer, "{problem:#}");
    };
    refused("/v1/jobs", text("presett", "preview"), "/presett");
    refused("/v1/captures", text("preset", "preview"), "/preset");
    refused("/v1/captures", text("name", &"x".repeat(60_000)), "/name");
    refused("/v1/jobs", text("name", &"x".repeat(201)), "/name");
    let stray = ("phots".to_owned(), Some("a.png".to_owned()), vec![1]);
    refused("/v1/captures", stray, "/phots");
    let order = serde_json::json!({ "capture_id": server.capture(3), "name": "x".repeat(201) });
    let problem = server.post_json("/v1/jobs", &order, &[]).expect(422).json();
    assert_eq!(problem["pointer"], "/name");
    let mut parts = photographs(3);
    parts.push(file(&"x".repeat(60_000), b"x"));
    server.upload("/v1/captures", &parts, &[]).expect(422);
    // Equal names cost no more than different ones.
    let start = std::time::Instant::now();
    let equal = vec![file("a.png", b"no picture"); 12_000];
    server.upload("/v1/captures", &equal, &[]).expect(422);
    assert!(start.elapsed().as_secs() < 15, "{:?}", start.elapsed());
}
