//! Faults of one machine among many, each at a chosen moment: a crash, a network cut, a wrong
//! clock, a failing bucket. The job ends as it would without the fault.

use std::fs;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use crate::support::farm::{
    Farm, Machine, PATIENCE, SLOW, expected, in_the_middle, order, succeeds,
};
use crate::support::{gone, photographs};
use fled_server::Failpoint;
use fled_tests::{Fault, processes_of};
use serde_json::json;

#[test]
#[ignore = "make test-nightly"]
fn a_worker_may_die_at_any_failpoint() {
    let farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    for (index, failpoint) in Failpoint::ALL.into_iter().enumerate() {
        let times = match failpoint {
            Failpoint::Extended => 2,
            Failpoint::Recorded | Failpoint::Advanced | Failpoint::Stored | Failpoint::Named => 4,
            _ => 1,
        };
        let plan = format!("{failpoint}:{times}");
        let name = format!("worker-{index}");
        let mut worker = farm.worker_by(&[], &name, &[("FLED_FAKE_DIE_AT", &plan)]);
        let job = order(&api, "slow:12");
        if failpoint == Failpoint::Stopping {
            in_the_middle(&api, &job);
            worker.signal("-INT");
        }
        worker.dies();
        assert!(gone(&job), "{failpoint}: its process ends with it");
        // The same worker, back at once, or another one, after its lease has expired.
        let successor = if index % 2 == 0 { name } else { format!("heir-{index}") };
        let _successor = farm.worker(&successor);
        succeeds(&api, &job, &calm);
        let attempts = if failpoint == Failpoint::Settled { 1 } else { 2 };
        assert_eq!(api.show(&job)["attempts"], attempts, "{failpoint}");
    }
    let count = farm.postgres.psql(
        "fled_0",
        "SELECT COUNT(*) FROM events WHERE kind = 'state' AND data LIKE '%succeeded%'",
    );
    assert_eq!(count.as_deref(), Ok("12"), "each is done once");
}

#[test]
#[ignore = "make test-nightly"]
fn wrong_clocks_do_not_disturb_workers() {
    let farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    let (plus, minus) = (wrong_clock("+1h"), wrong_clock("-1h"));
    let mut ahead = with_clock(&farm, "ahead", &plus);
    let behind = with_clock(&farm, "behind", &minus);
    let jobs: Vec<String> = (0..4).map(|_| order(&api, "slow:30")).collect();
    for job in &jobs {
        succeeds(&api, job, &calm);
        let shown = api.show(job);
        assert_eq!(shown["attempts"], 1, "no worker took it for lost");
        let took = seconds(&shown["finished_at"]) - seconds(&shown["created_at"]);
        assert!((0..60).contains(&took), "{took} s by the database's clock");
    }
    // Now one of them alone, killed: the other waits until its lease ends, like any worker.
    drop(behind);
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    let begun = Instant::now();
    ahead.kill();
    let _behind = with_clock(&farm, "behind", &minus);
    api.wait(&job, "is another's", |shown| shown["attempts"] == 2);
    assert!(begun.elapsed() > Duration::from_secs(3), "{:?}", begun.elapsed());
    succeeds(&api, &job, &calm);
}

type Environment = Vec<(String, String)>;

/// Environment variables that shift a process's time of day but not its monotonic clock.
fn wrong_clock(offset: &str) -> Environment {
    let by = ["--exclude-monotonic", "-f", offset];
    let output = Command::new("faketime").args(by).arg("env").output();
    let output = String::from_utf8(output.expect("faketime runs").stdout).expect("words");
    let is_meant =
        |name: &str| name == "LD_PRELOAD" || name.contains("FAKE") && name != "FAKETIME_SHARED";
    let clock: Environment = output
        .lines()
        .filter_map(|line| line.split_once('='))
        .filter(|(name, _)| is_meant(name))
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .collect();
    let shown = Command::new("date").arg("+%s").envs(clock.clone()).output();
    let shown = String::from_utf8(shown.expect("date runs").stdout).expect("words");
    let shown: u64 = shown.trim().parse().expect("a time");
    let now = std::time::SystemTime::UNIX_EPOCH.elapsed().expect("after 1970");
    assert!(shown.abs_diff(now.as_secs()) > 3500, "it is not wrong");
    clock
}

fn with_clock(farm: &Farm, name: &str, clock: &Environment) -> Machine {
    let clock: Vec<(&str, &str)> =
        clock.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
    farm.worker_by(&[], name, &clock)
}

