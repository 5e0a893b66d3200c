//! Several machines, with failing replicas, workers, database and blob store.

use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use crate::support::farm::{
    Farm, Machine, PATIENCE, SLOW, begin, check, expected, in_the_middle, order, scene, succeeds,
};
use crate::support::{gone, photographs};
use fled_tests::Client;
use serde_json::json;

#[test]
fn a_job_posted_to_one_replica_is_visible_at_another() {
    let farm = Farm::new();
    let calm = expected();
    let (_one, one) = farm.replica("one");
    let (mut two, at_two) = farm.replica("two");
    let worker = farm.worker("worker");
    let job = order(&one, SLOW);
    // Read events from the second replica until it is killed, and then from the first.
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
    // A replica that starts later can read everything too.
    let (_three, three) = farm.replica("three");
    assert!(scene(&three, &job) == calm);
    let listed = three.get("/v1/jobs", &[]).expect(200).json();
    assert_eq!(listed["jobs"].as_array().map(Vec::len), Some(1));
}

#[test]
fn a_replica_without_files_of_a_job_makes_views_and_videos() {
    let farm = Farm::new();
    let (mut one, api) = farm.replica("one");
    let mut worker = farm.worker("worker");
    let job = order(&api, "ok");
    api.wait_state(&job, "succeeded");
    worker.kill();
    let film = json!({ "kind": "orbit", "fps": 5, "seconds": 8.0, "width": 128 });
    let videos = format!("/v1/jobs/{job}/videos");
    let begun = api.post_json(&videos, &film, &[]).expect(202);
    let begun = begun.location();
    let since = Instant::now();
    while api.get(&begun, &[]).expect(200).json()["progress"].as_f64() < Some(0.1) {
        assert!(since.elapsed() < PATIENCE, "{begun} is not begun");
        sleep(Duration::from_millis(20));
    }
    // Another replica makes it, without the job's files.
    one.kill();
    let (_two, two) = farm.replica("two");
    let since = Instant::now();
    while two.get(&begun, &[]).expect(200).json()["state"] != "succeeded" {
        assert!(since.elapsed() < PATIENCE, "{begun} is not made");
        sleep(Duration::from_millis(50));
    }
    std::fs::remove_dir_all(one.folder.join("data/jobs").join(&job).join("output")).expect("there");
    let (_one, api) = farm.replica("one");
    let asked = two.post_json(&videos, &film, &[]).expect(202);
    let asked = asked.location();
    let view = format!("/v1/jobs/{job}/render?azimuth=30&format=png");
    assert!(api.get(&view, &[]).expect(200).body == two.get(&view, &[]).expect(200).body);
    for (replica, video) in [(&api, &begun), (&two, &asked)] {
        let since = Instant::now();
        while replica.get(video, &[]).expect(200).json()["state"] != "succeeded" {
            assert!(since.elapsed() < PATIENCE, "{video} is not made");
            sleep(Duration::from_millis(50));
        }
        // Each video is visible at both replicas.
        for replica in [&api, &two] {
            let file = replica.get(&format!("{video}/file"), &[]).expect(200);
            assert_eq!(&file.body[4..8], b"ftyp");
        }
    }
}

#[test]
fn a_killed_or_frozen_worker_loses_only_its_job() {
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

    // Frozen for longer than a lease: when it thaws, another worker has the job.
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    second.signal("-STOP");
    let third = farm.worker("third");
    api.wait(&job, "is another's", |shown| shown["attempts"] == 2);
    second.signal("-CONT");
    succeeds(&api, &job, &calm);
    drop(second);

    // Killed and restarted at once: it has its own job again without waiting for the lease.
    let job = order(&api, SLOW);
    in_the_middle(&api, &job);
    drop(third);
    let back = Instant::now();
    let _third = farm.worker("third");
    api.wait(&job, "goes on", |shown| shown["attempts"] == 2);
    assert!(back.elapsed() < Duration::from_secs(4), "{:?}", back.elapsed());
    succeeds(&api, &job, &calm);
}

