//! A disk without space, through a real server process.

mod support;

use std::thread::sleep;
use std::time::Duration;

use serde_json::json;
use support::{Server, deflated, file, text};

/// More than any disk has.
const NO_SPACE: [(&str, &str); 1] = [("FLED_FAKE_MIN_FREE", "1152921504606846976")];

#[test]
fn below_the_watermark_nothing_is_accepted_and_nothing_begins() {
    let mut server = Server::start();
    let capture = server.capture(3);
    let waiting = server.job("slow:30");
    server.wait(&waiting, "running", |shown| shown["state"] == "running");
    server.restart_with(&NO_SPACE);
    let order = json!({ "capture_id": capture });
    let refused = server.post_json("/v1/jobs", &order, &[]).expect(507).json();
    assert_eq!(refused["code"], "disk_full");
    // A small body: the refusal comes before it is read.
    let parts = [text("name", "walk")];
    server.upload("/v1/captures", &parts, &[]).expect(507);
    sleep(Duration::from_millis(1500));
    let shown = server.show(&waiting);
    assert_eq!(
        (&shown["state"], &shown["attempts"]),
        (&"queued".into(), &1.into())
    );
    server.restart();
    server.wait_state(&waiting, "succeeded");
}

#[test]
fn a_zip_is_unpacked_only_where_there_is_space_for_it() {
    let server = Server::start();
    let free = free_bytes(server.data.path());
    drop(server);
    // Space for the zip and not for what is in it, give or take what others write meanwhile.
    let watermark = (free - (8 << 20)).to_string();
    let server = Server::start_with(&[("FLED_FAKE_MIN_FREE", &watermark)]);
    let names: Vec<String> = (0..60).map(|i| format!("{i}.jpg")).collect();
    let files: Vec<(&str, Vec<u8>)> = names
        .iter()
        .map(|name| (name.as_str(), vec![0; 1 << 20]))
        .collect();
    let parts = [file("walk.zip", &deflated(&files))];
    let refused = server.upload("/v1/captures?dry_run", &parts, &[]);
    assert_eq!(refused.expect(507).json()["code"], "disk_full");
}

fn free_bytes(path: &std::path::Path) -> u64 {
    let stat = rustix::fs::statvfs(path).expect("a file system");
    stat.f_bavail * stat.f_frsize
}
