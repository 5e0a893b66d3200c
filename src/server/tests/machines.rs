//! Many machines: replicas of the API and workers as processes of their own, with a PostgreSQL and
//! a store of files of the test's own, and what may happen to them.

mod support;

use std::collections::HashSet;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use fled_tests::{Client, Postgres};
use serde_json::{Value, json};
use support::{gone, photographs};

const PROGRAM: &str = env!("CARGO_BIN_EXE_fled-fake");
/// A job may take so long, through everything that happens to it.
const PATIENCE: Duration = Duration::from_secs(60);
/// Stages of such a job take 0.3 s each.
const SLOW: &str = "slow:30";

type Events = Vec<(i64, String, Value)>;

/// One process: a replica or a worker.
struct Machine {
    folder: PathBuf,
    child: Child,
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.kill();
    }
}

impl Machine {
    fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    fn signal(&self, signal: &str) {
        let sent = Command::new("kill")
            .args([signal, &self.child.id().to_string()])
            .status();
        assert!(sent.expect("kill runs").success());
    }
}

/// All of them, and what they share.
struct Farm {
    postgres: Postgres,
    url: String,
    root: tempfile::TempDir,
}

impl Farm {
    fn new() -> Self {
        let postgres = Postgres::start();
        Self {
            url: postgres.database(),
            postgres,
            root: tempfile::tempdir().expect("temporary directory"),
        }
    }

    fn store(&self) -> PathBuf {
        self.root.path().join("store")
    }

    /// Begins a process, or begins it again.
    fn start(&self, name: &str, more: &[(&str, &str)]) -> (Machine, String) {
        let folder = self.root.path().join(name);
        std::fs::create_dir_all(&folder).expect("a folder");
        let told = folder.join("address");
        let _ = std::fs::remove_file(&told);
        let child = Command::new(PROGRAM)
            .arg("serve")
            .arg(folder.join("data"))
            .arg(&told)
            .env("FLED_MODELS", folder.join("models"))
            .env("FLED_FAKE_DB", &self.url)
            .env("FLED_FAKE_STORE", self.store())
            .envs(more.iter().copied())
            .spawn()
            .expect("starts");
        let begun = Instant::now();
        while !told.is_file() {
            assert!(begun.elapsed() < PATIENCE, "{name} does not start");
            sleep(Duration::from_millis(10));
        }
        // Its words are there a moment after its name.
        sleep(Duration::from_millis(20));
        let address = std::fs::read_to_string(&told).expect("told");
        (Machine { folder, child }, format!("http://{address}"))
    }

    /// A replica of the API, which works on nothing.
    fn replica(&self, name: &str) -> (Machine, Client) {
        let (machine, base) = self.start(name, &[("FLED_FAKE_WORKERS", "0")]);
        (machine, Client::new(base, PATIENCE))
    }

    fn worker(&self, name: &str) -> Machine {
        let about = json!({ "host": name, "version": "1", "adapter": null, "has_gpu": false,
                            "cores": 2, "memory": 1_000_000_000, "jobs": 1 });
        let about = about.to_string();
        let worker = [
            ("FLED_FAKE_WORKER", "1"),
            ("FLED_FAKE_WORKERS", "1"),
            ("FLED_FAKE_ABOUT", about.as_str()),
        ];
        self.start(name, &worker).0
    }
}

/// A job of the plan; its id.
fn order(api: &Client, plan: &str) -> String {
    let capture = api.upload("/v1/captures", &photographs(4), &[]).expect(201);
    let body = json!({ "capture_id": capture.json()["id"], "preset": "preview",
                       "options": { "adapter": plan } });
    let made = api.post_json("/v1/jobs", &body, &[]).expect(202);
    made.json()["id"].as_str().expect("id").to_owned()
}

/// What a job that nothing happens to leaves.
fn expected() -> Vec<u8> {
    let server = support::Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    scene(&server, &job)
}

fn scene(api: &Client, job: &str) -> Vec<u8> {
    let path = format!("/v1/jobs/{job}/artifacts/scene.ply");
    api.get(&path, &[]).expect(200).body
}

