//! Clients that keep the server waiting, through a real server process.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::Server;

fn connect(server: &Server) -> TcpStream {
    let address = server.base.trim_start_matches("http://");
    let stream = TcpStream::connect(address).expect("connect");
    let patience = Some(Duration::from_secs(10));
    stream.set_read_timeout(patience).expect("set");
    stream
}

/// Waits until the server has closed the connection, and returns how long that took.
fn closed(mut stream: TcpStream) -> Duration {
    let start = Instant::now();
    let mut rest = Vec::new();
    match stream.read_to_end(&mut rest) {
        Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => panic!("still open"),
        // Closed, or reset.
        _ => start.elapsed(),
    }
}

#[test]
fn silent_and_half_open_requests_are_closed() {
    let server = Server::start_with(&[("FLED_FAKE_HEADER_MS", "700")]);
    let silent = connect(&server);
    let mut half = connect(&server);
    half.write_all(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n").expect("half");
    let mut idle = connect(&server);
    idle.write_all(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("request");
    for stream in [silent, half, idle] {
        let waited = closed(stream);
        assert!(waited < Duration::from_secs(5), "{waited:?}");
    }
}

#[test]
fn a_trickling_body_times_out() {
    let server = Server::start_with(&[("FLED_FAKE_STALL_MS", "700")]);
    let mut stream = connect(&server);
    stream
        .write_all(
            b"POST /v1/captures HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\
              Content-Type: multipart/form-data; boundary=XXXX\r\n\r\n--XXXX\r\n",
        )
        .expect("head");
    let start = Instant::now();
    // One byte at a time, so that no pause is long.
    while start.elapsed() < Duration::from_secs(8) {
        sleep(Duration::from_millis(100));
        if stream.write_all(b"a").is_err() {
            break;
        }
    }
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    let incoming = server.data.path().join("data/incoming");
    let left = std::fs::read_dir(incoming).expect("folder").count();
    assert_eq!(left, 0, "a given up upload leaves files");
}

#[test]
fn an_unread_answer_times_out() {
    let limits = [("FLED_FAKE_STALL_MS", "700"), ("FLED_FAKE_CONNECTIONS", "1")];
    let server = Server::start_with(&limits);
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    // Larger than any buffer.
    let scene = format!("data/jobs/{job}/output/scene.ply");
    std::fs::write(server.data.path().join(scene), vec![7; 64 << 20]).expect("written");
    let path = format!("/v1/jobs/{job}/artifacts/scene.ply");
    let mut stream = connect(&server);
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("request");
    sleep(Duration::from_secs(4));
    // The only place is free again.
    let mut other = connect(&server);
    write!(other, "GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("request");
    let mut head = [0; 15];
    other.read_exact(&mut head).expect("an answer");
    assert_eq!(&head, b"HTTP/1.1 200 OK");
    drop(stream);
}

#[test]
fn idle_connections_make_room_for_new_ones() {
    // Fewer descriptors than places.
    let server = Server::start_with(&[("FLED_FAKE_DESCRIPTORS", "200")]);
    let idle: Vec<TcpStream> = (0..300).map(|_| connect(&server)).collect();
    for _ in 0..3 {
        let start = Instant::now();
        server.get("/livez", &[]).expect(200);
        assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
    }
    drop(idle);
}

#[test]
fn active_requests_keep_their_places_and_others_get_503() {
    let server = Server::start_with(&[("FLED_FAKE_CONNECTIONS", "3")]);
    let job = server.job("slow:100");
    let path = format!("GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let mut streams: Vec<TcpStream> = (0..3).map(|_| connect(&server)).collect();
    for stream in &mut streams {
        stream.write_all(path.as_bytes()).expect("request");
        let mut head = [0; 15];
        stream.read_exact(&mut head).expect("an answer");
        assert_eq!(&head, b"HTTP/1.1 200 OK");
    }
    let mut refused = String::new();
    connect(&server).read_to_string(&mut refused).expect("reported");
    assert!(refused.starts_with("HTTP/1.1 503") && refused.contains("Retry-After"), "{refused}");
    assert!(refused.contains("application/problem+json"), "{refused}");
    assert!(refused.contains("too_many_connections"), "{refused}");
    drop(streams);
    sleep(Duration::from_millis(500));
    server.get("/livez", &[]).expect(200);
}

#[test]
fn a_client_that_sends_everything_first_reads_the_refusal() {
    let full = Server::start_with(&[("FLED_FAKE_MIN_FREE", "1152921504606846976")]);
    let queue = Server::start_with(&[("FLED_FAKE_QUEUE", "0")]);
    for (server, path, status) in [
        (&full, "/v1/captures", "507"),
        (&queue, "/v1/jobs", "503"),
        // An unknown job; a body of another type.
        (&queue, "/v1/jobs/none/render", "413"),
    ] {
        let mut stream = connect(server);
        let kind = match status {
            "413" => "application/json",
            _ => "multipart/form-data; boundary=XXXX",
        };
        let total = 24 << 20;
        write!(
            stream,
            "POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {total}\r\n\
             Content-Type: {kind}\r\n\r\n"
        )
        .expect("head");
        let body = vec![b'a'; total];
        stream.write_all(&body).expect("the server takes what it refuses");
        let mut answer = [0; 12];
        stream.read_exact(&mut answer).expect("an answer");
        let answer = String::from_utf8_lossy(&answer);
        assert_eq!(answer, format!("HTTP/1.1 {status}"), "{path}");
    }
}

#[test]
fn a_refused_endless_upload_is_cut_off() {
    let server = Server::start_with(&[("FLED_FAKE_QUEUE", "0")]);
    let mut stream = connect(&server);
    let total = 1_u64 << 30;
    write!(
        stream,
        "POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: {total}\r\n\
         Content-Type: multipart/form-data; boundary=XXXX\r\n\r\n"
    )
    .expect("head");
    let body = vec![b'a'; 1 << 20];
    let taken = (0..total >> 20).take_while(|_| stream.write_all(&body).is_ok());
    let taken = taken.count();
    // The buffers at both ends hold more data.
    assert!(taken < 200, "{taken} MiB");
}