/// Seconds since the start of the month of an RFC 3339 time.
fn seconds(time: &serde_json::Value) -> i64 {
    let time = time.as_str().expect("a time");
    let part = |from: usize, to: usize| time[from..to].parse::<i64>().expect("digits");
    part(8, 10) * 86_400 + part(11, 13) * 3600 + part(14, 16) * 60 + part(17, 19)
}

/// A network namespace connected to this one by a pair of virtual interfaces.
struct Wire {
    name: String,
    host: Ipv4Addr,
}

impl Wire {
    /// Creates the namespace; `None` if this user may not.
    fn new() -> Option<Self> {
        let name = format!("fled{}", std::process::id());
        // From the block for benchmarks (RFC 2544), which no real network uses.
        let number = (std::process::id() % 0x4000) << 2;
        let host = Ipv4Addr::from_bits(Ipv4Addr::new(198, 18, 0, 0).to_bits() + number + 1);
        let far = Ipv4Addr::from_bits(host.to_bits() + 1);
        let wire = Self { name, host };
        let (net, end, other) = (&wire.name, wire.end('h'), wire.end('w'));
        let made = [
            format!("netns add {net}"),
            format!("link add {end} type veth peer name {other} netns {net}"),
            format!("addr add {host}/30 dev {end}"),
            format!("link set {end} up"),
            format!("-n {net} addr add {far}/30 dev {other}"),
            format!("-n {net} link set {other} up"),
            format!("-n {net} link set lo up"),
        ];
        made.iter().all(|words| ip(words)).then_some(wire)
    }

    fn end(&self, which: char) -> String {
        format!("{}{which}", self.name.trim_start_matches("fled"))
    }

    fn cut(&self) {
        assert!(ip(&format!("link set {} down", self.end('h'))));
    }

    fn mend(&self) {
        assert!(ip(&format!("link set {} up", self.end('h'))));
    }

    /// Forwards connections from the other side to the same port of this machine.
    fn lead_to(&self, port: u16) {
        let listener = TcpListener::bind((self.host, port)).expect("an address");
        spawn(move || {
            for near in listener.incoming().flatten() {
                let far = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("it listens");
                for (mut from, mut to) in [(&near, &far), (&far, &near)].map(|(from, to)| {
                    (from.try_clone().expect("a socket"), to.try_clone().expect("a socket"))
                }) {
                    spawn(move || {
                        let mut bytes = [0; 1 << 16];
                        while let Ok(read @ 1..) = from.read(&mut bytes) {
                            if to.write_all(&bytes[..read]).is_err() {
                                break;
                            }
                        }
                        let _ = to.shutdown(std::net::Shutdown::Both);
                    });
                }
            }
        });
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        ip(&format!("netns del {}", self.name));
    }
}

fn ip(words: &str) -> bool {
    let done = Command::new("ip").args(words.split(' ')).output();
    done.is_ok_and(|done| done.status.success())
}

#[test]
#[ignore = "make test-nightly"]
fn a_worker_without_network_ends_its_job_and_later_returns() {
    let Some(wire) = Wire::new() else {
        eprintln!("left out: this user may make no network of its own (ip netns)");
        return;
    };
    let farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    let port = farm.postgres.port();
    wire.lead_to(port);
    let there = farm.url.replace("127.0.0.1", &wire.host.to_string());
    let by = ["ip", "netns", "exec", &wire.name];
    let far = farm.worker_by(&by, "far", &[("FLED_FAKE_DB", &there)]);
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    wire.cut();
    let cut = Instant::now();
    // No other worker has the job yet: it ends because its worker has lost contact.
    while processes_of(&job) > 0 {
        assert!(cut.elapsed() < Duration::from_secs(10), "it works on unheard");
        sleep(Duration::from_millis(50));
    }
    let ended = cut.elapsed();
    assert_eq!(api.show(&job)["attempts"], 1);
    let near = farm.worker("near");
    succeeds(&api, &job, &calm);
    assert!(ended < Duration::from_secs(5), "before its lease ends, not after {ended:?}");
    sleep(Duration::from_secs(8).saturating_sub(cut.elapsed()));
    wire.mend();
    drop(near);
    let job = order(&api, SLOW);
    succeeds(&api, &job, &calm);
    assert_eq!(api.show(&job)["attempts"], 1, "it is back");
    assert!(far.folder.join("data/jobs").join(&job).is_dir());
}

