//! Quotas, rate limits and retention, through a real server process.

use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::tokens::{token, token_of, token_with, with_store};
use crate::support::{Server, photographs, text};
use fled_server::store::Quotas;
use fled_tests::Reply;
use serde_json::json;

/// The scopes of a user.
const USER: &str = "jobs:read,jobs:write,renders";

fn id(reply: &Reply) -> String {
    reply.json()["id"].as_str().expect("id").to_owned()
}

fn upload(server: &Server, header: &str) -> Reply {
    let headers = [("authorization", header)];
    server.upload("/v1/captures", &photographs(3), &headers)
}

fn order(server: &Server, capture: &str, plan: &str, header: &str) -> Reply {
    let order = json!({ "capture_id": capture, "options": { "adapter": plan } });
    server.post_json("/v1/jobs", &order, &[("authorization", header)])
}

#[test]
fn a_quota_limits_the_jobs_of_an_owner() {
    let server = Server::start();
    let quotas = Quotas { jobs: Some(1), ..Quotas::default() };
    let (anna, _) = token_with(&server, "anna", USER, quotas);
    let (ben, _) = token_of("ben", &server, USER);
    let capture = id(&upload(&server, &anna).expect(201));
    let first = id(&order(&server, &capture, "slow:100", &anna).expect(202));
    let refused = order(&server, &capture, "ok", &anna).expect(429);
    assert_eq!(refused.json()["code"], "quota_jobs");
    assert_ne!(refused.header("retry-after"), "");
    let theirs = id(&upload(&server, &ben).expect(201));
    order(&server, &theirs, "ok", &ben).expect(202);
    let headers = [("authorization", anna.as_str())];
    let cancel = format!("/v1/jobs/{first}/cancel");
    server.post(&cancel, b"", &headers).expect(202);
    order(&server, &capture, "slow:100", &anna).expect(202);
    let again = server.post(&format!("/v1/jobs/{first}/retry"), b"", &headers);
    assert_eq!(again.expect(429).json()["code"], "quota_jobs");
    let shown = server.get(&format!("/v1/jobs/{first}"), &headers);
    assert_eq!(shown.expect(200).json()["state"], "cancelled");
}

#[test]
fn a_quota_limits_the_bytes_of_an_owner() {
    let server = Server::start();
    let one: usize = photographs(3).iter().map(|part| part.2.len()).sum();
    let quotas = Quotas { bytes: Some(one as u64 + 5000), ..Quotas::default() };
    let (anna, _) = token_with(&server, "anna", USER, quotas);
    let (ben, _) = token_of("ben", &server, USER);
    let first = id(&upload(&server, &anna).expect(201));
    let refused = upload(&server, &anna).expect(507);
    assert_eq!(refused.json()["code"], "quota_bytes");
    upload(&server, &ben).expect(201);
    // Tokens of one name share captures, but each has its own quota.
    let (more, _) = token_of("anna", &server, USER);
    upload(&server, &more).expect(201);
    let refused = order(&server, &first, "ok", &anna).expect(507);
    assert_eq!(refused.json()["code"], "quota_bytes");
    order(&server, &first, "ok", &more).expect(202);
}

