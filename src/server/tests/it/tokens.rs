//! Access control, through a real server process.

use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::tokens::{token, token_of, with_store};
use crate::support::{Server, photographs};
use serde_json::json;

/// Creates a capture and a finished job with a token that may read and create jobs.
fn job_of(server: &Server, header: &str) -> (String, String) {
    let headers = [("authorization", header)];
    let id = |reply: fled_tests::Reply| reply.json()["id"].as_str().expect("id").to_owned();
    let capture = server.upload("/v1/captures", &photographs(3), &headers);
    let capture = id(capture.expect(201));
    let order = json!({ "capture_id": capture, "options": { "adapter": "ok" } });
    let job = id(server.post_json("/v1/jobs", &order, &headers).expect(202));
    let start = Instant::now();
    loop {
        let shown = server.get(&format!("/v1/jobs/{job}"), &headers).expect(200);
        if shown.json()["state"] == "succeeded" {
            return (capture, job);
        }
        assert!(start.elapsed() < Duration::from_secs(30), "{}", shown.text());
        sleep(Duration::from_millis(20));
    }
}

#[test]
fn once_a_token_exists_every_request_needs_one() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let (admin, id) = token(&server, "admin");
    let of = |path: &str| format!("/v1/jobs/{job}{path}");
    let paths = [
        of(""),
        of("/events"),
        of("/rounds"),
        of("/log"),
        of("/render?azimuth=1"),
        of("/artifacts"),
        of("/artifacts/scene.ply"),
        "/v1/jobs".to_owned(),
        "/v1/captures".to_owned(),
        "/v1/options".to_owned(),
    ];
    for path in &paths {
        let refused = server.get(path, &[]).expect(401);
        assert_eq!(refused.json()["code"], "no_token", "{path}");
        assert!(refused.header("www-authenticate").starts_with("Bearer"));
        assert_eq!(refused.header("content-type"), "application/problem+json");
        server.get(path, &[("authorization", &admin)]).expect(200);
        server.get(path, &[("authorization", "Bearer fled_0")]).expect(401);
    }
    server.post(&of("/retry"), b"", &[]).expect(401);
    server.post(&of("/cancel"), b"", &[]).expect(401);
    server.delete(&of("")).expect(401);
    server.upload("/v1/captures", &photographs(3), &[]).expect(401);
    // Only the header counts: URLs are written to logs.
    let secret = admin.trim_start_matches("Bearer ");
    for named in ["token", "access_token"] {
        server.get(&format!("/v1/options?{named}={secret}"), &[]).expect(401);
    }
    for open in ["/", "/assets/main.js", "/livez", "/openapi.yaml"] {
        server.get(open, &[]).expect(200);
    }
    server.get("/readyz", &[]).expect(503);
    server.get("/nowhere", &[]).expect(404);
    assert!(with_store(&server, async |store| store.revoke_token(&id).await.expect("done")));
    server.get("/v1/jobs", &[("authorization", &admin)]).expect(401);
    server.get("/v1/jobs", &[]).expect(401);
}

#[test]
fn a_token_allows_what_its_scopes_say() {
    let server = Server::start();
    let (both, _) = token_of("anna", &server, "jobs:read,jobs:write");
    let (capture, job) = job_of(&server, &both);
    let (reads, _) = token_of("anna", &server, "jobs:read");
    let (writes, _) = token_of("anna", &server, "jobs:write");
    let (renders, _) = token_of("anna", &server, "renders");
    let (expired, id) = token_of("anna", &server, "admin");
    with_store(&server, async |store| {
        store.revoke_token(&id).await.expect("done");
    });
    let show = format!("/v1/jobs/{job}");
    let render = format!("{show}/render?azimuth=1");
    let order = json!({ "capture_id": capture, "options": { "adapter": "ok" } });
    for (header, show_status, order_status, render_status) in [
        (&reads, 200, 403, 403),
        (&writes, 403, 202, 403),
        (&renders, 403, 403, 200),
        (&expired, 401, 401, 401),
    ] {
        let headers = [("authorization", header.as_str())];
        server.get(&show, &headers).expect(show_status);
        server.post_json("/v1/jobs", &order, &headers).expect(order_status);
        server.get(&render, &headers).expect(render_status);
    }
    let refused = server.get(&show, &[("authorization", &renders)]).expect(403);
    assert_eq!(refused.json()["code"], "missing_scope");
    let detail = refused.json()["detail"].as_str().map(str::to_owned);
    assert!(detail.is_some_and(|detail| detail.contains("jobs:read")));
}

