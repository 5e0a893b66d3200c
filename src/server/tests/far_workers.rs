//! Workers that reach their service by HTTP alone: the same jobs, killed and frozen as those that
//! have the database, and what the network may do to them.

mod support;

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use fled_blobs::{Blob, Blobs};
use fled_tests::{Client, Postgres};
use reqwest::header::{HeaderMap, HeaderValue};
use serde_json::{Value, json};
use support::farm::{
    Machine, PATIENCE, SLOW, about, begin, check, expected, in_the_middle, order, succeeds,
};
use support::tokens::token;
use support::{Server, gone};

const PROGRAM: &str = env!("CARGO_BIN_EXE_fled-fake");
const VERSION: &str = env!("CARGO_PKG_VERSION");
/// A worker's name for itself.
const NAME: &str = "01890000-0000-7000-8000-000000000000";

/// A service without workers of its own, that comes back under its address.
struct Service {
    root: tempfile::TempDir,
    database: Option<String>,
    machine: Machine,
    api: Client,
}

impl Service {
    /// With a file for a database, or with this one.
    fn start(database: Option<String>) -> Self {
        let root = tempfile::tempdir().expect("temporary directory");
        let (machine, base) = serve(root.path(), database.as_deref(), "127.0.0.1:0");
        Self {
            root,
            database,
            machine,
            api: Client::new(base, PATIENCE),
        }
    }

    fn restart(&mut self) {
        self.machine.kill();
        let address = self.api.base.trim_start_matches("http://").to_owned();
        let root = self.root.path();
        self.machine = serve(root, self.database.as_deref(), &address).0;
    }

    fn worker(&self, name: &str) -> Machine {
        self.worker_by(name, &self.api.base)
    }

    /// One that reaches it at another address.
    fn worker_by(&self, name: &str, base: &str) -> Machine {
        let about = about(name);
        let worker = far(&about, base);
        begin(self.root.path(), name, &worker).0
    }
}

fn serve(root: &std::path::Path, database: Option<&str>, listen: &str) -> (Machine, String) {
    let store = root.join("store");
    let mut more = vec![
        ("FLED_FAKE_STORE", store.to_str().expect("UTF-8")),
        ("FLED_FAKE_WORKERS", "0"),
        ("FLED_FAKE_LISTEN", listen),
    ];
    more.extend(database.map(|url| ("FLED_FAKE_DB", url)));
    begin(root, "api", &more)
}

fn far<'a>(about: &'a str, base: &'a str) -> [(&'a str, &'a str); 4] {
    [
        ("FLED_FAKE_WORKER", "1"),
        ("FLED_FAKE_WORKERS", "1"),
        ("FLED_FAKE_ABOUT", about),
        ("FLED_FAKE_API", base),
    ]
}

/// Passes connections on to a service. When something comes back, it cuts every so manieth
/// connection instead: what was asked is done, and the answer is lost. Counts them.
fn lossy(base: &str, one_in: u64) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let to = base.trim_start_matches("http://").to_owned();
    let (lost, dice) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicU64::new(7)));
    let counted = lost.clone();
    spawn(move || {
        for client in listener.incoming().flatten() {
            let Ok(server) = TcpStream::connect(&to) else {
                continue;
            };
            let (mut from, mut into) = (client.try_clone().expect("a socket"), server);
            let mut back = into.try_clone().expect("a socket");
            let (dice, counted) = (dice.clone(), counted.clone());
            spawn(move || {
                let _ = std::io::copy(&mut from, &mut into);
                let _ = into.shutdown(Shutdown::Both);
            });
            spawn(move || {
                let mut client = client;
                let mut piece = vec![0; 64 << 10];
                while let Ok(read @ 1..) = back.read(&mut piece) {
                    let last = dice.load(Ordering::Relaxed);
                    let next = last.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    dice.store(next, Ordering::Relaxed);
                    if (next >> 33) % one_in == 0 {
                        counted.fetch_add(1, Ordering::Relaxed);
                        break;
                    }
                    if client.write_all(&piece[..read]).is_err() {
                        break;
                    }
                }
                let _ = client.shutdown(Shutdown::Both);
                let _ = back.shutdown(Shutdown::Both);
            });
        }
    });
    (format!("http://{address}"), lost)
}

