//! Tests of the service from another machine, over unreliable connections.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::thread::{sleep, spawn};
use std::time::Duration;

use crate::service::Server;
use crate::support::{code, fled, json, said, small_capture, succeed};

/// A proxy that cuts one connection after `up` bytes to the service and one after `down` bytes from
/// it.
struct Proxy {
    address: String,
    cuts: Arc<AtomicUsize>,
}

impl Proxy {
    fn new(to: &str, up: u64, down: u64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = format!("http://{}", listener.local_addr().expect("an address"));
        let to = to.trim_start_matches("http://").to_owned();
        let cuts = Arc::new(AtomicUsize::new(0));
        let counted = cuts.clone();
        spawn(move || {
            let left = [up, down].map(|bytes| Arc::new(AtomicU64::new(bytes)));
            for client in listener.incoming() {
                let client = client.expect("a connection");
                let service = TcpStream::connect(&to).expect("the service listens");
                for (from, to, left) in
                    [(&client, &service, &left[0]), (&service, &client, &left[1])]
                {
                    let ends = [from, to].map(|end| end.try_clone().expect("a handle"));
                    let (left, cuts) = (left.clone(), counted.clone());
                    spawn(move || pass(ends, &left, &cuts));
                }
            }
        });
        Self { address, cuts }
    }
}