#[test]
#[ignore = "make test-nightly"]
fn a_temporarily_absent_database_or_store_loses_nothing() {
    let mut farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    let _worker = farm.worker("worker");
    for away in [Duration::from_secs(2), Duration::from_secs(20)] {
        let job = order(&api, SLOW);
        in_the_middle(&api, &job);
        farm.postgres.kill();
        let refused = api.get(&format!("/v1/jobs/{job}"), &[]).expect(503);
        assert_eq!(refused.json()["code"], "unavailable");
        assert!(!refused.header("retry-after").is_empty());
        sleep(away);
        farm.postgres.begin();
        // Cut connections are noticed when they are used.
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
fn a_resumable_upload_survives_the_start_of_other_processes() {
    let farm = Farm::new();
    let (_one, one) = farm.replica("one");
    let headers = [
        ("tus-resumable", "1.0.0"),
        ("upload-length", "10"),
        ("upload-metadata", "filename d2Fsay5wbmc="),
    ];
    let begun = one.ask("POST", "/v1/uploads", &headers, b"").expect(201);
    let upload = begun.location();
    let _worker = farm.worker("worker");
    let _two = farm.replica("two");
    one.ask("HEAD", &upload, &headers[..1], b"").expect(200);
}

#[test]
#[ignore = "make test-nightly"]
fn jobs_on_workers_killed_at_random_are_all_done_once() {
    // FLED_FARM="200 4 120" is the long run: jobs, workers, seconds.
    let asked = std::env::var("FLED_FARM").unwrap_or_else(|_| "40 3 20".to_owned());
    let asked: Vec<u64> = asked.split(' ').map(|n| n.parse().expect("a number")).collect();
    let [jobs, count, seconds] = asked[..] else {
        panic!("three numbers");
    };
    let farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    // Kills may hit the same job repeatedly, which must not make it fail.
    let lucky = [("FLED_FAKE_DEATHS", "1000")];
    let at = |number: u64| farm.worker_by(&[], &format!("w{number}"), &lucky);
    let mut workers: Vec<Machine> = (0..count).map(at).collect();
    let capture = api.upload("/v1/captures", &photographs(4), &[]).expect(201);
    let capture = capture.json()["id"].clone();
    let made: Vec<String> = (0..jobs)
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
    while begun.elapsed() < Duration::from_secs(seconds) {
        dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        sleep(Duration::from_millis(300 + (dice >> 33) % 900));
        let which = ((dice >> 40) % count) as usize;
        workers[which].kill();
        workers[which] = at(which as u64);
        kills += 1;
    }
    assert!(kills > seconds / 2, "{kills}");
    for job in &made {
        succeeds(&api, job, &calm);
    }
    let count = farm.postgres.psql(
        "fled_0",
        "SELECT COUNT(*) FROM events WHERE kind = 'state' AND data LIKE '%succeeded%'",
    );
    assert_eq!(count, Ok(jobs.to_string()), "each is done once");
    eprintln!("{kills} kills, {:.0} s", begun.elapsed().as_secs_f64());
}

/// Waits until a training job has done three steps: one more than its scheduled checkpoint.
fn trains(api: &Client, job: &str) {
    let mut seen = 0;
    loop {
        let (seq, kind, data) = api.events(job, seen, 1).remove(0);
        if kind == "training_seen" && data["step"].as_u64() >= Some(300) {
            return;
        }
        seen = seq;
    }
}

/// The steps that follow `words` in a job's log.
fn steps(api: &Client, job: &str, words: &str) -> Vec<u64> {
    let log = api.get(&format!("/v1/jobs/{job}/log"), &[]).expect(200);
    let text = log.text();
    let after = text.split(words).skip(1);
    let digits = after.map(|rest| rest.split(|c: char| !c.is_ascii_digit()).next());
    digits.map(|step| step.and_then(|step| step.parse().ok()).expect("a step")).collect()
}

#[test]
fn a_stopping_worker_lets_its_job_save_the_current_step() {
    let farm = Farm::new();
    let calm = expected();
    let (_api, api) = farm.replica("api");
    // Longer than the grace period of a cancelled job.
    let mut first = farm.worker_by(&[], "first", &[("FLED_FAKE_SAVING_MS", "2500")]);
    let job = order(&api, "saves:300");
    trains(&api, &job);
    first.signal("-INT");
    api.wait_state(&job, "queued");
    first.dies();
    let stopped = steps(&api, &job, "stopped at step ");
    assert!(stopped.len() == 1 && stopped[0] > 2, "{stopped:?}");
    let _second = farm.worker("second");
    succeeds(&api, &job, &calm);
    assert_eq!(steps(&api, &job, "resumed at step "), stopped);
    assert_eq!(api.show(&job)["attempts"], 2);
}

#[test]
fn a_stopping_server_lets_its_job_save_but_a_cancel_does_not() {
    let root = tempfile::tempdir().expect("temporary directory");
    // Longer than open requests may take.
    let slow = [("FLED_FAKE_SAVING_MS", "6000")];
    let (mut server, base) = begin(root.path(), "server", &slow);
    let api = Client::new(base, PATIENCE);
    let job = order(&api, "saves:300");
    trains(&api, &job);
    server.signal("-INT");
    server.dies();
    let (_server, base) = begin(root.path(), "server", &slow);
    let api = Client::new(base, PATIENCE);
    api.wait(&job, "goes on", |shown| shown["attempts"] == 2);
    api.wait_state(&job, "succeeded");
    let stopped = steps(&api, &job, "stopped at step ");
    assert!(stopped.len() == 1 && stopped[0] > 2, "{stopped:?}");
    assert_eq!(steps(&api, &job, "resumed at step "), stopped);

    let job = order(&api, "saves:300");
    trains(&api, &job);
    let begun = Instant::now();
    let cancelled = api.post(&format!("/v1/jobs/{job}/cancel"), b"", &[]);
    assert_eq!(cancelled.expect(202).json()["state"], "cancelled");
    assert!(begun.elapsed() < Duration::from_millis(2500));
    // Its earlier checkpoint is complete.
    api.post(&format!("/v1/jobs/{job}/retry"), b"", &[]).expect(202);
    api.wait_state(&job, "succeeded");
    assert_eq!(steps(&api, &job, "resumed at step "), [2]);
}