#[test]
#[ignore = "make test-nightly"]
fn a_failing_or_slow_bucket_loses_nothing() {
    let farm = Farm::with_bucket();
    let bucket = farm.bucket.as_ref().expect("a bucket");
    let calm = expected();
    let (_api, api) = farm.replica("api");
    let mut worker = farm.worker("first");
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    bucket.misbehave(|_| Fault::Status(500));
    sleep(Duration::from_secs(2));
    bucket.misbehave(|_| Fault::None);
    succeeds(&api, &job, &calm);

    bucket.misbehave(|_| Fault::Late(Duration::from_millis(200)));
    let job = order(&api, SLOW);
    succeeds(&api, &job, &calm);
    assert_eq!(api.show(&job)["attempts"], 1, "slow is not dead");
    bucket.misbehave(|_| Fault::None);

    // Downloads of the worker that takes over are interrupted repeatedly.
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    worker.kill();
    let gets = std::sync::Arc::new(AtomicUsize::new(0));
    let counted = gets.clone();
    bucket.misbehave(move |request| {
        let is_blob = request.starts_with("GET") && request.contains("/blobs/");
        if is_blob && counted.fetch_add(1, Ordering::Relaxed).is_multiple_of(2) {
            Fault::CutAfter(60)
        } else {
            Fault::None
        }
    });
    let _second = farm.worker("second");
    succeeds(&api, &job, &calm);
    assert!(gets.load(Ordering::Relaxed) > 4, "it has fetched");
    assert!(bucket.count("PUT") > 20, "files are in the bucket");
}

#[test]
fn a_job_cancelled_while_its_files_are_fetched_ends_at_once() {
    let farm = Farm::with_bucket();
    let bucket = farm.bucket.as_ref().expect("a bucket");
    let (_api, api) = farm.replica("api");
    let job = order(&api, "ok");
    let gets = std::sync::Arc::new(AtomicUsize::new(0));
    let counted = gets.clone();
    bucket.misbehave(move |request| {
        if request.starts_with("GET") && request.contains("/blobs/") {
            counted.fetch_add(1, Ordering::Relaxed);
            // Longer than a lease.
            return Fault::Late(Duration::from_secs(20));
        }
        Fault::None
    });
    let _worker = farm.worker("worker");
    let begun = Instant::now();
    while gets.load(Ordering::Relaxed) == 0 {
        assert!(begun.elapsed() < PATIENCE, "it fetches nothing");
        sleep(Duration::from_millis(10));
    }
    let begun = Instant::now();
    api.post(&format!("/v1/jobs/{job}/cancel"), b"", &[]).expect(202);
    api.wait_state(&job, "cancelled");
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    assert_eq!(api.show(&job)["attempts"], 1);
}

#[test]
fn a_replica_that_dies_during_an_upload_leaves_nothing() {
    let farm = Farm::new();
    let calm = expected();
    let (mut one, at_one) = farm.replica("one");
    let (_two, at_two) = farm.replica("two");
    let _worker = farm.worker("worker");
    let address = at_one.base.trim_start_matches("http://");
    let body = fled_tests::multipart(&photographs(4));
    let mut half = TcpStream::connect(address).expect("connect");
    let head = format!(
        "POST /v1/captures HTTP/1.1\r\nHost: {address}\r\nContent-Length: {}\r\n\
         Content-Type: multipart/form-data; boundary=XXXX\r\n\r\n",
        body.len()
    );
    half.write_all(head.as_bytes()).expect("head");
    half.write_all(&body[..body.len() / 2]).expect("half");
    let folder = one.folder.join("data/incoming");
    let begun = Instant::now();
    let arrives = || fs::read_dir(&folder).is_ok_and(|entries| entries.count() > 0);
    while !arrives() {
        assert!(begun.elapsed() < PATIENCE, "nothing arrives in {folder:?}");
        sleep(Duration::from_millis(10));
    }
    one.kill();
    let captures = |api: &fled_tests::Client| {
        let listed = api.get("/v1/captures", &[]).expect(200).json();
        listed["captures"].as_array().map(Vec::len)
    };
    assert_eq!(captures(&at_two), Some(0));
    let (mut one, at_one) = farm.replica("one");
    assert!(!arrives(), "what was half there is gone");
    // A job posted to a replica that died before it answered is posted again to another.
    let capture = at_one.upload("/v1/captures", &photographs(4), &[]).expect(201).json();
    let body = json!({ "capture_id": capture["id"], "preset": "preview",
                       "options": { "adapter": "ok" } });
    let once = [("idempotency-key", "\"the-walk\"")];
    let first = at_one.post_json("/v1/jobs", &body, &once).expect(202).json();
    one.kill();
    let again = at_two.post_json("/v1/jobs", &body, &once).json();
    assert_eq!(first["id"], again["id"]);
    let job = first["id"].as_str().expect("id");
    succeeds(&at_two, job, &calm);
    assert_eq!(captures(&at_two), Some(1));
}
