//! Videos of results, through a real server process and FFmpeg.

use std::time::{Duration, Instant};

use crate::support::tokens::token_of;
use crate::support::{Server, gone};
use fled_tests::Reply;
use serde_json::{Value, json};

/// Timeout of a video of a few frames, while other tests run.
const PATIENCE: Duration = Duration::from_secs(30);

/// A server with a finished job, and the path of its videos.
fn server_with_job() -> (Server, String, String) {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let path = format!("/v1/jobs/{job}/videos");
    (server, job, path)
}

/// A small video: its content does not matter here.
fn order(fps: u32, seconds: f64) -> Value {
    json!({ "kind": "orbit", "fps": fps, "seconds": seconds, "width": 128 })
}

fn id(reply: Reply) -> String {
    let made = reply.expect(202).json();
    made["id"].as_str().expect("an id").to_owned()
}

fn wait(server: &Server, path: &str, what: &str, is: impl Fn(&Value) -> bool) -> Value {
    let start = Instant::now();
    loop {
        let shown = server.get(path, &[]).expect(200).json();
        if is(&shown) {
            return shown;
        }
        assert!(start.elapsed() < PATIENCE, "not {what}: {shown:#}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn wait_state(server: &Server, path: &str, state: &str) -> Value {
    wait(server, path, state, |shown| shown["state"] == state)
}

#[test]
fn a_video_is_made_and_sent_whole_and_in_ranges() {
    let (server, _, videos) = server_with_job();
    let mut order = order(10, 1.0);
    order["crop"] = json!("sphere: 0,0,0");
    let refused = server.post_json(&videos, &order, &[]).expect(422).json();
    assert_eq!(refused["pointer"], "/crop");
    order["crop"] = json!("sphere: 0,0,0,1.5");
    let reply = server.post_json(&videos, &order, &[]).expect(202);
    let path = reply.location();
    let made = id(reply);
    assert_eq!(path, format!("{videos}/{made}"));
    let shown = wait_state(&server, &path, "succeeded");
    assert_eq!(shown["crop"], "sphere:0,0,0,1.5");
    // The views have 160 x 90 px.
    assert_eq!(
        (&shown["width"], &shown["height"], &shown["progress"]),
        (&json!(128), &json!(72), &json!(1.0))
    );
    let file = format!("{path}/file");
    let whole = server.get(&file, &[]).expect(200);
    assert_eq!(whole.header("content-type"), "video/mp4");
    assert_eq!(json!(whole.body.len()), shown["bytes"]);
    assert_eq!(&whole.body[4..8], b"ftyp");
    let part = server.get(&file, &[("range", "bytes=4-7")]).expect(206);
    assert_eq!(part.body, b"ftyp");
    let tag = whole.header("etag").to_owned();
    server.get(&file, &[("if-none-match", &tag)]).expect(304);
    server.get(&file, &[("range", "bytes=99999999-")]).expect(416);
    let list = server.get(&videos, &[]).expect(200).json();
    assert_eq!(list["videos"], json!([shown]));
    server.delete(&path).expect(204);
    for gone in [&path, &file] {
        server.get(gone, &[]).expect(404);
    }
    server.delete(&path).expect(404);
    assert!(!server.data.path().join("data/jobs").join(&made).exists());
}

#[test]
fn a_video_is_not_found_as_a_job() {
    let (server, job, videos) = server_with_job();
    let video = id(server.post_json(&videos, &order(10, 1.0), &[]));
    let listed = server.get("/v1/jobs", &[]).expect(200).json();
    assert_eq!(listed["jobs"].as_array().map(Vec::len), Some(1));
    let path = format!("/v1/jobs/{video}");
    server.get(&path, &[]).expect(404);
    for below in ["events", "log", "artifacts", "rounds", "videos"] {
        server.get(&format!("{path}/{below}"), &[]).expect(404);
    }
    server.post_json(&format!("{path}/cancel"), &json!({}), &[]).expect(404);
    server.post_json(&format!("{path}/retry"), &json!({}), &[]).expect(404);
    server.put(&format!("{path}/pin")).expect(404);
    server.delete(&path).expect(404);
    wait_state(&server, &format!("{videos}/{video}"), "succeeded");
    let metrics = server.get("/metrics", &[]).expect(200).text();
    assert!(metrics.contains("fled_jobs{state=\"succeeded\"} 1"), "{metrics}");
    // Nor does it belong to another job.
    let other = server.job("ok");
    let there = format!("/v1/jobs/{other}/videos/{video}");
    server.get(&there, &[]).expect(404);
    server.delete(&there).expect(404);
    assert!(server.show(&job)["id"] == job);
}

#[test]
fn videos_queue_up_and_can_be_cancelled_at_any_time() {
    let (server, job, videos) = server_with_job();
    let of = |seconds| id(server.post_json(&videos, &order(5, seconds), &[]));
    let (first, second, third) = (of(20.0), of(20.0), of(1.0));
    let path = |id: &str| format!("{videos}/{id}");
    let half = |shown: &Value| shown["progress"].as_f64().is_some_and(|p| p > 0.01);
    let shown = wait(&server, &path(&first), "under way", half);
    assert_eq!(shown["state"], "running");
    server.get(&format!("{}/file", path(&first)), &[]).expect(409);
    let ahead = |id: &str| server.get(&path(id), &[]).expect(200).json()["ahead"].clone();
    assert_eq!((ahead(&second), ahead(&third)), (json!(1), json!(2)));
    server.delete(&path(&second)).expect(204);
    assert_eq!(ahead(&third), json!(1));
    server.delete(&path(&first)).expect(204);
    wait_state(&server, &path(&third), "succeeded");
    assert!(gone(&first), "nothing of the first goes on");
    let folder = server.data.path().join("data/jobs");
    let is_there = |id: &String| folder.join(id).exists();
    assert_eq!([&job, &first, &second, &third].map(is_there), [true, false, false, true]);
}

#[test]
fn a_video_is_restarted_after_the_death_of_the_server() {
    let (mut server, _, videos) = server_with_job();
    let slow = format!("{videos}/{}", id(server.post_json(&videos, &order(5, 3.0), &[])));
    let next = format!("{videos}/{}", id(server.post_json(&videos, &order(10, 1.0), &[])));
    let begun = |shown: &Value| shown["progress"].as_f64().is_some_and(|p| p > 0.1);
    wait(&server, &slow, "under way", begun);
    server.restart();
    let shown = server.get(&slow, &[]).expect(200).json();
    assert_ne!(shown["state"], "succeeded");
    wait_state(&server, &slow, "succeeded");
    wait_state(&server, &next, "succeeded");
    let whole = server.get(&format!("{slow}/file"), &[]).expect(200);
    assert_eq!(&whole.body[4..8], b"ftyp");
}

#[test]
fn a_failed_video_reports_why_and_the_next_is_made() {
    let (server, _, videos) = server_with_job();
    let of = |fps| format!("{videos}/{}", id(server.post_json(&videos, &order(fps, 1.0), &[])));
    let (refused, dead, good) = (of(7), of(9), of(10));
    let shown = wait_state(&server, &refused, "failed");
    let detail = shown["error"]["detail"].as_str().expect("a detail");
    assert!(detail.ends_with("planned for video.mp4"), "{detail}");
    let shown = wait_state(&server, &dead, "failed");
    let detail = shown["error"]["detail"].as_str().expect("a detail");
    assert!(detail.contains("ended without a result"), "{detail}");
    wait_state(&server, &good, "succeeded");
    server.get(&format!("{dead}/file"), &[]).expect(409);
}

#[test]
fn invalid_video_requests_are_refused_with_a_reason() {
    let (server, job, videos) = server_with_job();
    let post = |body: &Value| server.post_json(&videos, body, &[]);
    for (body, pointer) in [
        (json!({ "kind": "orbit", "seconds": 100 }), "/seconds"),
        (json!({ "kind": "cameras", "degrees": 90 }), "/degrees"),
        (json!({ "kind": "path" }), "/poses"),
        (json!({ "kind": "orbit", "width": 5000 }), "/width"),
    ] {
        let problem = post(&body).expect(422).json();
        assert_eq!(problem["pointer"], pointer, "{body}");
    }
    post(&json!({ "kind": "spiral" })).expect(422);
    post(&json!({ "kind": "orbit", "colour": "red" })).expect(422);
    post(&json!({ "kind": "path", "poses": [[[1]], 2] })).expect(422);
    post(&json!({ "kind": "orbit", "round": 9 })).expect(404);
    for id in ["none", "..", "%2e%2e", "01234567-89ab-7def-8123-456789abcdef"] {
        server.get(&format!("{videos}/{id}"), &[]).expect(404);
    }
    for _ in 0..20 {
        id(post(&order(7, 1.0)));
    }
    assert_eq!(post(&order(7, 1.0)).expect(409).json()["code"], "too_many_videos");
    let unfinished = server.job("slow:100");
    let path = format!("/v1/jobs/{unfinished}/videos");
    let early = server.post_json(&path, &order(10, 1.0), &[]).expect(409);
    assert_eq!(early.json()["code"], "not_finished");
    server.delete(&format!("/v1/jobs/{job}")).expect(204);
    server.get(&videos, &[]).expect(404);
}

#[test]
fn a_missing_ffmpeg_is_reported_with_a_hint() {
    let server = Server::start_with(&[("FLED_FAKE_FFMPEG", "no-such-ffmpeg")]);
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let path = format!("/v1/jobs/{job}/videos");
    let problem = server.post_json(&path, &order(10, 1.0), &[]).expect(503).json();
    assert_eq!(problem["code"], "no_ffmpeg");
    let hint = problem["hint"].as_str().expect("a hint");
    assert!(hint.contains("apt-get install ffmpeg"), "{hint}");
}

#[test]
fn deleting_a_job_stops_its_running_video() {
    let (server, job, videos) = server_with_job();
    let video = id(server.post_json(&videos, &order(5, 20.0), &[]));
    let begun = |shown: &Value| shown["progress"].as_f64().is_some_and(|p| p > 0.01);
    wait(&server, &format!("{videos}/{video}"), "under way", begun);
    server.delete(&format!("/v1/jobs/{job}")).expect(204);
    assert!(gone(&video), "it is made no further");
    let folder = server.data.path().join("data/jobs");
    let start = Instant::now();
    while std::fs::read_dir(&folder).expect("read").count() > 0 {
        assert!(start.elapsed() < PATIENCE, "something is left");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_share_link_shows_videos_but_cannot_make_any() {
    let (server, job, videos) = server_with_job();
    let path = format!("{videos}/{}", id(server.post_json(&videos, &order(10, 1.0), &[])));
    wait_state(&server, &path, "succeeded");
    let (admin, _) = token_of("root", &server, "admin");
    let shares = format!("/v1/jobs/{job}/shares");
    let made = server.post_json(&shares, &json!({}), &[("authorization", &admin)]);
    let made = made.expect(201).json();
    let link = format!("Bearer {}", made["token"].as_str().expect("a token"));
    let with = [("authorization", link.as_str())];
    let file = format!("{path}/file");
    for seen in [&videos, &path, &file] {
        server.get(seen, &with).expect(200);
    }
    server.post_json(&videos, &order(10, 1.0), &with).expect(403);
    server.delete_as(&path, &with).expect(403);
    let (stranger, _) = token_of("anna", &server, "jobs:read,jobs:write");
    let with = [("authorization", stranger.as_str())];
    for hidden in [&videos, &path, &file] {
        server.get(hidden, &with).expect(404);
    }
    server.post_json(&videos, &order(10, 1.0), &with).expect(404);
    server.delete_as(&path, &with).expect(404);
}
