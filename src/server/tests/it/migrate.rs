//! Migration of a service from SQLite and its data directory to PostgreSQL and a blob store.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::support::Server;
use crate::support::tokens::token;
use crate::support::tus::Tus;
use fled_server::{Migrated, Result, ServerError, migrate};
use fled_tests::{Client, Postgres};
use serde_json::{Value, json};

/// The installation to migrate, and its recorded answers.
struct Old {
    server: Server,
    admin: String,
    done: String,
    running: String,
    waiting: String,
    /// The last order, sent with an idempotency key.
    waits: Value,
    /// The capture of the finished job.
    capture: String,
    seen: Vec<(String, Vec<u8>)>,
}

impl Old {
    /// A server that was killed in the middle of a job.
    fn new() -> Self {
        let mut server = Server::start_with(&[("FLED_FAKE_WORKERS", "1")]);
        let hook = json!({ "url": "http://receiver.invalid/", "types": ["job.succeeded"] });
        server.post_json("/v1/webhooks", &hook, &[]).expect(201);
        let order = json!({ "capture_id": server.capture(4), "preset": "preview",
                            "options": { "adapter": "ok" } });
        let done = id_of(&server, &order, &[]);
        server.wait_state(&done, "succeeded");
        let video = json!({ "kind": "orbit", "fps": 5, "seconds": 1.0, "width": 128 });
        let videos = format!("/v1/jobs/{done}/videos");
        let video = server.post_json(&videos, &video, &[]).expect(202);
        let video = video.location();
        while server.get(&video, &[]).json()["state"] != "succeeded" {
            std::thread::sleep(Duration::from_millis(50));
        }
        let running = server.job("slow:100");
        server.wait(&running, "in its middle", |shown| {
            shown["state"] == "running" && shown["progress"].as_f64() > Some(0.1)
        });
        Tus::new(&server).create("walk.png", 1000);
        let waits = json!({ "capture_id": server.capture(3), "preset": "preview",
                            "options": { "adapter": "ok" } });
        let (admin, _) = token(&server, "admin");
        let waiting = id_of(&server, &waits, &keyed(&admin));
        let shares = format!("/v1/jobs/{done}/shares");
        let as_admin = [("authorization", admin.as_str())];
        server.post_json(&shares, &json!({}), &as_admin).expect(201);
        let capture = order["capture_id"].as_str().expect("id").to_owned();
        let mut paths: Vec<String> = ["", "/rounds", "/events", "/videos", "/shares", "/log"]
            .iter()
            .map(|what| format!("/v1/jobs/{done}{what}"))
            .collect();
        let artifacts = format!("/v1/jobs/{done}/artifacts");
        let listed = server.get(&artifacts, &as_admin).expect(200).json();
        let listed = listed["artifacts"].as_array().expect("artifacts");
        assert!(listed.len() > 5, "{listed:?}");
        paths.extend(listed.iter().map(|artifact| {
            let name = artifact["name"].as_str().expect("a name");
            format!("{artifacts}/{name}")
        }));
        paths.extend(["/v1/captures", "/v1/webhooks", "/v1/options"].map(Into::into));
        paths.push(format!("{video}/file"));
        paths.push(format!("/v1/captures/{capture}"));
        paths.push(format!("/v1/jobs?capture_id={capture}"));
        let seen = look(&server, paths, &admin);
        server.kill();
        Self { server, admin, done, running, waiting, waits, capture, seen }
    }

    fn data(&self) -> PathBuf {
        self.server.data.path().join("data")
    }

    /// Checks that another server gives the recorded answers.
    fn expect_same(&self, api: &Client) {
        let paths = self.seen.iter().map(|(path, _)| path.clone()).collect();
        for (old, new) in self.seen.iter().zip(look(api, paths, &self.admin)) {
            let shown = String::from_utf8_lossy(&new.1);
            assert!(old.1 == new.1, "{}: {shown}", old.0);
        }
    }
}

fn keyed(admin: &str) -> [(&str, &str); 2] {
    [("authorization", admin), ("idempotency-key", "walk")]
}

fn id_of(api: &Client, order: &Value, headers: &[(&str, &str)]) -> String {
    let made = api.post_json("/v1/jobs", order, headers).expect(202);
    made.json()["id"].as_str().expect("id").to_owned()
}

fn look(api: &Client, paths: Vec<String>, admin: &str) -> Vec<(String, Vec<u8>)> {
    let answer = |path: String| {
        let reply = api.get(&path, &[("authorization", admin)]);
        assert_eq!(reply.status, 200, "{path}: {}", reply.text());
        (path, reply.body)
    };
    paths.into_iter().map(answer).collect()
}

/// The target of the migration.
struct Target {
    postgres: Postgres,
    root: tempfile::TempDir,
}

impl Target {
    fn new() -> Self {
        Self {
            postgres: Postgres::start(),
            root: tempfile::tempdir().expect("temporary directory"),
        }
    }

    fn store(&self, name: &str) -> String {
        self.root.path().join(name).display().to_string()
    }

