//! Share links, through a real server process.

use crate::support::Server;
use crate::support::tokens::{token_of, token_until, with_store};
use fled_server::store::{NewShare, now_ms};
use fled_server::token::{Secret, new_id};
use fled_tests::Reply;
use serde_json::{Value, json};

const MAKES: &str = "jobs:read,jobs:write,renders";

/// A server with a finished job, created before any token: only `admin` sees it.
fn server_with_job() -> (Server, String) {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    (server, job)
}

fn make(server: &Server, job: &str, header: &str, wanted: &Value) -> Reply {
    let path = format!("/v1/jobs/{job}/shares");
    server.post_json(&path, wanted, &[("authorization", header)])
}

/// Creates a link, and returns its header and its id.
fn link(server: &Server, job: &str, header: &str) -> (String, String) {
    let made = make(server, job, header, &json!({})).expect(201).json();
    let text = |key: &str| made[key].as_str().expect(key).to_owned();
    let token = text("token");
    assert_eq!(text("path"), format!("/#/share/{job}/{token}"));
    (format!("Bearer {token}"), text("id"))
}

/// Inserts a link into the database directly, and returns its header.
fn kept(server: &Server, job: &str, maker: &str, expires_at: i64) -> String {
    let secret = Secret::new().expect("random");
    let share = NewShare {
        id: new_id().expect("random"),
        name: String::new(),
        digest: secret.digest(),
        job: job.to_owned(),
        made_by: maker.to_owned(),
        scopes: "jobs:read,renders",
        expires_at,
    };
    with_store(server, async |store| {
        assert!(store.insert_share(&share, 1000).await.expect("kept"));
    });
    format!("Bearer {}", secret.reveal())
}

#[test]
fn a_share_link_shows_only_its_job() {
    let (server, job) = server_with_job();
    let other = server.job("ok");
    server.wait_state(&other, "succeeded");
    let (admin, _) = token_of("root", &server, "admin");
    let (link, id) = link(&server, &job, &admin);
    let with = [("authorization", link.as_str())];
    let of = |job: &str, path: &str| format!("/v1/jobs/{job}{path}");
    let seen =
        ["", "/rounds", "/events", "/render?azimuth=1", "/artifacts", "/artifacts/scene.ply"];
    for path in seen {
        server.get(&of(&job, path), &with).expect(200);
        server.get(&of(&other, path), &with).expect(404);
    }
    check_log_is_hidden(&server, &job, &admin, &link);
    // Its training is over.
    server.get(&of(&job, "/live"), &with).expect(204);
    server.get(&of(&other, "/live"), &with).expect(404);
    let capture = server.get(&of(&job, ""), &with).json()["capture_id"].clone();
    let capture = format!("/v1/captures/{}", capture.as_str().expect("id"));
    let never = [
        "/v1/jobs",
        "/v1/captures",
        "/v1/options",
        &capture,
        &of(&job, "/log"),
        &of(&job, "/shares"),
        "/metrics",
    ];
    for path in never {
        server.get(path, &with).expect(403);
    }
    for path in ["/cancel", "/retry"] {
        server.post(&of(&job, path), b"", &with).expect(403);
    }
    server.delete_as(&of(&job, ""), &with).expect(403);
    let name = br#"{"name":"a"}"#;
    let headers = [with[0], ("content-type", "application/json")];
    server.ask("PATCH", &of(&job, ""), &headers, name).expect(403);
    server.delete_as(&of(&job, &format!("/shares/{id}")), &with).expect(403);
    make(&server, &job, &link, &json!({})).expect(403);
    let upload = server.upload("/v1/captures", &crate::support::photographs(3), &with);
    upload.expect(403);
    server.get(&of(&job, ""), &[("authorization", &admin)]).expect(200);
}

/// Checks that the owner sees the log among the files, and the holder of a link does not.
fn check_log_is_hidden(server: &Server, job: &str, owner: &str, link: &str) {
    let folder = server.data.path().join("data/jobs").join(job);
    std::fs::write(folder.join("output/log.txt"), "a path of this machine").expect("written");
    let files = format!("/v1/jobs/{job}/artifacts");
    for (header, status, is_listed) in [(owner, 200, true), (link, 404, false)] {
        let with = [("authorization", header)];
        let listed = server.get(&files, &with).expect(200).text();
        assert_eq!(listed.contains("log.txt"), is_listed);
        server.get(&format!("{files}/log.txt"), &with).expect(status);
    }
}

#[test]
fn a_browser_with_a_share_link_learns_its_job() {
    let (server, job) = server_with_job();
    let (admin, _) = token_of("root", &server, "admin");
    let (link, _) = link(&server, &job, &admin);
    let token = link.trim_start_matches("Bearer ");
    let login = server.post_json("/login", &json!({ "token": token }), &[]).expect(204);
    let cookie = login.header("set-cookie").split(';').next().expect("cookie").to_owned();
    let session = server.get("/login", &[("cookie", &cookie)]).expect(200).json();
    assert_eq!(session["job"], json!(job));
    let page = server.get(&format!("/v1/jobs/{job}"), &[("cookie", &cookie)]);
    page.expect(200);
    server.get("/v1/jobs", &[("cookie", &cookie)]).expect(403);
}

