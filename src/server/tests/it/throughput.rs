//! Throughput of the service with SQLite and with PostgreSQL. Prints the figures of
//! docs/results.md, and fails if one is far off.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use crate::support::Server;
use crate::support::farm::{Farm, order};
use fled_server::store::{Settlement, Store};
use fled_tests::Client;
use sqlx::any::{AnyPoolOptions, install_default_drivers};

/// Jobs of a large installation.
const MANY: usize = 100_000;
/// Jobs of a small installation.
const FEW: usize = 1000;
/// Number of timed claims.
const CLAIMS: usize = 1000;
/// Number of concurrent claimers.
const CLAIMERS: usize = 8;

/// An SQL table of the numbers 1 to `upto`.
fn numbers(url: &str, upto: usize) -> String {
    if url.starts_with("postgres") {
        return format!("WITH t AS (SELECT n FROM generate_series(1, {upto}) AS n)");
    }
    format!("WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t WHERE n < {upto})")
}

/// Copies an existing job `count` times, in the given state.
async fn copy(url: &str, job: &str, count: usize, state: &str) {
    install_default_drivers();
    let pool = AnyPoolOptions::new().connect(url).await.expect("connect");
    // The ids are UUIDs, which differ by state.
    let group = &blake3::hash(state.as_bytes()).to_hex()[..8];
    let copies = format!(
        "{} INSERT INTO jobs (id, name, capture_id, preset, options, state, rounds, progress,
             created_at, started_at, finished_at)
         SELECT '{group}-0000-7000-8000-' || CAST(100000000000 + n AS TEXT), name, capture_id, preset, options,
             '{state}', rounds, progress, created_at + n, started_at, finished_at
         FROM jobs, t WHERE id = '{job}'",
        numbers(url, count)
    );
    let made = sqlx::query(sqlx::AssertSqlSafe(copies)).execute(&pool).await;
    assert_eq!(made.expect("copied").rows_affected(), count as u64);
    sqlx::query("ANALYZE").execute(&pool).await.expect("analysed");
    pool.close().await;
}

/// Claims and settlements per second, by eight concurrent claimers, with many jobs in the table.
fn claims(url: &str, job: &str) -> f64 {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async {
        copy(url, job, CLAIMS, "queued").await;
        let store = Store::at(url).await.expect("open");
        let begun = Instant::now();
        let claimers = (0..CLAIMERS).map(|name| {
            let store = store.clone();
            tokio::spawn(async move {
                let mut mine = 0;
                loop {
                    let claim = store.claim(&name.to_string(), 60_000, &[]).await.expect("asks");
                    let Some(claim) = claim else {
                        return mine;
                    };
                    let settled = store.settle(&claim.lease, &Settlement::Stopped).await;
                    settled.expect("settled");
                    mine += 1;
                }
            })
        });
        let claimers: Vec<_> = claimers.collect();
        let mut all = 0;
        for claimer in claimers {
            all += claimer.await.expect("ends");
        }
        // The lease of the job that ran may expire meanwhile.
        assert!((CLAIMS..=CLAIMS + 1).contains(&all), "{all} claims");
        let rate = CLAIMS as f64 / begun.elapsed().as_secs_f64();
        store.close().await;
        rate
    })
}

/// The 50th and the 99th percentile of the time for a page of the list, in milliseconds.
fn list(api: &Client) -> (f64, f64) {
    let mut page = String::new();
    let mut took: Vec<f64> = (0..400)
        .map(|_| {
            let begun = Instant::now();
            let listed = api.get(&format!("/v1/jobs{page}"), &[]).expect(200);
            let took = begun.elapsed().as_secs_f64() * 1000.0;
            let listed = listed.json();
            assert!(listed["jobs"].as_array().is_some_and(|jobs| !jobs.is_empty()));
            // Start again after the last page.
            let next = listed["next_cursor"].as_str();
            page = next.map_or(String::new(), |next| format!("?cursor={next}"));
            took
        })
        .collect();
    took.sort_by(f64::total_cmp);
    (took[200], took[396])
}

