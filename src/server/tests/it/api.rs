//! The API as a whole through a real server process: origins, lists, health.

use std::io::{Read, Write};
use std::net::TcpStream;

use crate::support::{Server, photographs, text};

#[test]
fn pages_of_other_sites_cannot_start_jobs() {
    let server = Server::start();
    let evil = [("origin", "https://evil.example"), ("sec-fetch-site", "cross-site")];
    // A small body: the refusal comes before it is read.
    let refused = server.upload("/v1/jobs", &[text("name", "evil")], &evil);
    assert_eq!(refused.expect(403).json()["code"], "cross_origin");
    let own = [("origin", server.base.as_str())];
    server.upload("/v1/captures", &photographs(3), &own).expect(201);
}

#[test]
fn a_foreign_host_name_is_refused() {
    let server = Server::start();
    let rebound = [("host", "evil:8080"), ("origin", "http://evil:8080")];
    let parts = [text("name", "evil")];
    let problem = server.upload("/v1/jobs", &parts, &rebound).expect(421);
    assert_eq!(problem.json()["code"], "unknown_host");
    server.get("/v1/jobs", &rebound).expect(421);
    server.get("/v1/jobs", &[("host", "fled.test")]).expect(200);
    let address = server.base.trim_start_matches("http://");
    let mut stream = TcpStream::connect(address).expect("connected");
    let nameless = b"GET /v1/jobs HTTP/1.1\r\nConnection: close\r\n\r\n";
    stream.write_all(nameless).expect("asked");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("answered");
    assert!(answer.starts_with("HTTP/1.1 400"), "{answer}");
    assert!(answer.contains("application/problem+json"), "{answer}");
    server.get("/v1/jobs", &[("host", "localhost:1")]).expect(200);
}

#[test]
fn lists_are_paged_without_gaps_and_filtered_by_state() {
    let server = Server::start();
    let mut jobs: Vec<String> = (0..3).map(|_| server.job("ok")).collect();
    let failed = server.job("few_poses");
    jobs.push(failed.clone());
    jobs.reverse();
    server.wait_state(&failed, "failed");
    let (mut seen, mut cursor) = (Vec::new(), String::new());
    loop {
        let page = server.get(&format!("/v1/jobs?limit=2{cursor}"), &[]).expect(200).json();
        seen.extend(
            page["jobs"]
                .as_array()
                .expect("jobs")
                .iter()
                .filter_map(|job| job["id"].as_str().map(str::to_owned)),
        );
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    assert_eq!(seen, jobs);
    let page = server.get("/v1/jobs?state=failed", &[]).expect(200).json();
    assert_eq!(page["jobs"].as_array().map(Vec::len), Some(1));
    for (query, pointer) in [
        ("state=done", "/state"),
        ("stat=failed", "/stat"),
        ("limit=many", "/limit"),
        ("limit=1&limit=1", "/limit"),
        ("cursor=zzz", "/cursor"),
        ("capture_id=zzz", "/capture_id"),
    ] {
        let refused = server.get(&format!("/v1/jobs?{query}"), &[]).expect(422).json();
        assert_eq!(refused["pointer"], pointer, "{refused:#}");
        let detail = refused["detail"].as_str().expect("detail");
        assert!(!detail.contains("deserialize") && !detail.contains("expected"), "{detail}");
    }
    server.get("/v1/captures?cursor=zzz", &[]).expect(422);
}

#[test]
fn text_is_compressed_and_files_with_ranges_are_not() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let artifact = format!("/v1/jobs/{job}/artifacts/metrics.json");
    let script = "/assets/main.js";
    for (path, wanted) in
        [("/v1/jobs", "gzip"), ("/openapi.yaml", "gzip"), (script, "gzip"), (&artifact, "")]
    {
        let coding = |accepted: &str| {
            let reply = server.get(path, &[("accept-encoding", accepted)]).expect(200);
            reply.header("content-encoding").to_owned()
        };
        assert_eq!(coding("gzip"), wanted, "{path}");
        assert_eq!(coding("identity"), "", "{path}");
    }
}

#[test]
fn a_page_size_out_of_range_is_refused() {
    let server = Server::start();
    for (path, most) in [("/v1/jobs", 200), ("/v1/captures", 200)] {
        for limit in [0, most + 1] {
            let problem = server.get(&format!("{path}?limit={limit}"), &[]);
            assert_eq!(problem.expect(422).json()["pointer"], "/limit", "{path}");
        }
        server.get(&format!("{path}?limit={most}"), &[]).expect(200);
    }
    let log = format!("/v1/jobs/{}/log?limit=", server.job("ok"));
    server.get(&format!("{log}5000"), &[]).expect(200);
    server.get(&format!("{log}5001"), &[]).expect(422);
}

#[test]
fn readiness_reports_what_is_missing_and_what_to_do() {
    let server = Server::start();
    assert_eq!(server.get("/livez", &[]).expect(200).text(), "ok\n");
    let ready = server.get("/readyz", &[]).expect(503).json();
    let checks = ready["checks"].as_array().expect("checks");
    let check = |name: &str| checks.iter().find(|check| check["name"] == name).expect("checked");
    assert_eq!(
        (&check("database")["ok"], &check("disk")["ok"], &check("adapter")["ok"]),
        (&true.into(), &true.into(), &true.into())
    );
    assert_eq!(check("colmap")["hint"], "apt-get install colmap");
    assert_eq!(ready["has_gpu"], false, "as the child process says");
    let page = server.get("/", &[]).expect(200);
    assert!(page.header("content-security-policy").contains("default-src 'none'"));
    assert!(page.text().contains("<title>fled</title>"));
    assert!(page.header("content-security-policy").contains("frame-ancestors 'none'"));
    let embedded = server.get("/embed", &[]).expect(200);
    assert!(embedded.header("content-security-policy").contains("frame-ancestors *"));
    let missing = server.get("/nowhere", &[]).expect(404);
    assert_eq!(missing.header("content-type"), "application/problem+json");
    assert!(server.get("/openapi.yaml", &[]).expect(200).text().starts_with("openapi: 3.1"));
}
