//! Overload, through a real server process.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::{scope, sleep};
use std::time::{Duration, Instant};

use crate::support::Server;
use serde_json::json;

/// A finished job whose scene takes 700 ms per render.
fn slow_scene(server: &Server) -> String {
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let scene = format!("data/jobs/{job}/output/scene.ply");
    std::fs::write(server.data.path().join(scene), "slow").expect("written");
    job
}

#[test]
fn renders_of_disconnected_clients_are_dropped() {
    let server = Server::start();
    let job = slow_scene(&server);
    let address = server.base.trim_start_matches("http://");
    let asked: Vec<TcpStream> = (0..32)
        .map(|i| {
            let mut stream = TcpStream::connect(address).expect("connect");
            let path = format!("/v1/jobs/{job}/render?azimuth={i}");
            write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").expect("request");
            stream
        })
        .collect();
    sleep(Duration::from_millis(300));
    let busy = server.get(&format!("/v1/jobs/{job}/render?azimuth=100"), &[]).expect(503);
    assert_eq!(busy.json()["code"], "busy");
    assert!(!busy.header("retry-after").is_empty());
    drop(asked);
    sleep(Duration::from_millis(300));
    let start = Instant::now();
    server.get(&format!("/v1/jobs/{job}/render?azimuth=200"), &[]).expect(200);
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    let renders = server.data.path().join(format!("data/jobs/{job}/renders"));
    let half: Vec<_> = std::fs::read_dir(renders)
        .expect("folder")
        .flatten()
        .filter(|entry| entry.path().extension().is_some_and(|e| e == "tmp"))
        .collect();
    assert!(half.is_empty(), "{half:?}");
}

#[test]
fn concurrent_renders_are_all_answered() {
    let server = Server::start();
    let job = slow_scene(&server);
    scope(|scope| {
        for i in 0..4 {
            let path = format!("/v1/jobs/{job}/render?azimuth={i}");
            let server = &server;
            scope.spawn(move || server.get(&path, &[]).expect(200));
        }
    });
}

#[test]
fn a_full_queue_answers_503_with_retry_after() {
    let server = Server::start_with(&[("FLED_FAKE_QUEUE", "2")]);
    let capture = server.capture(3);
    let order = json!({ "capture_id": capture, "options": { "adapter": "slow:300" } });
    let submit = || server.post_json("/v1/jobs", &order, &[]);
    for _ in 0..2 {
        let job = submit().expect(202).json()["id"].as_str().expect("id").to_owned();
        server.wait(&job, "running", |shown| shown["state"] == "running");
    }
    let waiting = submit().expect(202).json();
    submit().expect(202);
    let refused = submit().expect(503);
    assert_eq!(refused.header("retry-after"), "60");
    assert_eq!(refused.json()["code"], "queue_full");
    let parts = crate::support::photographs(1);
    server.upload("/v1/jobs", &parts, &[]).expect(503);
    let id = waiting["id"].as_str().expect("id");
    server.post(&format!("/v1/jobs/{id}/cancel"), b"", &[]).expect(202);
    submit().expect(202);
}

#[test]
fn a_retry_needs_a_place_in_the_queue() {
    let server = Server::start_with(&[("FLED_FAKE_QUEUE", "1")]);
    let failed = server.job("few_poses");
    server.wait_state(&failed, "failed");
    let running = [server.job("slow:300"), server.job("slow:300")];
    for job in &running {
        server.wait(job, "running", |shown| shown["state"] == "running");
    }
    let waiting = server.job("slow:300");
    let retry = format!("/v1/jobs/{failed}/retry");
    let refused = server.post(&retry, b"", &[]).expect(503);
    assert_eq!(refused.header("retry-after"), "60");
    assert_eq!(refused.json()["code"], "queue_full");
    assert_eq!(server.show(&failed)["state"], "failed");
    server.post(&format!("/v1/jobs/{waiting}/cancel"), b"", &[]).expect(202);
    server.post(&retry, b"", &[]).expect(202);
}

/// Requests a view from another loopback address.
fn ask_from(source: &str, server: &Server, path: &str) -> TcpStream {
    let address = server.base.trim_start_matches("http://");
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_io().build().expect("runtime");
    let stream = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().expect("socket");
        let source = format!("{source}:0").parse().expect("address");
        socket.bind(source).expect("bind");
        let stream = socket.connect(address.parse().expect("address")).await;
        stream.expect("connect").into_std().expect("standard")
    });
    stream.set_nonblocking(false).expect("set");
    let mut stream = stream;
    let head = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(head.as_bytes()).expect("request");
    stream
}

#[test]
fn one_clients_many_renders_do_not_block_another_client() {
    let server = Server::start();
    let job = slow_scene(&server);
    let path = |i: i32| format!("/v1/jobs/{job}/render?azimuth={i}");
    let many: Vec<TcpStream> = (0..40).map(|i| ask_from("127.0.0.1", &server, &path(i))).collect();
    sleep(Duration::from_millis(300));
    let start = Instant::now();
    let mut answer = Vec::new();
    ask_from("127.0.0.2", &server, &path(100)).read_to_end(&mut answer).expect("an answer");
    assert!(answer.starts_with(b"HTTP/1.1 200"), "{answer:?}");
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    drop(many);
}

#[test]
fn a_job_that_brings_down_its_server_finally_fails() {
    let mut server = Server::start();
    let job = server.job("silent");
    for _ in 0..5 {
        server.wait(&job, "running", |shown| shown["state"] == "running");
        server.restart();
    }
    let failed = server.wait_state(&job, "failed");
    assert_eq!(failed["attempts"], 5);
    let detail = failed["error"]["detail"].as_str().expect("detail");
    assert!(detail.contains("server died") && detail.contains("5 times"), "{detail}");
    server.post(&format!("/v1/jobs/{job}/retry"), b"", &[]).expect(202);
    server.wait(&job, "running", |shown| shown["state"] == "running");
}

#[test]
fn a_restart_is_named_and_memory_is_not_blamed_for_it() {
    let mut server = Server::start();
    let job = server.job("slow:30");
    server.wait(&job, "running", |shown| shown["state"] == "running");
    server.restart();
    server.wait_state(&job, "succeeded");
    let log = server.get(&format!("/v1/jobs/{job}/log"), &[]).expect(200).text();
    assert!(log.contains("continued after a restart of the server"), "{log}");
    let events = server.events(&job, 0, usize::MAX);
    let error = events.iter().find_map(|(_, _, data)| data.get("error")).expect("the restart");
    assert_eq!(error["detail"], "continued after a restart of the server");
    assert!(!error.to_string().to_lowercase().contains("memory"), "{error}");
}