/// What must hold of the events of a job that succeeded, whatever happened to its workers.
fn check(events: &Events) {
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

/// Waits until a job is in its middle.
fn in_the_middle(api: &Client, job: &str) {
    api.wait(job, "is in its middle", |shown| {
        shown["state"] == "running" && shown["progress"].as_f64().is_some_and(|done| done > 0.3)
    });
}

fn succeeds(api: &Client, job: &str, scene_of_calm: &[u8]) {
    api.wait_state(job, "succeeded");
    check(&api.events(job, 0, usize::MAX));
    assert!(scene(api, job) == scene_of_calm, "another scene");
}

#[test]
fn a_job_that_is_posted_at_one_replica_is_made_by_a_worker_and_seen_at_another() {
    let farm = Farm::new();
    let calm = expected();
    let (_one, one) = farm.replica("one");
    let (mut two, at_two) = farm.replica("two");
    let worker = farm.worker("worker");
    let job = order(&one, SLOW);
    // Events at the second replica, until it is killed, and from there on at the first.
    let listener = {
        let (base, job) = (at_two.base.clone(), job.clone());
        spawn(move || Client::new(base, PATIENCE).events(&job, 0, usize::MAX))
    };
    in_the_middle(&one, &job);
    two.kill();
    let mut events = listener.join().unwrap_or_default();
    assert!(!events.is_empty(), "they came as they happened");
    let after = events.last().map_or(0, |(seq, ..)| *seq);
    one.wait_state(&job, "succeeded");
    events.extend(one.events(&job, after, usize::MAX));
    check(&events);
    assert_eq!(events, one.events(&job, 0, usize::MAX));
    assert!(scene(&one, &job) == calm);
    let render = format!("/v1/jobs/{job}/render?azimuth=30");
    one.get(&render, &[]).expect(200);
    let log = one.get(&format!("/v1/jobs/{job}/log"), &[]).expect(200);
    assert!(log.text().contains("finished"), "{}", log.text());
    assert!(worker.folder.join("data/jobs").join(&job).is_dir());
    // A replica that begins later has all of it, too.
    let (_three, three) = farm.replica("three");
    assert!(scene(&three, &job) == calm);
    let listed = three.get("/v1/jobs", &[]).expect(200).json();
    assert_eq!(listed["jobs"].as_array().map(Vec::len), Some(1));
}

#[test]
fn a_worker_that_is_killed_frozen_or_cut_off_loses_its_job_and_nothing_else() {
    let farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    let mut first = farm.worker("first");
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    first.kill();
    assert!(gone(&job), "its process ends with it");
    let second = farm.worker("second");
    succeeds(&api, &job, &calm);
    assert_eq!(api.show(&job)["attempts"], 2);

    // Frozen for longer than a lease: when it thaws, another has the job.
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    second.signal("-STOP");
    let third = farm.worker("third");
    api.wait(&job, "is another's", |shown| shown["attempts"] == 2);
    second.signal("-CONT");
    succeeds(&api, &job, &calm);
    drop(second);

    // Killed by hand, and back at once: it has its own job again without waiting for the lease.
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    drop(third);
    let back = Instant::now();
    let _third = farm.worker("third");
    api.wait(&job, "goes on", |shown| shown["attempts"] == 2);
    assert!(
        back.elapsed() < Duration::from_secs(4),
        "{:?}",
        back.elapsed()
    );
    succeeds(&api, &job, &calm);
}

#[test]
fn a_database_and_a_store_that_are_away_for_a_while_lose_nothing() {
    let mut farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    let _worker = farm.worker("worker");
    for away in [Duration::from_secs(2), Duration::from_secs(9)] {
        let job = order(&api, SLOW);
        in_the_middle(&api, &job);
        farm.postgres.kill();
        sleep(away);
        farm.postgres.begin();
        // Connections that were cut are noticed when they are used.
        let back = Instant::now();
        while api.get(&format!("/v1/jobs/{job}"), &[]).status != 200 {
            assert!(back.elapsed() < PATIENCE, "the API does not come back");
            sleep(Duration::from_millis(100));
        }
        succeeds(&api, &job, &calm);
    }
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    let (store, aside) = (farm.store(), farm.root.path().join("aside"));
    std::fs::rename(&store, &aside).expect("away");
    sleep(Duration::from_secs(2));
    let _ = std::fs::remove_dir_all(&store);
    std::fs::rename(&aside, &store).expect("back");
    succeeds(&api, &job, &calm);
}

#[test]
fn forty_jobs_on_three_workers_that_are_killed_at_random_are_all_done_once() {
    let farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    let mut workers: Vec<Machine> = (0..3).map(|i| farm.worker(&format!("w{i}"))).collect();
    let capture = api.upload("/v1/captures", &photographs(4), &[]).expect(201);
    let capture = capture.json()["id"].clone();
    let jobs: Vec<String> = (0..40)
        .map(|_| {
            let body = json!({ "capture_id": capture, "preset": "preview",
                               "options": { "adapter": "slow:4" } });
            let made = api.post_json("/v1/jobs", &body, &[]).expect(202);
            made.json()["id"].as_str().expect("id").to_owned()
        })
        .collect();
    let mut dice: u64 = 7;
    let begun = Instant::now();
    let mut kills = 0;
    while begun.elapsed() < Duration::from_secs(20) {
        dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        sleep(Duration::from_millis(300 + (dice >> 33) % 900));
        let which = ((dice >> 40) % 3) as usize;
        workers[which].kill();
        workers[which] = farm.worker(&format!("w{which}"));
        kills += 1;
    }
    assert!(kills > 10, "{kills}");
    for job in &jobs {
        succeeds(&api, job, &calm);
    }
    let told = farm.postgres.psql(
        "fled_0",
        "SELECT COUNT(*) FROM events WHERE kind = 'state' AND data LIKE '%succeeded%'",
    );
    assert_eq!(told.as_deref(), Ok("40"), "each is done once");
    eprintln!("{kills} kills, {:.0} s", begun.elapsed().as_secs_f64());
}
