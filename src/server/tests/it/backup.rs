//! A backup of a data directory in use, and a server started from it.

use std::fs;
use std::path::Path;

use crate::support::Server;
use fled_server::{Backup, backup};

fn copy(from: &Path, to: &Path) -> fled_server::Result<Backup> {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
    runtime.block_on(backup(from, to))
}

#[test]
fn a_backup_has_finished_jobs_and_starts_the_rest_afresh() {
    let server = Server::start();
    let done = server.job("ok");
    server.wait_state(&done, "succeeded");
    let never = server.job("slow:1000");
    let running = server.job("slow:60");
    let cancel = format!("/v1/jobs/{never}/cancel");
    server.wait_state(&running, "running");
    server.post(&cancel, b"", &[]).expect(202);
    let mut other = Server::start();
    other.kill();
    let (from, to) = (server.data.path().join("data"), other.data.path().join("data"));
    assert!(copy(&from, &to).is_err(), "there is something already");
    let nowhere = server.data.path().join("nowhere");
    assert!(copy(&nowhere, &nowhere.join("copy")).is_err());
    fs::remove_dir_all(&to).expect("removed");
    let copied = copy(&from, &to).expect("copied");
    assert_eq!((copied.captures, copied.jobs, copied.anew), (3, 2, 1));
    assert!(copied.bytes > 0);
    assert!(!to.join("jobs").join(&running).exists());

    other.restart();
    assert_eq!(other.show(&never)["state"], "cancelled");
    let scene = format!("/v1/jobs/{done}/artifacts/scene.ply");
    let whole = server.get(&scene, &[]).expect(200).body;
    assert!(other.get(&scene, &[]).expect(200).body == whole);
    let files = format!("/v1/jobs/{done}/artifacts");
    let all = server.get(&files, &[]).expect(200).json();
    assert!(all.to_string().contains("/renders/"), "{all:#}");
    assert_eq!(other.get(&files, &[]).expect(200).json(), all);
    let rounds = format!("/v1/jobs/{done}/rounds");
    let shown = server.get(&rounds, &[]).expect(200).json();
    assert_eq!(other.get(&rounds, &[]).expect(200).json(), shown);
    other.wait_state(&running, "succeeded");
    server.wait_state(&running, "succeeded");
    other.job("ok");
}