/// Forwards data until the end, or until `left` bytes have passed, which happens once.
fn pass([mut from, mut to]: [TcpStream; 2], left: &AtomicU64, cuts: &AtomicUsize) {
    let mut buffer = [0; 4096];
    while let Ok(read @ 1..) = from.read(&mut buffer) {
        let before = left.load(Ordering::SeqCst);
        let now = before.saturating_sub(read as u64);
        left.store(now, Ordering::SeqCst);
        if before > 0 && now == 0 {
            cuts.fetch_add(1, Ordering::SeqCst);
            let _ = from.shutdown(Shutdown::Both);
            break;
        }
        if to.write_all(&buffer[..read]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}

fn submit(capture: &Path, server: &str, token: &str, out: &Path) -> Output {
    let mut command = submission(capture, server, token);
    command.arg("--out").arg(out).output().expect("the binary starts")
}

fn submission(capture: &Path, server: &str, token: &str) -> Command {
    let mut command = fled();
    command.arg("submit").arg(capture).args(["--server", server]);
    command.args(["--preset", "preview", "--name", "a place", "--patience", "60"]);
    for set in ["size=96", "steps=40", "cap=800", "rounds=1", "pose_source=given"] {
        command.args(["--set", set]);
    }
    command.env("FLED_TOKEN", token);
    command
}

#[test]
fn a_second_command_continues_a_submission_that_was_killed() {
    let server = Server::start();
    let capture = small_capture(server.folder.path());
    let proxy = Proxy::new(&server.base, 60_000, u64::MAX);
    let home = server.folder.path().join("home");
    let submission = || {
        let mut command = submission(&capture, &proxy.address, "");
        command.arg("--detach").env("XDG_CACHE_HOME", &home).env_remove("FLED_TOKEN");
        command
    };
    let mut first = submission().spawn().expect("the binary starts");
    while proxy.cuts.load(Ordering::SeqCst) == 0 {
        assert!(first.try_wait().expect("a child").is_none(), "it ended before the connection");
        sleep(Duration::from_millis(5));
    }
    first.kill().expect("killed");
    first.wait().expect("ended");
    let kept = |folder: &str| {
        let folder = server.folder.path().join(folder);
        std::fs::read_dir(folder).into_iter().flatten().count()
    };
    let (begun, expected) = (kept("data/uploads"), kept("home/fled/submissions"));
    assert!(begun > 0 && expected == 1, "{begun} uploads, {expected} submissions");

    let second = submission().output().expect("the binary starts");
    assert_eq!(code(&second), 0, "{}", said(&second));
    assert!(said(&second).contains("continuing an interrupted submission"), "{}", said(&second));
    assert_eq!((kept("data/uploads"), kept("home/fled/submissions")), (0, 0));
    let jobs = server.get("/v1/jobs", &[]).expect(200).json();
    assert_eq!(jobs["jobs"].as_array().map(Vec::len), Some(1), "{jobs:#}");
}

#[test]
fn capture_and_result_survive_broken_connections() {
    let server = Server::start();
    let data = server.folder.path().join("data");
    let made = succeed(fled().args(["token", "create", "--scope", "admin", "--data"]).arg(data));
    let token = String::from_utf8(made.stdout).expect("text");
    let token = token.trim();
    let capture = small_capture(server.folder.path());
    let proxy = Proxy::new(&server.base, 60_000, 200_000);
    let out = server.folder.path().join("result");

    let refused = submit(&capture, &proxy.address, "fled_0", &out);
    assert_ne!(code(&refused), 0);
    assert!(said(&refused).contains("FLED_TOKEN"), "{}", said(&refused));
    let done = submit(&capture, &proxy.address, token, &out);
    assert_eq!(code(&done), 0, "{}", said(&done));
    assert_eq!(proxy.cuts.load(Ordering::SeqCst), 2, "{}", said(&done));
    let attempts = said(&done).matches("does not respond").count();
    assert_eq!(attempts, 2, "{}", said(&done));
    assert!(said(&done).contains("round 1 is delivered"));
    let bearer = format!("Bearer {token}");
    let headers = [("authorization", bearer.as_str())];
    let jobs = server.get("/v1/jobs", &headers).expect(200).json();
    assert_eq!(jobs["jobs"].as_array().map(Vec::len), Some(1), "{jobs:#}");
    let id = String::from_utf8(done.stdout.clone()).expect("text");
    let id = id.trim();
    assert_eq!(jobs["jobs"][0]["id"], id);
    assert_eq!(json(&out.join("metrics.json"))["best_round"], 1);
    let scene = std::fs::read(out.join("scene.ply")).expect("the scene");
    let path = format!("/v1/jobs/{id}/artifacts/scene.ply");
    assert!(server.get(&path, &headers).body == scene);

    // Submitting again finds the same job, and transfers only the request.
    std::fs::remove_file(out.join("scene.ply")).expect("removed");
    let again = submit(&capture, &proxy.address, token, &out);
    assert_eq!(code(&again), 0, "{}", said(&again));
    assert!(said(&again).contains("submitted before"), "{}", said(&again));
    assert!(said(&again).contains("1 files downloaded"), "{}", said(&again));
    assert!(std::fs::read(out.join("scene.ply")).expect("the scene") == scene);

    and_with_other_options(&server, &proxy.address, token, id);
}

/// A succeeded job cannot be cancelled. A retry with other options reuses all valid results: the
/// poses are not searched for again.
fn and_with_other_options(server: &Server, address: &str, token: &str, id: &str) {
    let asked = |verb: &str, more: &[&str]| {
        let mut command = fled();
        command.args([verb, id, "--server", address]).args(more);
        command.env("FLED_TOKEN", token).output().expect("starts")
    };
    let over = asked("cancel", &[]);
    assert_ne!(code(&over), 0);
    assert!(said(&over).contains("succeeded"), "{}", said(&over));
    let typo = asked("retry", &["--set", "capp=700"]);
    assert_eq!(code(&typo), 2, "{}", said(&typo));
    let retried = asked("retry", &["--set", "cap=700"]);
    assert_eq!(code(&retried), 0, "{}", said(&retried));
    let watched = asked("watch", &[]);
    assert_eq!(code(&watched), 0, "{}", said(&watched));
    let rounds = "round 1: 700 Gaussians";
    assert!(said(&watched).contains(rounds), "{}", said(&watched));
    let bearer = format!("Bearer {token}");
    let log = format!("/v1/jobs/{id}/log");
    let log = server.get(&log, &[("authorization", &bearer)]).expect(200);
    assert!(log.text().contains("poses already done"), "{}", log.text());
}

/// A proxy that refuses requests with bodies above `largest` bytes before it reads them, as nginx
/// does, and closes every connection after one request. Counts what it refuses.
fn strict_proxy(to: &str, largest: usize) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = format!("http://{}", listener.local_addr().expect("an address"));
    let to = to.trim_start_matches("http://").to_owned();
    let refused = Arc::new(AtomicUsize::new(0));
    let counted = refused.clone();
    spawn(move || {
        for client in listener.incoming() {
            let (to, counted) = (to.clone(), counted.clone());
            spawn(move || answer(client.expect("a connection"), &to, largest, &counted));
        }
    });
    (address, refused)
}

/// Forwards one request, or refuses it.
fn answer(mut client: TcpStream, to: &str, largest: usize, refused: &AtomicUsize) {
    let mut head = Vec::new();
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") && client.read_exact(&mut byte).is_ok() {
        head.push(byte[0]);
    }
    let head = String::from_utf8(head).expect("text");
    let lines = head.lines().filter(|line| !line.is_empty());
    let (expects, lines): (Vec<_>, Vec<_>) =
        lines.partition(|line| line.to_ascii_lowercase().starts_with("expect: "));
    let length = lines.iter().find_map(|line| {
        let (name, value) = line.split_once(": ")?;
        name.eq_ignore_ascii_case("content-length").then(|| value.parse().expect("a number"))
    });
    let length: usize = length.unwrap_or(0);
    if length > largest {
        refused.fetch_add(1, Ordering::SeqCst);
        let page = b"HTTP/1.1 413 Request Entity Too Large\r\nContent-Type: text/html\r\n\
            Content-Length: 6\r\nConnection: close\r\n\r\n<html>";
        client.write_all(page).expect("sent");
        return;
    }
    if !expects.is_empty() {
        client.write_all(b"HTTP/1.1 100 Continue\r\n\r\n").expect("sent");
    }
    let mut body = vec![0; length];
    if client.read_exact(&mut body).is_err() {
        return;
    }
    let mut service = TcpStream::connect(to).expect("the service listens");
    let head = lines.join("\r\n") + "\r\nConnection: close\r\n\r\n";
    service.write_all(&[head.as_bytes(), &body].concat()).expect("sent");
    let mut reply = Vec::new();
    service.read_to_end(&mut reply).expect("an answer");
    // The client may be gone.
    let _ = client.write_all(&reply);
}

