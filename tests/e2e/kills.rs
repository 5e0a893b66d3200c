//! Tests that kill a server and its job processes during real training.
//!
//! `FLED_KILLS=20 cargo test --release -p fled --test e2e kills -- --nocapture` kills more often
//! than CI does. fled-server's tests kill simulated jobs by the hundred.

use std::fs;
use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_core::run_folder::RunFolder;
use fled_tests::{gone, pids_of};
use serde_json::{Value, json};

use crate::service::Server;
use crate::support::kill;

/// Default number of kills.
const KILLS: u32 = 3;
/// Milliseconds between a job's start and a kill, in turn: from its first stages to the training of
/// the second round.
const WAITS: [u64; 7] = [300, 2500, 900, 4000, 1500, 200, 6000];

#[test]
fn a_job_killed_repeatedly_ends_with_the_undisturbed_scene() {
    let kills = std::env::var("FLED_KILLS").map_or(KILLS, |n| n.parse().expect("FLED_KILLS"));
    let mut server = Server::start();
    let calm = server.submit();
    let shown = server.wait_state(&calm, "succeeded");
    let expected = scenes(&server, &calm);
    assert_eq!(expected.len(), 2, "one of each round");
    let (mut done, mut jobs, mut repeated) = (0, 0, Duration::ZERO);
    while done < kills {
        let order = json!({
            "capture_id": shown["capture_id"],
            "preset": shown["preset"],
            "options": shown["options"],
        });
        let reply = server.post_json("/v1/jobs", &order, &[]).expect(202);
        let job = reply.json()["id"].as_str().expect("id").to_owned();
        jobs += 1;
        let mut seen = -1.0;
        while done < kills {
            let wait = WAITS[done as usize % WAITS.len()];
            let Some((progress, in_stage)) = watch(&server, &job, seen, wait) else {
                break;
            };
            seen = progress;
            repeated += in_stage;
            if done % 2 == 0 {
                server.kill();
                assert!(gone(&job), "the job's processes outlived their server");
                server.restart();
            } else {
                pids_of(&job).into_iter().for_each(kill);
            }
            done += 1;
        }
        server.wait_state(&job, "succeeded");
        let events = server.events(&job, 0, usize::MAX);
        let numbers: Vec<i64> = events.iter().map(|(id, ..)| *id).collect();
        let all: Vec<i64> = (1..=numbers.len() as i64).collect();
        assert_eq!(numbers, all, "a gap or a duplicate");
        assert!(scenes(&server, &job) == expected, "another scene");
    }
    let seconds = repeated.as_secs_f64();
    eprintln!("{jobs} jobs, {done} kills, {seconds:.1} s of stages begun again");
}

/// Waits until the job runs and has made progress, and then for `wait` milliseconds. Returns its
/// progress, and how long it has been in its stage; `None` once it is over. A job that dies
/// repeatedly in one stage is given up, as intended.
fn watch(server: &Server, job: &str, seen: f64, wait: u64) -> Option<(f64, Duration)> {
    let start = Instant::now();
    let mut running: Option<Instant> = None;
    let mut stage = Value::Null;
    let mut since = Instant::now();
    loop {
        let shown = server.show(job);
        if shown["finished_at"].is_string() {
            assert_eq!(shown["state"], "succeeded", "{shown:#}");
            return None;
        }
        let now = json!([shown["stage"], shown["round"]]);
        if now != stage {
            (stage, since) = (now, Instant::now());
        }
        let progress = shown["progress"].as_f64().unwrap_or_default();
        if shown["state"] == "running" && progress > seen {
            let running = running.get_or_insert_with(Instant::now);
            if running.elapsed() >= Duration::from_millis(wait) {
                return Some((progress, since.elapsed()));
            }
        }
        assert!(start.elapsed() < Duration::from_secs(300), "it does not go on: {shown:#}");
        sleep(Duration::from_millis(10));
    }
}

/// The scene of each round of a job.
fn scenes(server: &Server, job: &str) -> Vec<Vec<u8>> {
    let output = server.folder.path().join("data/jobs").join(job).join("output");
    let output = RunFolder::new(output);
    let scene = |round: u32| fs::read(output.scene_of(Some(round))).ok();
    (1..).map_while(scene).collect()
}