#[test]
fn a_repeated_request_gets_its_job_despite_the_quota() {
    let server = Server::start();
    let one: usize = photographs(3).iter().map(|part| part.2.len()).sum();
    let quotas = Quotas { bytes: Some(one as u64 + 5000), jobs: Some(1) };
    let (anna, _) = token_with(&server, "anna", USER, quotas);
    let mut parts = photographs(3);
    parts.push(text("options", r#"{"adapter":"slow:100"}"#));
    let ask = |key: &str| {
        let headers = [("authorization", anna.as_str()), ("idempotency-key", key)];
        server.upload("/v1/jobs", &parts, &headers)
    };
    let job = id(&ask("one").expect(202));
    let again = ask("one").expect(202);
    assert_eq!(again.header("idempotent-replayed"), "true");
    assert_eq!(id(&again), job);
    assert_eq!(ask("two").expect(429).json()["code"], "quota_jobs");
    server.post(&format!("/v1/jobs/{job}/cancel"), b"", &[("authorization", &anna)]).expect(202);
    assert_eq!(ask("two").expect(507).json()["code"], "quota_bytes");
}

#[test]
fn the_rate_limit_stops_only_the_client_that_exceeds_it() {
    let server = Server::start_with(&[("FLED_FAKE_RATE", "1"), ("FLED_FAKE_BURST", "20")]);
    for _ in 0..30 {
        // Without tokens, this machine's user is not limited.
        server.get("/v1/jobs", &[]).expect(200);
    }
    let (anna, _) = token_of("anna", &server, USER);
    let (ben, _) = token_of("ben", &server, USER);
    let ask = |header: &str| server.get("/v1/jobs", &[("authorization", header)]);
    let first = ask(&anna).expect(200);
    assert_eq!(first.header("ratelimit-policy"), "\"client\";q=20;w=20");
    assert!(first.header("ratelimit").starts_with("\"client\";r=19;"));
    let begin = Instant::now();
    let refused = (0..40).map(|_| ask(&anna)).find(|reply| reply.status == 429);
    let refused = refused.expect("not for ever");
    assert_eq!(refused.json()["code"], "too_many_requests");
    assert_eq!(refused.header("retry-after"), "1");
    assert!(begin.elapsed() < Duration::from_secs(20));
    let writes = server.post("/v1/jobs", b"{}", &[("authorization", &anna)]);
    writes.expect(429);
    ask(&ben).expect(200);
    // Wrong tokens count by address, and do not lock out valid ones.
    let wrong = (0..40).map(|_| ask("Bearer fled_0"));
    let statuses: Vec<u16> = wrong.map(|reply| reply.status).collect();
    assert!(statuses.contains(&401) && statuses.contains(&429), "{statuses:?}");
    ask(&ben).expect(200);
    server.get("/livez", &[]).expect(200);
    sleep(Duration::from_millis(1100));
    ask(&anna).expect(200);
}

#[test]
fn metrics_are_only_for_the_admin() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let open = server.get("/metrics", &[("x-request-id", "of-mine")]).expect(200);
    assert_eq!(open.header("x-request-id"), "of-mine");
    let metrics = open.text();
    assert!(metrics.contains("fled_jobs{state=\"succeeded\"} 1\n"), "{metrics}");
    assert!(metrics.contains("fled_jobs{state=\"queued\"} 0\n"), "{metrics}");
    let posted = "fled_requests_total{method=\"POST\",route=\"/v1/jobs\",status=\"202\"} 1\n";
    assert!(metrics.contains(posted), "{metrics}");
    assert!(metrics.contains("route=\"/v1/jobs/{id}\"") && !metrics.contains(&job));
    let (admin, _) = token(&server, "admin");
    let (anna, _) = token_of("anna", &server, USER);
    server.get("/metrics", &[]).expect(401);
    server.get("/metrics", &[("authorization", &anna)]).expect(403);
    let shown = server.get("/metrics", &[("authorization", &admin)]).expect(200);
    assert_eq!(shown.header("x-request-id").len(), 36);
    assert!(shown.text().contains("status=\"401\"} 1\n"));
}

#[test]
fn an_event_stream_ends_with_its_token() {
    let server = Server::start();
    let (admin, _) = token(&server, "admin");
    let (anna, which) = token_of("anna", &server, USER);
    let capture = id(&upload(&server, &anna).expect(201));
    let job = id(&order(&server, &capture, "slow:1000", &anna).expect(202));
    let path = format!("/v1/jobs/{job}/events");
    std::thread::scope(|scope| {
        let stream = scope.spawn(|| server.get(&path, &[("authorization", &anna)]).text());
        sleep(Duration::from_millis(500));
        let revoked = with_store(&server, async |store| store.revoke_token(&which).await);
        assert!(revoked.expect("done"));
        let ended = Instant::now();
        let events = stream.join().expect("it ends");
        assert!(events.contains("event: state"), "{events}");
        let took = ended.elapsed();
        assert!(took < Duration::from_secs(8), "{took:?}");
    });
    let shown = server.get(&format!("/v1/jobs/{job}"), &[("authorization", &admin)]);
    assert_eq!(shown.expect(200).json()["state"], "running", "it goes on");
}

#[test]
fn a_job_announces_its_expiry_and_is_deleted_unless_pinned() {
    let kept = [("FLED_FAKE_KEEP_MS", "0"), ("FLED_FAKE_NOTICE_MS", "60000")];
    let mut server = Server::start_with(&kept);
    let (goes, stays) = (server.job("ok"), server.job("ok"));
    for job in [&goes, &stays] {
        let done = server.wait_state(job, "succeeded");
        assert!(done["expires_at"].is_null() && done["pinned"] == false);
    }
    let pinned = server.put(&pin_of(&stays)).expect(200).json();
    assert_eq!(pinned["pinned"], true);
    server.put(&pin_of("none")).expect(404);
    server.restart_with(&kept);
    assert!(!server.show(&goes)["expires_at"].is_null(), "it says so");
    assert!(server.show(&stays)["expires_at"].is_null());
    // The test cannot wait for the notice period, so the deletion is called with a late time.
    with_store(&server, async |store| {
        let gone = store.delete_expired(i64::MAX, false).await.expect("deleted");
        assert_eq!(gone.jobs, std::slice::from_ref(&goes));
    });
    server.get(&format!("/v1/jobs/{goes}"), &[]).expect(404);
    assert_eq!(server.show(&stays)["state"], "succeeded");
    let let_go = server.delete_as(&pin_of(&stays), &[]).expect(200).json();
    assert_eq!(let_go["pinned"], false);
    server.restart_with(&[("FLED_FAKE_KEEP_MS", "0")]);
    server.restart_with(&[("FLED_FAKE_KEEP_MS", "0")]);
    server.get(&format!("/v1/jobs/{stays}"), &[]).expect(404);
    let folder = server.data.path().join("data/jobs").join(&stays);
    assert!(!folder.exists(), "its files went with it");
}

fn pin_of(job: &str) -> String {
    format!("/v1/jobs/{job}/pin")
}
