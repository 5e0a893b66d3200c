//! Uploads that crash, block or overload their validation, through a real server process.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::thread::{scope, sleep};
use std::time::{Duration, Instant};

use crate::support::{Part, Server, file, photograph, photographs};
use image::{ExtendedColorType, ImageEncoder};

const MIB: u64 = 1 << 20;

/// Three good photographs and another file.
fn with(name: &str, bytes: &[u8]) -> Vec<Part> {
    let mut parts = photographs(3);
    parts.push(file(name, bytes));
    parts
}

fn is_empty(folder: &Path) -> bool {
    fs::read_dir(folder).expect("folder").next().is_none()
}

/// Waits up to ten seconds for a condition.
#[track_caller]
fn soon(what: &str, is: impl Fn() -> bool) {
    let start = Instant::now();
    while !is() {
        assert!(start.elapsed() < Duration::from_secs(10), "not {what}");
        sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_photograph_that_crashes_its_validator_is_named() {
    let server = Server::start();
    for path in ["/v1/captures", "/v1/captures?dry_run", "/v1/jobs"] {
        let parts = with("crash.png", &photograph(9));
        let problem = server.upload(path, &parts, &[]).expect(422).json();
        let detail = problem["detail"].as_str().expect("detail");
        assert!(detail.starts_with("crash.png: ") && detail.contains("SIGABRT"), "{detail}");
        assert!(!problem["hint"].as_str().expect("hint").is_empty());
    }
    let data = server.data.path().join("data");
    soon("all folders gone", || is_empty(&data.join("incoming")));
    assert!(is_empty(&data.join("captures")));
    server.capture(3);
}

#[test]
fn an_endless_photograph_blocks_only_its_own_upload() {
    let server = Server::start_with(&[("FLED_FAKE_PHOTOGRAPH_MS", "2000")]);
    scope(|scope| {
        let endless = scope.spawn(|| {
            let parts = with("endless.png", &photograph(9));
            server.upload("/v1/captures", &parts, &[]).expect(422)
        });
        server.capture(3);
        assert!(!endless.is_finished(), "it waited");
        let problem = endless.join().expect("an answer").json();
        let detail = problem["detail"].as_str().expect("detail");
        assert!(detail.starts_with("endless.png: ") && detail.contains("2 s"), "{detail}");
    });
    let incoming = server.data.path().join("data/incoming");
    soon("the folder gone", || is_empty(&incoming));
}

/// 16-bit RGBA of one colour: 8 bytes per pixel, and nearly nothing as a file.
fn huge(side: u32) -> Vec<u8> {
    let samples = vec![0; side as usize * side as usize * 8];
    let mut png = Vec::new();
    image::codecs::png::PngEncoder::new(&mut png)
        .write_image(&samples, side, side, ExtendedColorType::Rgba16)
        .expect("encode");
    png
}

#[test]
fn a_photograph_beyond_the_memory_limit_fails_only_its_upload() {
    let server = Server::start_with(&[("FLED_FAKE_ASSESSING", &(300 * MIB).to_string())]);
    let before = server.peak_memory();
    let parts = with("huge.png", &huge(7000));
    let problem = server.upload("/v1/captures", &parts, &[]).expect(422).json();
    let detail = problem["detail"].as_str().expect("detail");
    assert!(detail.starts_with("huge.png: "), "{detail}");
    let grown = server.peak_memory() - before;
    assert!(grown < 20 * MIB, "{} MiB more", grown / MIB);
    server.capture(3);
}

#[test]
fn uploads_share_one_budget_for_decoding() {
    // 190 MiB decoded, 200 kB as a file.
    let png = huge(5000);
    let server = Server::start_with(&[("FLED_FAKE_DECODING", &(220 * MIB).to_string())]);
    let parts: Vec<_> = (0..2).map(|i| file(&format!("{i}.png"), &png)).collect();
    let most = scope(|scope| {
        let uploads: Vec<_> = (0..3)
            .map(|_| scope.spawn(|| server.upload("/v1/captures", &parts, &[]).expect(422)))
            .collect();
        let mut most: u64 = 0;
        while !uploads.iter().all(std::thread::ScopedJoinHandle::is_finished) {
            let held: u64 = server.children().into_iter().map(|pid| memory(&pid)).sum();
            most = most.max(held);
            sleep(Duration::from_millis(2));
        }
        most
    });
    assert!(most > 150 * MIB, "{} MiB seen", most / MIB);
    assert!(most < 400 * MIB, "{} MiB for pictures of 190 MiB, one at a time", most / MIB);
    let own = server.peak_memory() / MIB;
    assert!(own < 150, "{own} MiB in the server itself");
}

/// Resident memory of a process in bytes; 0 once it is gone.
fn memory(process: &Path) -> u64 {
    let status = fs::read_to_string(process.join("status")).unwrap_or_default();
    let held = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let held = held.and_then(|held| held.trim().strip_suffix(" kB"));
    1024 * held.map_or(0, |held| held.trim().parse().expect("a number"))
}

/// A replacement for FFmpeg that never ends and is identified by its `sleep` argument.
fn endless_ffmpeg(folder: &Path, seconds: &str) -> PathBuf {
    let path = folder.join("endless-ffmpeg");
    fs::write(&path, format!("#!/bin/sh\nexec sleep {seconds}\n")).expect("written");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("allowed");
    path
}

fn sleepers(seconds: &str) -> usize {
    let line = format!("sleep\0{seconds}\0");
    let processes = fs::read_dir("/proc").expect("Linux").flatten();
    let lines = processes.filter_map(|process| fs::read(process.path().join("cmdline")).ok());
    lines.filter(|found| found == line.as_bytes()).count()
}

#[test]
fn a_video_reader_ends_with_its_client_and_its_server() {
    // A duration used by no other test.
    let seconds = format!("9{:06}", std::process::id());
    let folder = tempfile::tempdir().expect("folder");
    let program = endless_ffmpeg(folder.path(), &seconds);
    let program = program.to_str().expect("a name");
    let mut server = Server::start_with(&[("FLED_FAKE_FFMPEG", program)]);
    let video = [file("walk.mp4", b"a video")];
    let client = server.begin_upload("/v1/captures", &video);
    soon("read", || sleepers(&seconds) == 1);
    drop(client);
    soon("ended with its client", || sleepers(&seconds) == 0);
    let incoming = server.data.path().join("data/incoming");
    soon("the folder gone", || is_empty(&incoming));
    let client = server.begin_upload("/v1/captures", &video);
    soon("read", || sleepers(&seconds) == 1);
    server.kill();
    soon("ended with its server", || sleepers(&seconds) == 0);
    drop(client);
}