    fn migrate(&self, data: &Path, url: &str, store: &str) -> Result<Migrated> {
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
        runtime.block_on(migrate(data, url, &self.store(store)))
    }

    fn serve(&self, url: &str, store: &str, workers: &str) -> Server {
        Server::start_with(&[
            ("FLED_FAKE_DB", url),
            ("FLED_FAKE_STORE", &self.store(store)),
            ("FLED_FAKE_WORKERS", workers),
        ])
    }

    /// The total of captures, jobs and events in the first database.
    fn rows(&self) -> i64 {
        let count = |table: &str| {
            let count = format!("SELECT COUNT(*) FROM {table}");
            let count = self.postgres.psql("fled_0", &count).expect("counted");
            count.parse::<i64>().expect("a number")
        };
        ["captures", "jobs", "events"].map(count).iter().sum()
    }
}

/// Checks for an error whose message contains `words`.
#[track_caller]
fn refused(outcome: Result<Migrated>, words: &str) {
    let error = outcome.expect_err("refused");
    assert!(error.to_string().contains(words), "{error}");
    assert!(matches!(error, ServerError::NotMoved(_)), "{error:?}");
}

/// Checks that the numbers of an event stream have no gap.
fn has_no_gap(events: &str) {
    let numbers = events.lines().filter_map(|line| line.strip_prefix("id:"));
    let numbers: Vec<i64> =
        numbers.map(|number| number.trim().parse().expect("a number")).collect();
    assert!(numbers.len() > 10, "{events}");
    assert!(numbers.iter().copied().eq(1..=numbers.len() as i64));
}

/// Waits until a job has succeeded, and returns its events.
fn succeeds(api: &Client, job: &str, admin: &str) -> String {
    let headers = [("authorization", admin)];
    let start = std::time::Instant::now();
    let path = format!("/v1/jobs/{job}");
    loop {
        let shown = api.get(&path, &headers).expect(200).json();
        if shown["state"] == "succeeded" {
            return api.get(&format!("{path}/events"), &headers).text();
        }
        assert!(start.elapsed() < Duration::from_secs(60), "{shown:#}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_migrated_server_gives_the_same_answers_and_resumes_jobs() {
    let old = Old::new();
    let new = Target::new();
    let url = new.postgres.database();
    let done = new.migrate(&old.data(), &url, "store").expect("moved");
    assert!(done.rows > 100 && done.files > 20 && done.bytes > 0, "{done:?}");
    assert_eq!(done.uploads, 1);

    let api = new.serve(&url, "store", "0");
    old.expect_same(&api);
    let headers = [("authorization", old.admin.as_str())];
    for job in [&old.running, &old.waiting] {
        let shown = api.get(&format!("/v1/jobs/{job}"), &headers).json();
        assert_eq!(shown["state"], "queued");
    }
    let again = id_of(&api, &old.waits, &keyed(&old.admin));
    assert_eq!(again, old.waiting);

    let _worker = new.serve(&url, "store", "1");
    let scene = |job: &str| {
        let path = format!("/v1/jobs/{job}/artifacts/scene.ply");
        api.get(&path, &headers).expect(200).body
    };
    for job in [&old.running, &old.waiting] {
        has_no_gap(&succeeds(&api, job, &old.admin));
        assert!(scene(job) == scene(&old.done));
    }
    // The finished work of the interrupted job was not repeated.
    let events = succeeds(&api, &old.running, &old.admin);
    assert!(events.contains("\"skipped\":true"), "{events}");
}

#[test]
fn a_failed_migration_leaves_no_row_and_the_old_server_intact() {
    let mut old = Old::new();
    let new = Target::new();
    let url = new.postgres.database();
    let data = old.data();
    refused(new.migrate(&data, "sqlite:other.db", "none"), "postgres://");
    let folder = data.join("captures").join(&old.capture);
    let aside = new.root.path().join("aside");
    fs::rename(&folder, &aside).expect("moved");
    let lost = new.migrate(&data, &url, "broken");
    refused(lost, "no files of capture");
    fs::rename(&aside, &folder).expect("moved");
    assert_eq!(new.rows(), 0);
    old.server.restart_with(&[("FLED_FAKE_WORKERS", "0")]);
    old.expect_same(&old.server);
    let error = new.migrate(&data, &url, "store").expect_err("in use");
    assert!(matches!(error, ServerError::DataInUse(_)), "{error:?}");
    old.server.kill();
    assert_eq!(new.rows(), 0);

    new.migrate(&data, &url, "store").expect("moved");
    assert!(new.rows() > 100);
    refused(new.migrate(&data, &url, "another"), "has rows");
    let other = new.postgres.database();
    refused(new.migrate(&data, &other, "store"), "has files already");
    // A service that already has its files in a blob store.
    let mut stored = Server::start_with(&[("FLED_FAKE_STORE", &new.store("own"))]);
    stored.capture(3);
    stored.kill();
    let stored = stored.data.path().join("data");
    refused(new.migrate(&stored, &other, "another"), "in a store already");
}