#[test]
fn a_proxy_that_limits_bodies_only_makes_pieces_smaller() {
    let server = Server::start();
    let folder = server.folder.path();
    let capture = small_capture(folder);
    let large = folder.join("large.zip");
    std::fs::write(&large, vec![7; 3 << 20]).expect("written");
    let send = |capture: &Path, largest| {
        let (address, refused) = strict_proxy(&server.base, largest);
        let sent = submit(capture, &address, "", &folder.join("out"));
        (code(&sent), said(&sent), refused.load(Ordering::SeqCst))
    };
    // The service itself has read it all, and says what is wrong with it.
    let (code, words, refused) = send(&large, 1 << 20);
    assert_eq!((code, refused), (3, 2), "{words}");
    assert!(!words.contains("proxy") && words.contains("ZIP"), "{words}");
    let uploads = std::fs::read_dir(folder.join("data/uploads")).expect("the uploads");
    assert_eq!(uploads.count(), 0, "what was refused is deleted");
    let (code, words, _) = send(&large, 100_000);
    assert_eq!(code, 4, "no fault of the capture: {words}");
    assert!(words.contains("a proxy before the server refuses even pieces of 512 KiB"), "{words}");
    assert!(words.contains("client_max_body_size"), "{words}");
    let (code, words, _) = send(&capture, 1 << 20);
    assert_eq!(code, 0, "{words}");
}