#[test]
fn a_job_that_a_worker_makes_by_http_is_the_same_on_both_databases() {
    let calm = expected();
    let postgres = Postgres::start();
    for database in [None, Some(postgres.database())] {
        let service = Service::start(database);
        let worker = service.worker("worker");
        let job = order(&service.api, SLOW);
        in_the_middle(&service.api, &job);
        let listed = service.api.get("/v1/workers", &[]).expect(200).json();
        assert_eq!(listed["workers"][0]["host"], "worker", "{listed}");
        assert_eq!(listed["workers"][0]["running"][0]["job_id"], job.as_str());
        succeeds(&service.api, &job, &calm);
        assert_eq!(service.api.show(&job)["attempts"], 1);
        let log = service
            .api
            .get(&format!("/v1/jobs/{job}/log"), &[])
            .expect(200);
        assert!(log.text().contains("finished"), "{}", log.text());
        assert!(worker.folder.join("data/jobs").join(&job).is_dir());
        assert!(!worker.folder.join("data/fled.db").exists());
        // What somebody asks to stop is stopped.
        let job = order(&service.api, "slow:100");
        in_the_middle(&service.api, &job);
        service
            .api
            .post(&format!("/v1/jobs/{job}/cancel"), b"", &[])
            .expect(202);
        service.api.wait_state(&job, "cancelled");
        assert!(gone(&job), "its process ends");
    }
}

#[test]
fn a_far_worker_that_is_killed_or_frozen_loses_its_job_and_nothing_else() {
    let calm = expected();
    let service = Service::start(None);
    let api = &service.api;
    let mut first = service.worker("first");
    let job = order(api, SLOW);
    in_the_middle(api, &job);
    first.kill();
    assert!(gone(&job), "its process ends with it");
    let second = service.worker("second");
    succeeds(api, &job, &calm);
    assert_eq!(api.show(&job)["attempts"], 2);
    // Frozen for longer than a lease: when it thaws, another has the job.
    let job = order(api, SLOW);
    in_the_middle(api, &job);
    second.signal("-STOP");
    let third = service.worker("third");
    api.wait(&job, "is another's", |shown| shown["attempts"] == 2);
    second.signal("-CONT");
    succeeds(api, &job, &calm);
    drop(second);
    // Killed by hand, and back at once: it has its own job again without waiting for the lease.
    let job = order(api, SLOW);
    in_the_middle(api, &job);
    drop(third);
    let back = Instant::now();
    let _third = service.worker("third");
    api.wait(&job, "goes on", |shown| shown["attempts"] == 2);
    assert!(
        back.elapsed() < Duration::from_secs(4),
        "{:?}",
        back.elapsed()
    );
    succeeds(api, &job, &calm);
}

#[test]
fn a_far_worker_that_is_told_to_stop_gives_its_job_back() {
    let calm = expected();
    let service = Service::start(None);
    let api = &service.api;
    let first = service.worker("first");
    let job = order(api, SLOW);
    in_the_middle(api, &job);
    first.signal("-INT");
    let shown = api.wait(&job, "waits again", |shown| shown["state"] == "queued");
    assert!(shown["error"].is_null(), "{shown}");
    let begun = Instant::now();
    let workers = || api.get("/v1/workers", &[]).expect(200).json()["workers"].clone();
    while workers() != json!([]) {
        assert!(begun.elapsed() < PATIENCE, "it has not said that it goes");
        sleep(Duration::from_millis(50));
    }
    let _second = service.worker("second");
    succeeds(api, &job, &calm);
    assert_eq!(api.show(&job)["attempts"], 2);
}

#[test]
fn a_service_that_is_killed_and_comes_back_goes_on_with_its_far_workers() {
    let calm = expected();
    let postgres = Postgres::start();
    for database in [None, Some(postgres.database())] {
        let mut service = Service::start(database);
        let _worker = service.worker("worker");
        for away in [Duration::ZERO, Duration::from_secs(9)] {
            let job = order(&service.api, SLOW);
            in_the_middle(&service.api, &job);
            service.machine.kill();
            sleep(away);
            service.restart();
            succeeds(&service.api, &job, &calm);
            if away.is_zero() {
                // Nobody took its lease from it.
                assert_eq!(service.api.show(&job)["attempts"], 1);
            }
        }
    }
}