/// The cookie that a browser keeps, without its attributes.
fn cookie(reply: &fled_tests::Reply) -> String {
    let set = reply.header("set-cookie");
    for attribute in ["HttpOnly", "SameSite=Strict"] {
        assert!(set.contains(attribute), "{set}");
    }
    assert!(!set.contains("Path"), "{set}: else other services of a proxy receive it");
    set.split(';').next().expect("a cookie").to_owned()
}

/// The answer of `/login` to a browser without a share link.
fn who(needed: bool, scopes: Option<&str>) -> serde_json::Value {
    json!({ "needed": needed, "scopes": scopes, "job": null })
}

#[test]
fn a_browser_logs_in_and_out_with_a_cookie() {
    let server = Server::start();
    let open = server.get("/login", &[]).expect(200).json();
    assert_eq!(open, who(false, None));
    let (writes, _) = token_of("anna", &server, "jobs:read,jobs:write");
    let (_, job) = job_of(&server, &writes);
    let (header, id) = token_of("anna", &server, "jobs:read,renders");
    let locked = server.get("/login", &[]).expect(200).json();
    assert_eq!(locked, who(true, None));
    let secret = header.trim_start_matches("Bearer ");
    let own = ("origin", server.base.as_str());
    let wrong = json!({ "token": "fled_0" });
    server.post_json("/login", &wrong, &[own]).expect(401);
    let right = json!({ "token": secret });
    let evil = [("origin", "https://evil.example"), ("sec-fetch-site", "cross-site")];
    server.post_json("/login", &right, &evil).expect(403);
    let tls = [own, ("x-forwarded-proto", "https")];
    let secure = server.post_json("/login", &right, &tls).expect(204);
    assert!(secure.header("set-cookie").contains("; Secure"));
    let session = cookie(&server.post_json("/login", &right, &[own]).expect(204));
    assert!(!session.contains(secret), "the token itself is in no cookie");
    let browser = [("cookie", session.as_str())];
    let answer = server.get("/login", &browser).expect(200).json();
    assert_eq!(answer, who(true, Some("jobs:read,renders")));
    // Requests to which a page cannot add a header: event streams and images.
    for path in ["", "/events", "/render?azimuth=1", "/artifacts/scene.ply"] {
        server.get(&format!("/v1/jobs/{job}{path}"), &browser).expect(200);
    }
    // It has the token's scopes, and another site's page cannot use it.
    let retry = format!("/v1/jobs/{job}/retry");
    server.post(&retry, b"", &browser).expect(403);
    let forged = [evil[0], evil[1], browser[0]];
    server.post(&retry, b"", &forged).expect(403);
    // A session is not a token, and the cookie does not make up for an invalid header.
    let as_token = session.replace("fled_session=", "Bearer ");
    server.get("/v1/jobs", &[("authorization", &as_token)]).expect(401);
    server.get("/v1/jobs", &[browser[0], ("authorization", "Bearer x")]).expect(401);
    let gone = server.post("/logout", b"", &browser).expect(204);
    assert!(gone.header("set-cookie").contains("Max-Age=0"));
    server.get("/v1/jobs", &browser).expect(401);
    let session = cookie(&server.post_json("/login", &right, &[]).expect(204));
    let browser = [("cookie", session.as_str())];
    server.get("/v1/jobs", &browser).expect(200);
    with_store(&server, async |store| store.revoke_token(&id).await.expect("done"));
    server.get("/v1/jobs", &browser).expect(401);
}