#[test]
fn a_share_link_ends_with_its_expiry_its_creator_or_its_job() {
    let (server, job) = server_with_job();
    let (admin, admin_id) = token_of("root", &server, "admin");
    let (maker, maker_id) = token_of("root", &server, "admin");
    let path = format!("/v1/jobs/{job}");
    let holds = |link: &str| server.get(&path, &[("authorization", link)]).status == 200;
    let listed = || {
        let listed = server.get(&format!("{path}/shares"), &[("authorization", &admin)]);
        listed.expect(200).json()["shares"].as_array().map_or(0, Vec::len)
    };

    let (ended, id) = link(&server, &job, &admin);
    assert!(holds(&ended) && listed() == 1);
    let end = || server.delete_as(&format!("{path}/shares/{id}"), &[("authorization", &admin)]);
    end().expect(204);
    assert!(!holds(&ended) && listed() == 0);
    end().expect(404);

    let (of_maker, _) = link(&server, &job, &maker);
    assert!(holds(&of_maker) && listed() == 1);
    with_store(&server, async |store| {
        assert!(store.revoke_token(&maker_id).await.expect("done"));
    });
    assert!(!holds(&of_maker) && listed() == 0);

    let now = now_ms();
    let expired = kept(&server, &job, &admin_id, now - 1);
    let in_time = kept(&server, &job, &admin_id, now + 60_000);
    assert!(!holds(&expired) && holds(&in_time) && listed() == 1);

    let soon = now_ms() + 3_600_000;
    let (short, _) = token_until(&server, "root", "admin", soon);
    let made = make(&server, &job, &short, &json!({ "days": 30 })).expect(201).json();
    let ends: jiff::Timestamp = made["expires_at"].as_str().expect("time").parse().expect("time");
    assert_eq!(ends.as_millisecond(), soon, "no longer than its maker");

    let (last, _) = link(&server, &job, &admin);
    server.delete_as(&path, &[("authorization", &admin)]).expect(204);
    server.get(&path, &[("authorization", &last)]).expect(401);
}

#[test]
fn invalid_share_requests_are_refused_with_a_reason() {
    let (server, job) = server_with_job();
    let path = format!("/v1/jobs/{job}/shares");
    let open = server.post_json(&path, &json!({}), &[]).expect(409);
    assert_eq!(open.json()["code"], "no_tokens");
    let (admin, admin_id) = token_of("root", &server, "admin");
    for (wanted, pointer) in [
        (json!({ "days": 0 }), "/days"),
        (json!({ "days": 366 }), "/days"),
        (json!({ "name": "a\u{7}" }), "/name"),
        (json!({ "name": "a".repeat(101) }), "/name"),
    ] {
        let refused = make(&server, &job, &admin, &wanted).expect(422);
        assert_eq!(refused.json()["pointer"], pointer, "{wanted}");
    }
    make(&server, &job, &admin, &json!({ "until": 1 })).expect(422);
    make(&server, "01234567-89ab-7def-8123-456789abcdef", &admin, &json!({})).expect(404);
    let (stranger, _) = token_of("anna", &server, MAKES);
    make(&server, &job, &stranger, &json!({})).expect(404);
    for _ in 0..100 {
        kept(&server, &job, &admin_id, now_ms() + 60_000);
    }
    let refused = make(&server, &job, &admin, &json!({})).expect(409);
    assert_eq!(refused.json()["code"], "too_many_shares");
}

#[test]
fn a_share_link_needs_the_scopes_that_it_grants() {
    let server = Server::start();
    let (all, _) = token_of("anna", &server, MAKES);
    let with = [("authorization", all.as_str())];
    let capture = server.upload("/v1/captures", &crate::support::photographs(3), &with);
    let capture = capture.expect(201).json()["id"].clone();
    let order = json!({ "capture_id": capture, "options": { "adapter": "ok" } });
    let job = server.post_json("/v1/jobs", &order, &with).expect(202).json();
    let job = job["id"].as_str().expect("id");
    let (blind, _) = token_of("anna", &server, "jobs:read,jobs:write");
    let refused = make(&server, job, &blind, &json!({})).expect(403);
    assert_eq!(refused.json()["code"], "missing_scope");
    make(&server, job, &all, &json!({ "name": "for Bob" })).expect(201);
    let listed = server.get(&format!("/v1/jobs/{job}/shares"), &with).expect(200).json();
    assert_eq!(listed["shares"][0]["name"], "for Bob");
    assert!(listed["shares"][0].get("token").is_none());
}