#[test]
fn answers_that_are_lost_on_their_way_do_nothing_twice() {
    let calm = expected();
    let service = Service::start(None);
    let (base, lost) = lossy(&service.api.base, 8);
    let _worker = service.worker_by("worker", &base);
    for _ in 0..3 {
        let job = order(&service.api, SLOW);
        service.api.wait_state(&job, "succeeded");
        let events = service.api.events(&job, 0, usize::MAX);
        check(&events);
        succeeds(&service.api, &job, &calm);
    }
    let lost = lost.load(Ordering::Relaxed);
    assert!(lost > 10, "{lost} answers were lost");
    eprintln!("{lost} answers were lost");
}

#[test]
fn a_worker_waits_for_a_service_that_is_not_there_yet() {
    let calm = expected();
    let free = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = free.local_addr().expect("an address").to_string();
    drop(free);
    let root = tempfile::tempdir().expect("temporary directory");
    let (about, base) = (about("early"), format!("http://{address}"));
    let mut worker = Command::new(PROGRAM);
    worker
        .arg("serve")
        .args(["early", "early.address"].map(|name| root.path().join(name)));
    let mut worker = worker.envs(far(&about, &base)).spawn().expect("starts");
    sleep(Duration::from_secs(1));
    assert!(worker.try_wait().expect("a process").is_none(), "it waits");
    let (_machine, base) = serve(root.path(), None, &address);
    let api = Client::new(base, PATIENCE);
    let job = order(&api, "ok");
    succeeds(&api, &job, &calm);
    worker.kill().expect("killed");
    worker.wait().expect("gone");
}

