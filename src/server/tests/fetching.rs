//! Captures that the server fetches itself: from where it may, and not from anywhere else.

mod support;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_tests::Reply;
use serde_json::json;
use support::tokens::token_with;
use support::{Server, photograph, zip};

/// Serves what a path stands for, and counts who asks.
struct Source {
    url: String,
    asked: Arc<AtomicUsize>,
}

/// What is answered to a path: the head's lines, the body, and whether it stays silent then.
type Answers = fn(&str) -> (String, Vec<u8>, bool);

fn source(answers: Answers) -> Source {
    let listener = TcpListener::bind("127.0.0.1:0").expect("bound");
    let url = format!("http://{}", listener.local_addr().expect("an address"));
    let asked = Arc::new(AtomicUsize::new(0));
    let count = asked.clone();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let count = count.clone();
            std::thread::spawn(move || serve(&stream.expect("a connection"), answers, &count));
        }
    });
    Source { url, asked }
}

fn serve(mut stream: &TcpStream, answers: Answers, asked: &AtomicUsize) {
    let mut reader = BufReader::new(stream);
    let mut first = String::new();
    if reader.read_line(&mut first).is_err() || first.is_empty() {
        return;
    }
    let mut line = String::new();
    while reader.read_line(&mut line).is_ok_and(|read| read > 2) {
        line.clear();
    }
    asked.fetch_add(1, Ordering::SeqCst);
    let path = first.split(' ').nth(1).unwrap_or_default();
    let (head, body, is_silent) = answers(path);
    // The server hangs up where it has read enough.
    let _ = stream.write_all(format!("HTTP/1.1 {head}\r\nconnection: close\r\n\r\n").as_bytes());
    let _ = stream.write_all(&body);
    if is_silent {
        let _ = stream.read(&mut [0]);
    }
}

fn ok(body: Vec<u8>) -> (String, Vec<u8>, bool) {
    (
        format!("200 OK\r\ncontent-length: {}", body.len()),
        body,
        false,
    )
}

/// Photographs by number, one zip, and what is wrong with others.
fn answers(path: &str) -> (String, Vec<u8>, bool) {
    let plain = |status: &str| (format!("{status}\r\ncontent-length: 0"), Vec::new(), false);
    match path {
        "/walk/%31.png" => ok(photograph(1)),
        "/walk/images/2.png?signature=abc" => ok(photograph(2)),
        "/walk/..%2F..%2F3.png" => ok(photograph(3)),
        "/walk.zip" => {
            let files: Vec<(&str, Vec<u8>)> = (0..)
                .zip(["a.png", "b.png", "c.png"])
                .map(|(seed, name)| (name, photograph(seed)))
                .collect();
            ok(zip(&files))
        }
        "/moved.zip" => (
            "302 Found\r\nlocation: /walk.zip\r\ncontent-length: 0".to_owned(),
            Vec::new(),
            false,
        ),
        "/cut.zip" => (
            "200 OK\r\ncontent-length: 5000".to_owned(),
            vec![7; 1000],
            false,
        ),
        "/silent.zip" => (
            "200 OK\r\ncontent-length: 5000".to_owned(),
            vec![7; 1000],
            true,
        ),
        "/announced.zip" => (
            "200 OK\r\ncontent-length: 9000000".to_owned(),
            vec![7; 10],
            true,
        ),
        "/endless.zip" => ("200 OK".to_owned(), vec![7; 9_000_000], false),
        _ => plain("404 Not Found"),
    }
}

fn server(source: &Source, more: &[(&str, &str)]) -> Server {
    let mut limits = vec![("FLED_FAKE_IMPORT_FROM", &*source.url)];
    limits.extend(more);
    Server::start_with(&limits)
}

fn ask(server: &Server, urls: &[String]) -> Reply {
    server.post_json(
        "/v1/captures",
        &json!({ "urls": urls, "name": "fetched" }),
        &[],
    )
}

/// The code of a refusal, and what of the request is at fault.
fn refused(server: &Server, url: &str) -> (String, String) {
    let problem = ask(server, &[url.to_owned()]).expect(422).json();
    let text = |key: &str| problem[key].as_str().unwrap_or_default().to_owned();
    (text("code"), text("pointer"))
}

fn incoming(server: &Server) -> usize {
    let folder = server.data.path().join("data/incoming");
    std::fs::read_dir(folder).expect("folder").count()
}

#[test]
fn photographs_and_a_zip_are_fetched_and_kept_as_if_they_were_sent() {
    let source = source(answers);
    let server = server(&source, &[]);
    let paths = [
        "/walk/%31.png",
        "/walk/images/2.png?signature=abc",
        "/walk/..%2F..%2F3.png",
    ];
    let urls = paths.map(|path| format!("{}{path}", source.url));
    let capture = ask(&server, &urls).expect(201).json();
    assert_eq!(capture["accepted"], 3, "{capture:#}");
    assert_eq!(capture["name"], "fetched");
    let id = capture["id"].as_str().expect("id");
    let folder = server.data.path().join("data/captures").join(id);
    for (seed, name) in (1..).zip(["1.png", "2.png", "3.png"]) {
        let kept = std::fs::read(folder.join("images").join(name)).expect(name);
        assert!(kept == photograph(seed), "{name} is another file");
    }
    let zip = ask(&server, &[format!("{}/walk.zip", source.url)]).expect(201);
    assert_eq!(zip.json()["accepted"], 3);
    assert_eq!(incoming(&server), 0);
}

