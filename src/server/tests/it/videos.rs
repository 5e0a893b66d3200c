//! Videos instead of photographs, through a real server process and FFmpeg.

use std::process::Command;

use crate::support::tokens::token_with;
use crate::support::tus::Tus;
use crate::support::{Server, file, photographs, text};
use fled_server::store::Quotas;
use serde_json::json;

/// A video of 60 different frames.
fn video() -> Vec<u8> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("made.mp4");
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-f", "lavfi", "-i"])
        .arg("testsrc2=size=160x96:rate=20:duration=3")
        .args(["-c:v", "libx264", "-pix_fmt", "yuv420p"])
        .arg(&path)
        .status()
        .expect("ffmpeg, which `make setup` installs");
    assert!(status.success());
    std::fs::read(path).expect("read")
}

#[test]
fn a_video_becomes_a_capture_that_reports_its_frames() {
    let server = Server::start();
    let parts = [file("my walk.MP4", &video()), text("frames", "6")];
    let capture = server.upload("/v1/captures", &parts, &[]).expect(201).json();
    assert_eq!(capture["accepted"], 6);
    let names: Vec<&str> = capture["images"]
        .as_array()
        .expect("images")
        .iter()
        .filter_map(|image| image["name"].as_str())
        .collect();
    assert!(
        names.iter().all(|name| name.starts_with("my walk-0000") && name.ends_with(".png")),
        "{names:?}"
    );
    let warnings = capture["warnings"].to_string();
    assert!(warnings.contains("6 of the 60 frames of my walk.MP4"), "{warnings}");
    let id = capture["id"].as_str().expect("an id");
    let kept = server.data.path().join("data/captures").join(id);
    assert!(kept.join("video/my walk.MP4").is_file(), "the video is kept");
}

#[test]
fn a_resumable_upload_of_a_video_becomes_a_job() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let id = tus.upload("walk.mov", &video());
    let id = id.rsplit('/').next().expect("an id");
    let body = json!({ "uploads": [id], "preset": "preview", "frames": 5 });
    let reply = server.post_json("/v1/jobs", &body, &[]);
    let job = reply.expect(202).json();
    let capture = job["capture_id"].as_str().expect("a capture");
    let capture = server.get(&format!("/v1/captures/{capture}"), &[]);
    assert_eq!(capture.expect(200).json()["accepted"], 5);
}

#[test]
fn two_videos_and_frames_beyond_the_quota_are_refused() {
    let server = Server::start();
    let two = [file("a.mp4", &video()), file("a.mov", &video())];
    let problem = server.upload("/v1/captures", &two, &[]).expect(422).json();
    assert!(problem["hint"].as_str().is_some_and(|hint| hint.contains("one")), "{problem}");
    let quotas = Quotas { bytes: Some(1_000_000), jobs: None };
    let (token, _) = token_with(&server, "ann", "jobs:read,jobs:write", quotas);
    let anns = [("authorization", &*token)];
    let one = [file("walk.mp4", &video())];
    // 40 frames of 160 x 96 px may take 1.8 MB.
    let problem = server.upload("/v1/captures", &one, &anns).expect(507).json();
    assert_eq!(problem["code"], "quota_bytes");
    let few = [file("walk.mp4", &video()), text("frames", "5")];
    server.upload("/v1/captures", &few, &anns).expect(201);
}

#[test]
fn a_video_beside_photographs_is_listed_and_not_used() {
    let server = Server::start();
    let mut parts = photographs(3);
    parts.push(file("IMG_0001.MOV", &video()));
    let capture = server.upload("/v1/captures", &parts, &[]).expect(201).json();
    assert_eq!(capture["accepted"], 3);
    let images = capture["images"].as_array().expect("images");
    let video = images.iter().find(|image| image["name"] == "IMG_0001.MOV");
    let reason = video.expect("listed")["reason"].as_str().unwrap_or("");
    assert!(reason.contains("only on its own"), "{reason}");
}

#[test]
fn a_broken_video_or_missing_ffmpeg_is_reported_with_a_hint() {
    let server = Server::start();
    let broken = [file("walk.mp4", b"this is a text")];
    let problem = server.upload("/v1/captures", &broken, &[]).expect(422).json();
    let detail = problem["detail"].as_str().expect("a detail");
    assert!(detail.starts_with("walk.mp4: ") && !detail.contains("incoming"), "{detail}");
    let absurd = [file("walk.mp4", &video()), text("frames", "1")];
    let problem = server.upload("/v1/captures", &absurd, &[]).expect(422).json();
    assert_eq!(problem["pointer"], "/frames");
    let server = Server::start_with(&[("FLED_FAKE_FFMPEG", "no-such-ffmpeg")]);
    let problem =
        server.upload("/v1/captures", &[file("walk.mp4", &video())], &[]).expect(415).json();
    let hint = problem["hint"].as_str().expect("a hint");
    assert!(hint.contains("apt-get install ffmpeg"), "{hint}");
}