/// The times of the list with few jobs, and with many.
fn lists(api: &Client, url: &str, job: &str) -> [(f64, f64); 2] {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(copy(url, job, FEW, "cancelled"));
    let few = list(api);
    runtime.block_on(copy(url, job, MANY, "succeeded"));
    [few, list(api)]
}

/// Processor seconds that a process has used.
fn used(pid: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("it lives");
    let after = stat.rsplit_once(')').expect("a name").1;
    let fields: Vec<&str> = after.split_whitespace().collect();
    let ticks: f64 =
        [fields[11], fields[12]].iter().map(|field| field.parse::<f64>().expect("a number")).sum();
    ticks / 100.0
}

/// The share of a core that a replica uses for 200 event streams of a running job.
fn streams(api: &Client, pid: u32, job: &str) -> f64 {
    let address = api.base.trim_start_matches("http://");
    let path = format!("/v1/jobs/{job}/events");
    let open: Vec<TcpStream> = (0..200)
        .map(|_| {
            let mut stream = TcpStream::connect(address).expect("connect");
            let head = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n");
            stream.write_all(head.as_bytes()).expect("asked");
            let mut reader = stream.try_clone().expect("a socket");
            spawn(move || {
                let mut bytes = [0; 4096];
                while reader.read(&mut bytes).is_ok_and(|read| read > 0) {}
            });
            stream
        })
        .collect();
    // Wait until each stream has received all past events.
    sleep(Duration::from_secs(2));
    let (before, begun) = (used(pid), Instant::now());
    sleep(Duration::from_secs(8));
    let share = (used(pid) - before) / begun.elapsed().as_secs_f64();
    drop(open);
    share
}

fn print(store: &str, claims: f64, [few, many]: [(f64, f64); 2], share: f64) {
    eprintln!(
        "{store}: {claims:.0} claims/s; a page of {FEW} jobs p50 {:.1} ms p99 {:.1} ms, of {MANY} \
         p50 {:.1} ms p99 {:.1} ms; 200 streams {:.1} % of a core",
        few.0,
        few.1,
        many.0,
        many.1,
        100.0 * share
    );
    // Limits that hold on a busy machine too.
    assert!(many.0 < 3.0 * few.0 + 2.0, "{many:?} against {few:?}");
    assert!(share < 0.05, "{share}");
    assert!(claims > 20.0, "{claims}");
}

#[test]
#[ignore = "make test-nightly"]
fn sqlite_serves_100_000_jobs_and_200_streams() {
    let mut server = Server::start_with(&[("FLED_FAKE_RATE", "0")]);
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let url = format!("sqlite:{}", server.data.path().join("data/fled.db").display());
    let lists = lists(&server, &url, &job);
    let running = server.job("slow:600");
    server.wait(&running, "runs", |shown| shown["state"] == "running");
    let share = streams(&server, server.pid(), &running);
    // Its own workers would claim jobs too.
    server.kill();
    print("SQLite", claims(&url, &job), lists, share);
}

#[test]
#[ignore = "make test-nightly"]
fn postgresql_serves_100_000_jobs_and_200_streams() {
    let farm = Farm::new();
    let free = [("FLED_FAKE_WORKERS", "0"), ("FLED_FAKE_RATE", "0")];
    let (machine, base) = farm.start("api", &free);
    let api = Client::new(base, Duration::from_secs(30));
    let worker = farm.worker("worker");
    let job = order(&api, "ok");
    api.wait_state(&job, "succeeded");
    let lists = lists(&api, &farm.url, &job);
    let running = order(&api, "slow:600");
    api.wait(&running, "runs", |shown| shown["state"] == "running");
    let share = streams(&api, machine.pid(), &running);
    drop((worker, machine));
    print("PostgreSQL", claims(&farm.url, &job), lists, share);
}