/// Starts a worker that is refused; its words.
fn refused(base: &str, shown: Option<&str>) -> String {
    let root = tempfile::tempdir().expect("temporary directory");
    let about = about("refused");
    let mut worker = Command::new(PROGRAM);
    worker
        .arg("serve")
        .args(["data", "address"].map(|name| root.path().join(name)));
    worker.envs(far(&about, base));
    worker.envs(shown.map(|token| ("FLED_FAKE_TOKEN", token)));
    let output = worker.output().expect("runs");
    assert!(!output.status.success(), "{output:?}");
    assert!(!root.path().join("address").exists());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn only_who_may_work_here_works_here_and_does_nothing_else() {
    let folder = tempfile::tempdir().expect("temporary directory");
    let store = folder.path().to_str().expect("UTF-8");
    let shared = [("FLED_FAKE_STORE", store), ("FLED_FAKE_WORKERS", "0")];
    let server = Server::start_with(&shared);
    let (worker, _) = token(&server, "worker");
    let (user, _) = token(&server, "jobs:read,jobs:write,renders");
    let of = |header: &str| header.trim_start_matches("Bearer ").to_owned();
    let base = &server.base;
    assert!(refused(base, None).contains("This needs a token."));
    assert!(refused(base, Some("fled_0")).contains("unknown, revoked or has expired"));
    assert!(refused(base, Some(&of(&user))).contains("does not allow `worker`"));
    let own = Server::start();
    assert!(refused(&own.base, None).contains("--store"));
    assert!(refused("ftp://example.org", None).contains("neither https:// nor http://"));

    let ask = |who: &str, version: &str, method: &str, path: &str, body: &Value| {
        let headers = [
            ("authorization", who),
            ("fled-version", version),
            ("content-type", "application/json"),
        ];
        server.ask(method, path, &headers, body.to_string().as_bytes())
    };
    let (release, none) = (format!("/v1/work/workers/{NAME}/release"), json!({}));
    ask(&worker, VERSION, "POST", &release, &none).expect(200);
    let other = ask(&worker, "99.1.0", "POST", &release, &none)
        .expect(409)
        .json();
    assert_eq!(other["code"], "other_version", "{other}");
    assert!(
        other["detail"].as_str().expect("words").contains("99.1.0"),
        "{other}"
    );
    for (method, path) in [
        ("POST", release.clone()),
        ("GET", format!("/v1/work/blobs/{}", "0".repeat(64))),
        ("GET", "/v1/work/jobs/j/files?epoch=1".to_owned()),
    ] {
        let reply = ask(&user, VERSION, method, &path, &none).expect(403);
        assert_eq!(reply.json()["code"], "missing_scope", "{path}");
    }
    for path in ["/v1/jobs", "/v1/captures", "/v1/workers", "/metrics"] {
        ask(&worker, VERSION, "GET", path, &none).expect(403);
    }
    // A name that means more in a lease is none.
    ask(
        &worker,
        VERSION,
        "POST",
        "/v1/work/workers/%25/release",
        &none,
    )
    .expect(422);
    let over = ask(
        &worker,
        VERSION,
        "GET",
        "/v1/work/jobs/j/files?epoch=1",
        &none,
    );
    assert_eq!(over.expect(409).json()["code"], "lease_lost");
}

#[test]
fn a_wish_that_is_said_twice_is_granted_once() {
    let service = Service::start(None);
    let job = order(&service.api, "ok");
    let headers = [("fled-version", VERSION)];
    let path = format!("/v1/work/workers/{NAME}/claim");
    let wish = |wish: &str| {
        let wanted = json!({ "turn": 0, "wish": wish, "running": [], "has_gpu": false,
                             "memory": 1_000_000_000 });
        service.api.post_json(&path, &wanted, &headers)
    };
    let first = wish(NAME).expect(200).json();
    assert_eq!(first["job"], job.as_str());
    assert_eq!(wish(NAME).expect(200).json(), first);
    wish("01890000-0000-7000-8000-000000000001").expect(204);
}

#[test]
fn bytes_come_through_whole_or_not_at_all() {
    let service = Service::start(None);
    let mut headers = HeaderMap::new();
    headers.insert("fled-version", HeaderValue::from_static(VERSION));
    let client = || {
        reqwest::Client::builder()
            .default_headers(headers.clone())
            .build()
    };
    fled_blobs::choose_tls();
    let place = format!("{}/v1/work/blobs", service.api.base);
    let blobs = Blobs::of_service(client().expect("one"), client().expect("one"), &place);
    let folder = tempfile::tempdir().expect("temporary directory");
    let runtime = tokio::runtime::Runtime::new().expect("runtime");
    let (from, to) = (folder.path().join("from"), folder.path().join("to"));
    runtime.block_on(async {
        // In one request and in pieces, and again when it is there already.
        for bytes in [0, 1000, (16 << 20) + 1, 40 << 20] {
            let data: Vec<u8> = (0..bytes).map(|i: usize| ((i * i) >> 7) as u8).collect();
            std::fs::write(&from, &data).expect("written");
            for _ in 0..2 {
                let blob = blobs.put(&from).await.expect("kept");
                blobs.fetch(&blob, &to).await.expect("fetched");
            }
            assert!(std::fs::read(&to).expect("read") == data);
        }
        let missing = Blob::of(b"nobody has sent this");
        let missing = blobs.fetch(&missing, &to).await;
        assert!(
            matches!(missing, Err(fled_blobs::BlobError::Missing { .. })),
            "{missing:?}"
        );
    });
    let digest = Blob::of(b"one thing").digest;
    let path = format!("/v1/work/blobs/{digest}");
    let versioned = [("fled-version", VERSION)];
    let wrong = service.api.ask("PUT", &path, &versioned, b"another");
    assert_eq!(wrong.expect(422).json()["code"], "wrong_digest");
    service.api.get(&path, &versioned).expect(404);
    let incoming = service.root.path().join("api/data/incoming");
    assert_eq!(std::fs::read_dir(incoming).expect("a folder").count(), 0);
    // What is damaged where it lies is not taken.
    let blob = runtime
        .block_on(blobs.put_bytes(b"one thing".to_vec()))
        .expect("kept");
    let lies = service
        .root
        .path()
        .join("store/blobs")
        .join(&digest[..2])
        .join(&digest);
    std::fs::write(lies, b"one thinG").expect("damaged");
    let damaged = runtime.block_on(blobs.fetch(&blob, &to));
    assert!(
        matches!(damaged, Err(fled_blobs::BlobError::Damaged { .. })),
        "{damaged:?}"
    );
}
