//! Malformed and impossible requests, through a real server process: each answer says what is
//! wrong, none is a 500, and none contains a path of the server.

use crate::support::{Server, file, photographs, text, zip};
use fled_tests::Reply;
use serde_json::{Value, json};

const CAMERA_FOCAL: f64 = 50.0;

fn camera(focal: f64) -> Value {
    json!({ "world_to_camera": [[1.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0],[0.0,0.0,1.0,4.0],[0.0,0.0,0.0,1.0]],
        "intrinsics": { "width": 64, "height": 48, "fx": focal, "fy": focal, "cx": 32.0, "cy": 24.0 } })
}

#[test]
fn a_page_past_the_end_of_a_log_is_empty() {
    let server = Server::start();
    let job = server.job("few_poses");
    server.wait_state(&job, "failed");
    let beyond = format!("/v1/jobs/{job}/log?offset={}", u64::MAX);
    server.get(&beyond, &[]).expect(422);
    for offset in [1_u64 << 40, i64::MAX as u64] {
        let page = server.get(&format!("/v1/jobs/{job}/log?offset={offset}"), &[]);
        let page = page.expect(200).json();
        assert_eq!((&page["lines"], &page["end"]), (&json!([]), &true.into()));
    }
}

#[test]
fn a_malformed_multipart_body_is_a_bad_request() {
    let server = Server::start();
    let whole =
        "--XXXX\r\nContent-Disposition: form-data; name=\"images\"; filename=\"a.png\"\r\n\r\nabc";
    let kind = [("content-type", "multipart/form-data; boundary=XXXX")];
    for body in
        ["", "--XXXX", "no boundary", whole, "--XXXX\r\nbad header\r\n\r\nabc\r\n--XXXX--\r\n"]
    {
        for path in ["/v1/captures", "/v1/jobs"] {
            let problem = server.post(path, body.as_bytes(), &kind).expect(400);
            assert_eq!(problem.json()["code"], "bad_request", "{body:?}");
        }
    }
    let none = [("content-type", "multipart/form-data")];
    server.post("/v1/captures", b"", &none).expect(400);
    server.post("/v1/captures", b"", &[("content-type", "text/plain")]).expect(415);
    server.post("/v1/captures", b"", &[]).expect(415);
}

#[test]
fn media_types_ignore_case_and_arrays_are_no_orders() {
    let server = Server::start();
    let capture = server.capture(3);
    let array = json!([capture, "preview", {}, "name"]);
    server.post_json("/v1/jobs", &array, &[]).expect(422);
    let kind = [("content-type", "Multipart/Form-Data; boundary=XXXX")];
    let body =
        "--XXXX\r\nContent-Disposition: form-data; name=\"preset\"\r\n\r\npreview\r\n--XXXX--\r\n";
    let problem = server.post("/v1/jobs", body.as_bytes(), &kind).expect(422).json();
    assert!(problem["detail"].as_str().is_some_and(|d| d.contains("no file")), "{problem:#}");
}