#[test]
fn nothing_is_fetched_from_where_nobody_allowed_it() {
    let (source, other) = (source(answers), source(answers));
    let port = source.url.rsplit(':').next().expect("a port").to_owned();
    // The same server under its name, which could come to stand for anything.
    let named = format!("http://localhost:{port}");
    let server = server(
        &source,
        &[("FLED_FAKE_IMPORT_FROM", &format!("{} {named}", source.url))],
    );
    let cases = [
        (format!("{}/walk.zip", other.url), "source_not_allowed"),
        (
            format!("https://127.0.0.1:{port}/walk.zip"),
            "source_not_allowed",
        ),
        (
            "http://169.254.169.254/latest/meta-data".to_owned(),
            "source_not_allowed",
        ),
        ("file:///etc/passwd".to_owned(), "bad_url"),
        (format!("http://127.0.0.1:{port}@example.org/"), "bad_url"),
        // Allowed by name, and the name stands for an inner address.
        (format!("{named}/walk.zip"), "not_fetched"),
        (format!("{}/moved.zip", source.url), "not_fetched"),
        (format!("{}/nothing.zip", source.url), "not_fetched"),
    ];
    for (url, code) in cases {
        assert_eq!(
            refused(&server, &url),
            (code.to_owned(), "/urls/0".to_owned()),
            "{url}"
        );
    }
    assert_eq!(other.asked.load(Ordering::SeqCst), 0, "it was asked");
    assert_eq!(
        source.asked.load(Ordering::SeqCst),
        2,
        "moved and missing, no more"
    );
    assert_eq!(incoming(&server), 0);
    let none = Server::start();
    let url = format!("{}/walk.zip", source.url);
    assert_eq!(
        refused(&none, &url),
        ("no_imports".to_owned(), "/urls".to_owned())
    );
}

#[test]
fn neither_or_both_is_no_capture() {
    let source = source(answers);
    let server = server(&source, &[]);
    let bodies = [
        json!({}),
        json!({ "urls": [] }),
        json!({ "urls": ["x"], "uploads": ["x"] }),
    ];
    for body in bodies {
        server.post_json("/v1/captures", &body, &[]).expect(422);
    }
}

#[test]
fn what_is_cut_silent_or_too_large_is_refused_and_leaves_nothing() {
    let source = source(answers);
    let limits = [
        ("FLED_FAKE_UPLOAD_BYTES", "4000000"),
        ("FLED_FAKE_STALL_MS", "700"),
    ];
    let server = server(&source, &limits);
    let url = |path: &str| format!("{}{path}", source.url);
    for path in ["/cut.zip", "/silent.zip"] {
        let start = Instant::now();
        assert_eq!(refused(&server, &url(path)).0, "not_fetched", "{path}");
        assert!(start.elapsed() < Duration::from_secs(5), "{path}");
    }
    for path in ["/announced.zip", "/endless.zip"] {
        let start = Instant::now();
        ask(&server, &[url(path)]).expect(413);
        assert!(start.elapsed() < Duration::from_secs(5), "{path}");
    }
    assert_eq!(incoming(&server), 0);
}

#[test]
fn a_quota_holds_for_what_is_fetched() {
    let source = source(answers);
    let server = server(&source, &[]);
    let quotas = fled_server::store::Quotas {
        bytes: Some(2_000_000),
        ..Default::default()
    };
    let (token, _) = token_with(&server, "small", "jobs:read,jobs:write", quotas);
    let body = json!({ "urls": [format!("{}/endless.zip", source.url)] });
    let reply = server.post_json("/v1/captures", &body, &[("authorization", &token)]);
    assert_eq!(reply.expect(507).json()["code"], "quota_bytes");
}

#[test]
fn a_turn_comes_back_when_the_client_hangs_up() {
    let source = source(answers);
    let limits = [("FLED_FAKE_FETCHING", "1"), ("FLED_FAKE_STALL_MS", "2000")];
    let server = server(&source, &limits);
    let body = json!({ "urls": [format!("{}/silent.zip", source.url)] }).to_string();
    let address = server.base.trim_start_matches("http://");
    let mut client = TcpStream::connect(address).expect("connect");
    let head = format!(
        "POST /v1/captures HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\n\r\n{body}",
        body.len()
    );
    client.write_all(head.as_bytes()).expect("sent");
    let start = Instant::now();
    while source.asked.load(Ordering::SeqCst) == 0 {
        assert!(start.elapsed() < Duration::from_secs(20), "it is not asked");
        sleep(Duration::from_millis(10));
    }
    let walk = [format!("{}/walk.zip", source.url)];
    let busy = ask(&server, &walk).expect(503);
    assert_eq!(busy.json()["code"], "busy");
    assert!(busy.header("retry-after").parse::<u32>().is_ok());
    drop(client);
    let start = Instant::now();
    while ask(&server, &walk).status != 201 {
        assert!(
            start.elapsed() < Duration::from_secs(20),
            "the turn is lost"
        );
        sleep(Duration::from_millis(100));
    }
    assert_eq!(incoming(&server), 0);
}
