//! A full disk, through a real server process.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::PathBuf;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::{Server, deflated, file, photographs, text};
use serde_json::json;

/// More than the capacity of any disk.
const NO_SPACE: [(&str, &str); 1] = [("FLED_FAKE_MIN_FREE", "1152921504606846976")];

#[test]
fn below_the_watermark_nothing_is_accepted_or_started() {
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
    assert_eq!((&shown["state"], &shown["attempts"]), (&"queued".into(), &1.into()));
    server.restart();
    server.wait_state(&waiting, "succeeded");
}

#[test]
fn a_zip_is_unpacked_only_if_its_content_fits() {
    let names: Vec<String> = (0..60).map(|i| format!("{i}.jpg")).collect();
    let files: Vec<(&str, Vec<u8>)> =
        names.iter().map(|name| (name.as_str(), vec![0; 1 << 20])).collect();
    let parts = [file("walk.zip", &deflated(&files))];
    let is_refused = || {
        let server = Server::start();
        let free = free_bytes(server.data.path());
        drop(server);
        // Space for the zip but not for its content, even if other tests write meanwhile.
        let watermark = (free - (8 << 20)).to_string();
        let server = Server::start_with(&[("FLED_FAKE_MIN_FREE", &watermark)]);
        let refused = server.upload("/v1/captures?dry_run", &parts, &[]);
        refused.status == 507 && refused.json()["code"] == "disk_full"
    };
    // Others that remove files meanwhile may make room for the content.
    assert!((0..4).any(|_| is_refused()));
}

/// Size of the server's own disk, in bytes.
const DISK: u64 = 48 << 20;

/// Fills the disk `FLED_FILLS` times; CI fills it a few times.
#[test]
fn a_temporarily_full_disk_loses_nothing() {
    let allowed = Command::new("unshare").args(["--map-root-user", "--mount", "true"]).status();
    if !allowed.is_ok_and(|status| status.success()) {
        // Written to standard error directly, because the output of passing tests is hidden.
        let said = "left out: `unshare --map-root-user --mount` is not allowed here";
        writeln!(std::io::stderr(), "{said}").expect("said");
        return;
    }
    let fills: u32 = std::env::var("FLED_FILLS").map_or(3, |n| n.parse().expect("FLED_FILLS"));
    let server = Server::start_on_disk(DISK, &[("FLED_FAKE_IO_RETRY_MS", "700")]);
    let calm = server.job("ok");
    server.wait_state(&calm, "succeeded");
    let capture = server.show(&calm)["capture_id"].clone();
    let order =
        json!({ "capture_id": capture, "preset": "preview", "options": { "adapter": "slow:15" } });
    let expected = scene(&server, &calm);
    let mut met = BTreeMap::<String, u32>::new();
    for fill in 0..fills {
        let job = server.post_json("/v1/jobs", &order, &[]).expect(202).json();
        let job = job["id"].as_str().expect("id").to_owned();
        // Spread over all stages, and before the job begins.
        sleep(Duration::from_millis(u64::from(fill) * 411 % 1100));
        let stage = server.show(&job)["stage"].to_string();
        let filler = fill_up(&server);
        let end = Instant::now() + Duration::from_millis(600);
        while Instant::now() < end {
            for path in ["/livez", "/v1/jobs", "/v1/captures"] {
                server.get(path, &[]).expect(200);
            }
            let refused = server.post_json("/v1/jobs", &order, &[]);
            assert_eq!(refused.expect(507).json()["code"], "disk_full");
            server.upload("/v1/captures", &photographs(3), &[]).expect(507);
            sleep(Duration::from_millis(20));
        }
        std::fs::remove_file(filler).expect("removed");
        server.wait_state(&job, "succeeded");
        assert_eq!(scene(&server, &job), expected);
        let ids: Vec<i64> =
            server.events(&job, 0, usize::MAX).iter().map(|event| event.0).collect();
        assert_eq!(ids, (1..=ids.len() as i64).collect::<Vec<_>>(), "a gap or a duplicate");
        // Uploads refused while the disk was full are accepted now.
        server.capture(3);
        *met.entry(stage).or_default() += 1;
    }
    eprintln!("filled {fills} times, by stage: {met:?}");
}

/// Fills the server's disk to the last byte, and returns the filler file.
fn fill_up(server: &Server) -> PathBuf {
    let path = server.seen().join("filler");
    let mut file = File::create(&path).expect("made");
    for piece in [1 << 20, 1 << 12, 1] {
        while file.write_all(&vec![0; piece]).is_ok() {}
    }
    path
}

fn scene(server: &Server, job: &str) -> Vec<u8> {
    let path = server.seen().join("jobs").join(job).join("output/scene.ply");
    std::fs::read(path).expect("a scene")
}

fn free_bytes(path: &std::path::Path) -> u64 {
    let stat = rustix::fs::statvfs(path).expect("a file system");
    stat.f_bavail * stat.f_frsize
}
