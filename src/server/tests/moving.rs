//! An installation that moves from SQLite and its data directory to PostgreSQL and a store of
//! files, and back.

mod support;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use fled_server::{Exported, Import, Imported, Result, ServerError, export, import};
use fled_tests::{Client, Postgres};
use serde_json::{Value, json};
use support::Server;
use support::tokens::token;
use support::tus::Tus;

/// Tables that have rows in a played installation.
const TABLES: [&str; 12] = [
    "captures",
    "jobs",
    "events",
    "rounds",
    "stages",
    "warnings",
    "idempotency",
    "artifacts",
    "tokens",
    "webhooks",
    "deliveries",
    "job_files",
];

fn run<T>(work: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("runtime");
    runtime.block_on(work)
}

fn export_of(data: &Path, database: Option<&str>, to: &Path) -> Result<Exported> {
    run(export(data, database, to))
}

/// What is there to move, and what was there to see.
struct Old {
    server: Server,
    admin: String,
    done: String,
    running: String,
    waiting: String,
    /// What was ordered last, with a key.
    waits: Value,
    /// Of the job that is done.
    capture: String,
    seen: Vec<(String, Vec<u8>)>,
}

impl Old {
    /// A server that was killed in the middle of a job.
    fn new() -> Self {
        let mut server = Server::start_with(&[("FLED_FAKE_WORKERS", "1")]);
        let hook = json!({ "url": "http://198.51.100.7/", "types": ["job.succeeded"] });
        server.post_json("/v1/webhooks", &hook, &[]).expect(201);
        let order = json!({ "capture_id": server.capture(4), "preset": "preview",
                            "options": { "adapter": "ok" } });
        let done = id_of(&server, &order, &[]);
        server.wait_state(&done, "succeeded");
        server
            .get(&format!("/v1/jobs/{done}/artifacts"), &[])
            .expect(200);
        let video = json!({ "kind": "orbit", "fps": 5, "seconds": 1.0, "width": 128 });
        let videos = format!("/v1/jobs/{done}/videos");
        let video = server.post_json(&videos, &video, &[]).expect(202);
        let video = video.header("location").to_owned();
        let made = || server.get(&video, &[]).json()["state"] == "succeeded";
        while !made() {
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
        let of_done = [
            "",
            "/rounds",
            "/events",
            "/videos",
            "/shares",
            "/log",
            "/artifacts/scene.ply",
        ];
        let mut paths: Vec<String> = of_done
            .iter()
            .map(|what| format!("/v1/jobs/{done}{what}"))
            .collect();
        paths.extend(["/v1/captures", "/v1/webhooks", "/v1/options"].map(Into::into));
        paths.push(format!("{video}/file"));
        let capture = order["capture_id"].as_str().expect("id");
        paths.push(format!("/v1/captures/{capture}"));
        paths.push(format!("/v1/jobs?capture_id={capture}"));
        let seen = look(&server, &paths, &admin);
        server.kill();
        Self {
            server,
            admin,
            done,
            running,
            waiting,
            waits,
            capture: capture.to_owned(),
            seen,
        }
    }

    fn data(&self) -> PathBuf {
        self.server.data.path().join("data")
    }

    /// Another server answers as it did.
    fn expect_same(&self, api: &Client) {
        let paths: Vec<String> = self.seen.iter().map(|(path, _)| path.clone()).collect();
        for (old, new) in self.seen.iter().zip(look(api, &paths, &self.admin)) {
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

fn look(api: &Client, paths: &[String], admin: &str) -> Vec<(String, Vec<u8>)> {
    let answer = |path: &String| {
        let reply = api.get(path, &[("authorization", admin)]);
        assert_eq!(reply.status, 200, "{path}: {}", reply.text());
        (path.clone(), reply.body)
    };
    paths.iter().map(answer).collect()
}

/// Where it moves to.
struct Target {
    postgres: Postgres,
    url: String,
    root: tempfile::TempDir,
}

impl Target {
    fn new() -> Self {
        let postgres = Postgres::start();
        Self {
            url: postgres.database(),
            postgres,
            root: tempfile::tempdir().expect("temporary directory"),
        }
    }

    fn file(&self) -> PathBuf {
        self.root.path().join("rows.jsonl")
    }

    fn store(&self) -> String {
        self.root.path().join("store").display().to_string()
    }

    fn plan(&self, data: Option<&Path>, file: &Path) -> Import {
        Import {
            file: file.to_owned(),
            data: data.map(Path::to_owned),
            database: self.url.clone(),
            files: self.store(),
        }
    }

    fn import(&self, data: &Path, file: &Path) -> Result<Imported> {
        run(import(&self.plan(Some(data), file)))
    }

    /// How many rows there are in some tables; none where there is no table yet.
    fn rows(&self) -> i64 {
        let count = |table: &str| {
            let count = format!("SELECT COUNT(*) FROM {table}");
            let count = self.postgres.psql("fled_0", &count);
            count.map_or(0, |count| count.parse().expect("a number"))
        };
        TABLES.iter().map(|table| count(table)).sum()
    }

    fn serve(&self, workers: &str) -> Server {
        let store = self.store();
        Server::start_with(&[
            ("FLED_FAKE_DB", self.url.as_str()),
            ("FLED_FAKE_STORE", store.as_str()),
            ("FLED_FAKE_WORKERS", workers),
        ])
    }
}

/// With words about it.
#[track_caller]
fn refused<T: std::fmt::Debug>(outcome: Result<T>, words: &str) {
    let error = outcome.expect_err("refused");
    assert!(error.to_string().contains(words), "{error}");
    assert!(matches!(error, ServerError::NotMoved(_)), "{error:?}");
}

/// The file with other text in it, and a digest that fits.
fn altered(file: &Path, from: &str, to: &str) -> PathBuf {
    let text = fs::read_to_string(file).expect("read");
    assert!(text.contains(from), "no {from}");
    let (rows, _) = text.rsplit_once("{\"end\"").expect("an end");
    let rows = rows.replace(from, to);
    let end = json!({ "end": blake3::hash(rows.as_bytes()).to_hex().as_str() });
    let path = file.with_extension("altered");
    fs::write(&path, format!("{rows}{end}\n")).expect("written");
    path
}

/// Waits until a job has succeeded; its events.
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

/// What must hold of an event stream: its numbers have no gap.
fn has_no_gap(events: &str) {
    let numbers = events.lines().filter_map(|line| line.strip_prefix("id:"));
    let numbers: Vec<i64> = numbers
        .map(|number| number.trim().parse().expect("a number"))
        .collect();
    assert!(numbers.len() > 10, "{events}");
    assert!(numbers.iter().copied().eq(1..=numbers.len() as i64));
}

#[test]
fn a_server_on_postgres_answers_as_the_one_that_moved_and_does_what_waited() {
    let old = Old::new();
    let new = Target::new();
    let told = export_of(&old.data(), None, &new.file()).expect("exported");
    assert_eq!(told.uploads, 1);
    let done = new.import(&old.data(), &new.file()).expect("imported");
    assert_eq!((done.rows, done.released), (told.rows, 1));
    assert!(done.files > 20 && done.bytes > 0, "{done:?}");
    refused(new.import(&old.data(), &new.file()), "has rows");

    let api = new.serve("0");
    old.expect_same(&api);
    let headers = [("authorization", old.admin.as_str())];
    for job in [&old.running, &old.waiting] {
        let shown = api.get(&format!("/v1/jobs/{job}"), &headers).json();
        assert_eq!(shown["state"], "queued");
    }
    let again = id_of(&api, &old.waits, &keyed(&old.admin));
    assert_eq!(again, old.waiting);

    let _worker = new.serve("1");
    let scene = |job: &str| {
        let path = format!("/v1/jobs/{job}/artifacts/scene.ply");
        api.get(&path, &headers).expect(200).body
    };
    for job in [&old.running, &old.waiting] {
        has_no_gap(&succeeds(&api, job, &old.admin));
        assert!(scene(job) == scene(&old.done));
    }
    // What had been done of the one that ran was not done again.
    let events = succeeds(&api, &old.running, &old.admin);
    assert!(events.contains("\"skipped\":true"), "{events}");
}

#[test]
fn what_moves_to_postgres_and_back_is_the_same_to_the_last_byte() {
    let old = Old::new();
    let new = Target::new();
    export_of(&old.data(), None, &new.file()).expect("exported");
    new.import(&old.data(), &new.file()).expect("imported");
    {
        let (api, _worker) = (new.serve("0"), new.serve("1"));
        succeeds(&api, &old.waiting, &old.admin);
        succeeds(&api, &old.running, &old.admin);
    }
    let nowhere = new.root.path().join("nowhere");
    let there = new.root.path().join("postgres.jsonl");
    let worker =
        "INSERT INTO workers (id, about, started_at, seen_at) SELECT 'w', '{\"host\":\"h\",
        \"version\":\"1\",\"adapter\":null,\"has_gpu\":false,\"cores\":1,\"memory\":1,\"jobs\":1}',
        0, CAST(EXTRACT(EPOCH FROM now()) * 1000 AS BIGINT)";
    new.postgres.psql("fled_0", worker).expect("a worker");
    refused(export_of(&nowhere, Some(&new.url), &there), "still works");
    let gone = new.postgres.psql("fled_0", "DELETE FROM workers");
    gone.expect("no worker");
    export_of(&nowhere, Some(&new.url), &there).expect("exported");

    let mut back = Server::start();
    back.kill();
    let data = back.data.path().join("data");
    fs::remove_dir_all(&data).expect("removed");
    fs::create_dir(&data).expect("made");
    let database = data.join("fled.db");
    let plan = Import {
        database: format!("sqlite:{}", database.display()),
        ..new.plan(None, &there)
    };
    let elsewhere = Import {
        files: nowhere.display().to_string(),
        ..plan.clone()
    };
    refused(run(import(&elsewhere)), "lacks the blob");
    run(import(&plan)).expect("imported");
    let again = new.root.path().join("sqlite.jsonl");
    export_of(&data, None, &again).expect("exported");
    let (there, again) = (fs::read(&there), fs::read(&again));
    assert!(there.expect("read") == again.expect("read"));

    let store = new.store();
    back.restart_with(&[("FLED_FAKE_STORE", &store)]);
    old.expect_same(&back);
}

#[test]
fn damaged_cut_and_foreign_files_are_refused_and_leave_nothing() {
    let old = Old::new();
    let new = Target::new();
    let file = new.file();
    export_of(&old.data(), None, &file).expect("exported");
    let taken = export_of(&old.data(), None, &file).expect_err("there is such a file");
    assert!(taken.to_string().contains("another name"), "{taken}");
    let whole = fs::read(&file).expect("read");
    let other = file.with_extension("other");
    let try_it = |bytes: &[u8], words: &str| {
        fs::write(&other, bytes).expect("written");
        refused(new.import(&old.data(), &other), words);
    };
    let last_line = whole[..whole.len() - 1].iter().rposition(|b| *b == b'\n');
    let last_line = last_line.expect("lines") + 1;
    for end in [whole.len() / 2, last_line, whole.len() - 1] {
        try_it(&whole[..end], "cut off");
    }
    try_it(b"", "no file that");
    try_it(b"\x89PNG\r\n\x1a\n", "no file that");
    let mut more = whole.clone();
    more.extend(b"{}\n");
    try_it(&more, "damaged");
    for at in (300..whole.len() - 1).step_by(whole.len() / 40) {
        let mut other = whole.clone();
        // In a word or a number: what is no JSON any more is another fault.
        let at = at
            + other[at..]
                .iter()
                .take_while(|b| !b.is_ascii_alphanumeric())
                .count();
        other[at] = if other[at] == b'0' { b'1' } else { b'0' };
        try_it(&other, "damaged");
    }
    let schema = new.root.path().join("rows.jsonl");
    let newer = altered(&schema, "\"schema\":1", "\"schema\":99");
    refused(new.import(&old.data(), &newer), "same version");
    let column = altered(&file, "\"priority\"", "\"urgency\"");
    refused(new.import(&old.data(), &column), "other columns");
    let fewer = altered(&file, "\"succeeded\"", "\"exploded\"");
    let told = new.import(&old.data(), &fewer).expect_err("no such state");
    assert!(matches!(told, ServerError::Database(_)), "{told:?}");
    let folder = old.data().join("captures").join(&old.capture);
    fs::rename(&folder, new.root.path().join("aside")).expect("moved");
    refused(new.import(&old.data(), &file), "no files of capture");
    fs::rename(new.root.path().join("aside"), &folder).expect("moved");
    refused(run(import(&new.plan(None, &file))), "--data DIR");
    assert_eq!(new.rows(), 0);
    new.import(&old.data(), &file).expect("imported");
    assert!(new.rows() > 100);
}

#[test]
fn an_import_that_breaks_off_leaves_no_row_and_can_be_done_again() {
    let old = Old::new();
    let new = Target::new();
    export_of(&old.data(), None, &new.file()).expect("exported");
    let plan = new.plan(Some(&old.data()), &new.file());
    let whole = Target::new();
    whole.import(&old.data(), &new.file()).expect("imported");
    let mut patience = Duration::from_millis(1);
    let mut broken = 0;
    loop {
        let done = run(async { tokio::time::timeout(patience, import(&plan)).await });
        match (done, new.rows()) {
            (Ok(done), _) => {
                done.expect("imported");
                break;
            }
            (Err(_), 0) => broken += 1,
            // It broke off after it was true, and before it was told so.
            (Err(_), _) => break,
        }
        patience = patience.mul_f64(1.1) + Duration::from_micros(500);
    }
    assert!(broken > 10, "{broken}");
    assert_eq!(new.rows(), whole.rows());
    assert!(new.rows() > 100);
}

#[test]
fn nothing_is_exported_while_a_server_works_and_nothing_imported_beside_one() {
    let mut server = Server::start();
    server.capture(4);
    let new = Target::new();
    let data = server.data.path().join("data");
    let told = export_of(&data, None, &new.file()).expect_err("in use");
    assert!(matches!(told, ServerError::DataInUse(_)), "{told:?}");
    server.kill();
    export_of(&data, None, &new.file()).expect("exported");
    server.restart();
    let told = new.import(&data, &new.file()).expect_err("in use");
    assert!(matches!(told, ServerError::DataInUse(_)), "{told:?}");
    assert_eq!(new.rows(), 0);
}