#[test]
fn options_that_would_fail_late_are_refused_at_once() {
    let server = Server::start();
    let order = |options: Value| {
        let order = json!({ "capture_id": server.capture(3), "options": options });
        server.post_json("/v1/jobs", &order, &[])
    };
    let refused = |options: Value| order(options).expect(422).json()["pointer"].clone();
    assert_eq!(refused(json!({ "target": "bright" })), "/options/target");
    assert_eq!(refused(json!({ "target": "1,2,3" })), "/options/target");
    assert_eq!(refused(json!({ "held_out": "no-such-view" })), "/options/held_out");
    assert_eq!(refused(json!({ "held_out": 1 })), "/options/held_out");
    assert_eq!(refused(json!({ "held_out": " 8 " })), "/options/held_out");
    assert_eq!(refused(json!({ "adapter": "x".repeat(300) })), "/options/adapter");
    let held_out = "000, 002";
    order(json!({ "target": "10,0.8", "held_out": held_out, "adapter": "ok" })).expect(202);
    let mut parts = photographs(3);
    parts.push(text("options", r#"{"held_out":"no-such-view"}"#));
    server.upload("/v1/jobs", &parts, &[]).expect(422);
    let captures = server.get("/v1/captures", &[]).expect(200).json();
    assert_eq!(captures["captures"].as_array().map(Vec::len), Some(7), "a refused one was kept");
}

#[test]
fn unreadable_poses_are_refused_with_the_upload() {
    let server = Server::start();
    let broken = [
        vec![file("transforms.json", b"{")],
        vec![file("poses_bounds.npy", b"no array")],
        vec![
            file("sparse/0/cameras.txt", b"1 PINHOLE 160 120 100 100 80 60\n"),
            file("sparse/0/images.txt", b"1 1 0 0 0 0 0 0 2 000.png\n\n"),
        ],
    ];
    for poses in broken {
        let mut parts = photographs(3);
        parts.extend(poses);
        let problem = server.upload("/v1/captures", &parts, &[]).expect(422).json();
        let detail = problem["detail"].as_str().expect("detail");
        assert!(detail.contains("poses") && !detail.contains("incoming"), "{detail}");
        assert!(problem["hint"].as_str().is_some_and(|hint| hint.contains("leave it out")));
    }
    let mut files: Vec<(&str, Vec<u8>)> = Vec::new();
    let photographs = photographs(3);
    for (_, name, content) in &photographs {
        files.push((name.as_deref().expect("named"), content.clone()));
    }
    files.push(("transforms.json", b"[]".to_vec()));
    let parts = [file("walk.zip", &zip(&files))];
    server.upload("/v1/captures", &parts, &[]).expect(422);
}

#[test]
fn invalid_and_missing_cameras_are_reported() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let path = format!("/v1/jobs/{job}/render");
    server.post_json(&path, &camera(CAMERA_FOCAL), &[]).expect(200);
    for focal in [1e39, 1e300, 1e-30, 0.0] {
        server.post_json(&path, &camera(focal), &[]).expect(422);
    }
    let mut nested = camera(CAMERA_FOCAL);
    nested["intrinsics"] = json!([64, 48, 50.0, 50.0, 32.0, 24.0]);
    server.post_json(&path, &nested, &[]).expect(422);
    let output = server.data.path().join("data/jobs").join(&job).join("output");
    std::fs::remove_file(output.join("cameras.json")).expect("removed");
    let problem = server.get(&path, &[]).expect(409).json();
    assert_eq!(problem["code"], "no_cameras");
    let videos = format!("/v1/jobs/{job}/videos");
    let orbit = json!({ "kind": "orbit", "seconds": 1 });
    let problem = server.post_json(&videos, &orbit, &[]).expect(409).json();
    assert_eq!(problem["code"], "no_cameras");
}

#[test]
fn an_unknown_last_event_id_is_refused() {
    let server = Server::start();
    let job = server.job("few_poses");
    server.wait_state(&job, "failed");
    let path = format!("/v1/jobs/{job}/events");
    for bogus in ["abc", "-1", "1000000", "9223372036854775807", "9223372036854775808", "1.5", ""] {
        server.get(&path, &[("last-event-id", bogus)]).expect(422);
    }
    server.get(&format!("{path}?after=1000000"), &[]).expect(422);
    server.get(&path, &[("last-event-id", "1")]).expect(200);
}

#[test]
fn no_answer_contains_a_path_of_the_server() {
    let server = Server::start();
    let (job, done) = (server.job("leak"), server.job("ok"));
    let failed = server.wait_state(&job, "failed");
    assert_eq!(failed["error"]["detail"], "images: is damaged");
    let events = server.get(&format!("/v1/jobs/{job}/events"), &[]).expect(200).text();
    assert!(!events.contains("data/captures"), "{events}");
    server.wait_state(&done, "succeeded");
    let scene = format!("data/jobs/{done}/output/scene.ply");
    std::fs::write(server.data.path().join(scene), "refuse").expect("written");
    let problem = server.get(&format!("/v1/jobs/{done}/render"), &[]).expect(503).json();
    assert_eq!(problem["detail"], "scene.ply: damaged");
    let ready = server.get("/readyz", &[]).expect(503).text();
    assert!(ready.contains("no colmap") && !ready.contains("/usr/bin"), "{ready}");
}

#[test]
fn texts_with_control_characters_are_refused() {
    let server = Server::start();
    let capture = server.capture(3);
    let code = |reply: Reply| reply.expect(422).json()["code"].clone();
    for path in [
        "/v1/jobs/a%00b",
        "/v1/jobs/%E2%80%AEgpj",
        "/v1/captures/%1b",
        "/v1/jobs/x/videos/%00/file",
        "/v1/captures?cursor=%00",
        "/v1/jobs?capture_id=%00",
    ] {
        assert_eq!(code(server.get(path, &[])), "bad_text", "{path}");
    }
    server.get("/v1/jobs/%ff", &[]).expect(400);
    let order = |name: &str| json!({ "capture_id": capture, "name": name });
    for name in ["a\0b", "a\nb", "\u{1b}[2J", "\u{202e}gpj", "\u{2066}a"] {
        let refused = server.post_json("/v1/jobs", &order(name), &[]).expect(422).json();
        assert_eq!(
            (&refused["code"], &refused["pointer"]),
            (&json!("bad_text"), &json!("/name")),
            "{name:?}"
        );
        let mut parts = photographs(3);
        parts.push(text("name", name));
        assert_eq!(code(server.upload("/v1/captures", &parts, &[])), "bad_text", "{name:?}");
    }
    let mut parts = photographs(3);
    parts.push(file("\u{202e}gpj.png", b"x"));
    assert_eq!(code(server.upload("/v1/captures", &parts, &[])), "bad_text");
    let mut parts = photographs(3);
    parts.push(text("options", "{\n\"adapter\": \"a\\u0000\"\n}"));
    let refused = server.upload("/v1/jobs", &parts, &[]).expect(422).json();
    assert_eq!(refused["pointer"], "/options/adapter");
    let options = json!({ "capture_id": capture, "options": { "adapter": "a\0" } });
    assert_eq!(code(server.post_json("/v1/jobs", &options, &[])), "bad_text");
}

#[test]
fn a_body_that_does_not_fit_is_refused_in_plain_words() {
    let server = Server::start();
    let json = [("content-type", "application/json")];
    for (body, status, detail) in [
        ("{", 400, "The body is not JSON: it ends too early."),
        ("{]", 400, "The body is not JSON: see line 1, column 2."),
        ("[]", 422, "The body must be an object."),
        ("{}", 422, "`capture_id` is missing."),
        ("{\"capture_id\":1}", 422, "`capture_id` must be a string."),
        ("{\"capture_id\":\"a\",\"options\":[]}", 422, "`options` must be an object."),
    ] {
        let refused = server.post("/v1/jobs", body.as_bytes(), &json).expect(status);
        assert_eq!(refused.json()["detail"], detail, "{body}");
        assert_eq!(refused.header("content-type"), "application/problem+json");
    }
    let options = json!({ "capture_id": server.capture(3), "options": { "sh_degree": "two" } });
    let refused = server.post_json("/v1/jobs", &options, &[]).expect(422).json();
    let detail = "option `sh_degree`: must be a whole number from 0 to 3";
    assert_eq!(refused["detail"], detail);
    assert_eq!(refused["pointer"], "/options/sh_degree");
}

#[test]
fn a_zip_as_the_whole_body_gets_a_hint() {
    let server = Server::start();
    let archive = zip(&[("a.png", vec![1, 2, 3])]);
    for path in ["/v1/jobs", "/v1/captures"] {
        let refused =
            server.post(path, &archive, &[("content-type", "application/zip")]).expect(415);
        let hint = refused.json()["hint"].as_str().expect("a hint").to_owned();
        assert!(hint.contains("multipart/form-data") && hint.contains("`images`"), "{hint}");
    }
}

#[test]
fn a_wrong_address_is_a_page_for_people_and_a_problem_for_programs() {
    let server = Server::start();
    let page = server.get("/jobs/7", &[("accept", "text/html,*/*;q=0.8")]).expect(404);
    assert_eq!(page.header("content-type"), "text/html; charset=utf-8");
    assert!(page.text().contains("href=\"../assets/"), "{}", page.text());
    let problem = server.get("/jobs/7", &[]).expect(404);
    assert_eq!(problem.json()["code"], "not_found");
}

#[test]
fn an_orbit_of_more_than_a_turn_is_refused() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    for query in ["azimuth=1e300", "elevation=-361"] {
        let refused = server.get(&format!("/v1/jobs/{job}/render?{query}"), &[]).expect(422).json();
        let detail = refused["detail"].as_str().expect("a detail");
        assert!(detail.contains("is not in -360..=360"), "{detail}");
    }
}