#[test]
fn data_of_other_owners_is_not_found() {
    let server = Server::start();
    let scopes = "jobs:read,jobs:write,renders";
    let (anna, _) = token_of("anna", &server, scopes);
    let (later, _) = token_of("anna", &server, scopes);
    let (bob, _) = token_of("bob", &server, scopes);
    let (unnamed, _) = token(&server, scopes);
    let (admin, _) = token(&server, "admin");
    let (capture, job) = job_of(&server, &anna);
    let encoded = job.replacen('0', "%30", 1);
    let paths = |job: &str| {
        ["", "/events", "/rounds", "/log", "/artifacts", "/artifacts/scene.ply", "/render"]
            .map(|path| format!("/v1/jobs/{job}{path}"))
    };
    let mut all = vec![format!("/v1/captures/{capture}")];
    all.extend(paths(&job));
    all.extend(paths(&encoded));
    for path in &all {
        for (header, status) in [(&anna, 200), (&later, 200), (&admin, 200)] {
            server.get(path, &[("authorization", header)]).expect(status);
        }
        for header in [&bob, &unnamed] {
            let headers = [("authorization", header.as_str())];
            let refused = server.get(path, &headers).expect(404).json();
            // The answer does not differ from that for an id that never existed.
            let never = path.replace(&job, "never").replace(&encoded, "never");
            let never = server.get(&never.replace(&capture, "never"), &headers);
            assert_eq!(refused, never.expect(404).json(), "{path}");
        }
    }
    let bobs = [("authorization", bob.as_str())];
    for path in ["/cancel", "/retry", "/render"] {
        let path = format!("/v1/jobs/{job}{path}");
        server.post_json(&path, &json!({}), &bobs).expect(404);
    }
    for path in [format!("/v1/jobs/{job}"), format!("/v1/captures/{capture}")] {
        server.delete_as(&path, &bobs).expect(404);
    }
    let order = json!({ "capture_id": capture, "options": { "adapter": "ok" } });
    server.post_json("/v1/jobs", &order, &bobs).expect(404);
}

#[test]
fn lists_contain_only_the_owners_data() {
    let server = Server::start();
    let ownerless = server.job("ok");
    server.wait_state(&ownerless, "succeeded");
    let scopes = "jobs:read,jobs:write,renders";
    let (anna, _) = token_of("anna", &server, scopes);
    let (bob, _) = token_of("bob", &server, scopes);
    let (unnamed, _) = token(&server, scopes);
    let (admin, _) = token(&server, "admin");
    job_of(&server, &anna);
    let bobs = [("authorization", bob.as_str())];
    // Only the admin sees what was created before any token.
    let path = format!("/v1/jobs/{ownerless}");
    server.get(&path, &[("authorization", &anna)]).expect(404);
    server.get(&path, &[("authorization", &admin)]).expect(200);
    let (_, own) = job_of(&server, &bob);
    for (header, jobs) in [(&anna, 1), (&bob, 1), (&unnamed, 0), (&admin, 3)] {
        for list in ["jobs", "captures"] {
            let answer = server.get(&format!("/v1/{list}"), &[("authorization", header)]);
            let answer = answer.expect(200).json()[list].as_array().map(Vec::len);
            assert_eq!(answer, Some(jobs), "{list}");
        }
    }
    server.delete_as(&format!("/v1/jobs/{own}"), &bobs).expect(204);
}

#[test]
fn idempotency_keys_are_separate_for_each_owner() {
    let server = Server::start();
    let scopes = "jobs:read,jobs:write";
    let jobs = ["anna", "bob"].map(|name| {
        let (header, _) = token_of(name, &server, scopes);
        let (capture, _) = job_of(&server, &header);
        let order = json!({ "capture_id": capture, "options": { "adapter": "ok" } });
        let headers = [("authorization", header.as_str()), ("idempotency-key", "1")];
        let made = || server.post_json("/v1/jobs", &order, &headers).expect(202).json();
        let (first, again) = (made(), made());
        assert_eq!(first["id"], again["id"]);
        first["id"].clone()
    });
    assert_ne!(jobs[0], jobs[1]);
}
