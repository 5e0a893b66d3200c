//! Several machines: replicas of the API and workers as separate processes, with a PostgreSQL and a
//! blob store of the test's own.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_tests::{Client, Postgres, S3};
use serde_json::{Value, json};

use super::{Server, photographs};

const PROGRAM: &str = env!("CARGO_BIN_EXE_fled-fake");
/// Timeout of a job, through all faults.
pub const PATIENCE: Duration = Duration::from_secs(60);
/// Stages of such a job take 0.3 s each.
pub const SLOW: &str = "slow:30";

pub type Events = Vec<(i64, String, Value)>;

/// A process: a replica or a worker.
pub struct Machine {
    pub folder: PathBuf,
    child: Child,
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.kill();
    }
}

impl Machine {
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// The id of its process.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Waits until it has ended by itself.
    pub fn dies(&mut self) {
        let begun = Instant::now();
        while self.child.try_wait().expect("a child").is_none() {
            assert!(begun.elapsed() < PATIENCE, "it lives");
            sleep(Duration::from_millis(10));
        }
    }

    pub fn signal(&self, signal: &str) {
        let sent = Command::new("kill").args([signal, &self.child.id().to_string()]).status();
        assert!(sent.expect("kill runs").success());
    }
}

/// The shared resources of all machines.
pub struct Farm {
    pub postgres: Postgres,
    pub url: String,
    pub root: tempfile::TempDir,
    /// The blob store; if absent, a folder in `root`.
    pub bucket: Option<S3>,
}

impl Farm {
    pub fn new() -> Self {
        let postgres = Postgres::start();
        Self {
            url: postgres.database(),
            postgres,
            root: tempfile::tempdir().expect("temporary directory"),
            bucket: None,
        }
    }

    /// With a bucket for the files.
    pub fn with_bucket() -> Self {
        let bucket = Some(S3::start());
        Self { bucket, ..Self::new() }
    }

    pub fn store(&self) -> PathBuf {
        self.root.path().join("store")
    }

    /// Starts or restarts a process.
    pub fn start(&self, name: &str, more: &[(&str, &str)]) -> (Machine, String) {
        self.start_by(&[], name, more)
    }

    /// Like [`Farm::start`], through a program that isolates it.
    pub fn start_by(&self, by: &[&str], name: &str, more: &[(&str, &str)]) -> (Machine, String) {
        let store = self.store();
        let mut shared = vec![("FLED_FAKE_DB", self.url.as_str())];
        match &self.bucket {
            Some(bucket) => {
                shared.extend(bucket.settings());
                shared.push(("FLED_FAKE_STORE", "s3://bucket/farm"));
            }
            None => shared.push(("FLED_FAKE_STORE", store.to_str().expect("UTF-8"))),
        }
        begin_by(by, self.root.path(), name, &[&shared, more].concat())
    }

    /// A replica of the API that runs no jobs.
    pub fn replica(&self, name: &str) -> (Machine, Client) {
        let (machine, base) = self.start(name, &[("FLED_FAKE_WORKERS", "0")]);
        (machine, Client::new(base, PATIENCE))
    }

    pub fn worker(&self, name: &str) -> Machine {
        self.worker_by(&[], name, &[])
    }

    /// A worker started through a program that isolates it, with more variables.
    pub fn worker_by(&self, by: &[&str], name: &str, more: &[(&str, &str)]) -> Machine {
        let about = about(name);
        let worker = [
            ("FLED_FAKE_WORKER", "1"),
            ("FLED_FAKE_WORKERS", "1"),
            ("FLED_FAKE_ABOUT", about.as_str()),
        ];
        let variables: Vec<_> = worker.iter().chain(more).copied().collect();
        self.start_by(by, name, &variables).0
    }
}

/// Starts or restarts a process with its own folder below `root`, and returns its address.
pub fn begin(root: &Path, name: &str, more: &[(&str, &str)]) -> (Machine, String) {
    begin_by(&[], root, name, more)
}

/// Like [`begin`], through a program that isolates it.
fn begin_by(by: &[&str], root: &Path, name: &str, more: &[(&str, &str)]) -> (Machine, String) {
    let folder = root.join(name);
    std::fs::create_dir_all(&folder).expect("a folder");
    let address_file = folder.join("address");
    let _ = std::fs::remove_file(&address_file);
    let mut words = by.iter().copied().chain([PROGRAM]);
    let child = Command::new(words.next().unwrap_or(PROGRAM))
        .args(words)
        .arg("serve")
        .arg(folder.join("data"))
        .arg(&address_file)
        .env("FLED_MODELS", folder.join("models"))
        .envs(more.iter().copied())
        .spawn()
        .expect("starts");
    let begun = Instant::now();
    while !address_file.is_file() {
        assert!(begun.elapsed() < PATIENCE, "{name} does not start");
        sleep(Duration::from_millis(10));
    }
    let address = std::fs::read_to_string(&address_file).expect("reported");
    (Machine { folder, child }, format!("http://{address}"))
}

/// What a worker reports about itself, for its environment.
fn about(name: &str) -> String {
    json!({ "host": name, "version": "1", "adapter": null, "has_gpu": false,
            "cores": 2, "memory": 1_000_000_000, "jobs": 1 })
    .to_string()
}

/// Creates a job with this plan, and returns its id.
pub fn order(api: &Client, plan: &str) -> String {
    let capture = api.upload("/v1/captures", &photographs(4), &[]).expect(201);
    let body = json!({ "capture_id": capture.json()["id"], "preset": "preview",
                       "options": { "adapter": plan } });
    let made = api.post_json("/v1/jobs", &body, &[]).expect(202);
    made.json()["id"].as_str().expect("id").to_owned()
}

/// The scene of an undisturbed job.
pub fn expected() -> Vec<u8> {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    scene(&server, &job)
}

pub fn scene(api: &Client, job: &str) -> Vec<u8> {
    let path = format!("/v1/jobs/{job}/artifacts/scene.ply");
    api.get(&path, &[]).expect(200).body
}

/// Checks the events of a successful job, whatever happened to its workers.
pub fn check(events: &Events) {
    let seqs: Vec<i64> = events.iter().map(|(seq, ..)| *seq).collect();
    assert!(seqs.iter().copied().eq(1..=seqs.len() as i64), "{seqs:?}");
    let mut state = "";
    let mut done = HashSet::new();
    for (seq, kind, data) in events {
        let running = state == "running";
        match kind.as_str() {
            "state" => {
                let next = data["state"].as_str().expect("a state");
                let follows = match next {
                    "queued" => state.is_empty() || running,
                    "running" => state == "queued",
                    "succeeded" => running,
                    _ => false,
                };
                assert!(follows, "{seq}: {next} after {state}");
                state = next;
            }
            "stage_finished" if data["skipped"] == false => {
                let stage = (data["stage"].to_string(), data["round"].to_string());
                assert!(running && done.insert(stage), "{seq}: done twice: {data}");
            }
            _ => assert!(running, "{seq}: {kind} while {state}"),
        }
    }
    assert_eq!(state, "succeeded");
}

/// Waits until a job is halfway.
pub fn in_the_middle(api: &Client, job: &str) {
    api.wait(job, "is in its middle", |shown| {
        shown["state"] == "running" && shown["progress"].as_f64().is_some_and(|done| done > 0.3)
    });
}

pub fn succeeds(api: &Client, job: &str, scene_of_calm: &[u8]) {
    api.wait_state(job, "succeeded");
    check(&api.events(job, 0, usize::MAX));
    assert!(scene(api, job) == scene_of_calm, "another scene");
}
