//! Tests of jobs over HTTP, with the real binary as server, job and renderer.

use std::fs;
use std::io::{BufRead, BufReader};
use std::ops::Deref;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

use fled_core::image::{EncodeFormat, Image};
use fled_tests::{Client, Part, Reply, file, gone, pids_of, text};
use serde_json::{Value, json};

use crate::support::{fled, kill, small_capture, succeed};

/// A small job takes seconds by itself, but tests run in parallel.
const PATIENCE: Duration = Duration::from_secs(300);

/// `fled serve` on a free port.
pub struct Server {
    pub folder: tempfile::TempDir,
    child: Child,
    client: Client,
}

impl Deref for Server {
    type Target = Client;

    fn deref(&self) -> &Client {
        &self.client
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

impl Server {
    pub fn start() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let (child, client) = serve(folder.path());
        Self { folder, child, client }
    }

    /// Kills the server with SIGKILL.
    pub fn kill(&mut self) {
        // It may have exited already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    pub fn restart(&mut self) {
        self.kill();
        (self.child, self.client) = serve(self.folder.path());
    }

    /// Submits a small capture with its poses and ground truth; returns the job's id.
    pub fn submit(&self) -> String {
        let capture = small_capture(self.folder.path());
        let mut parts = folder_parts(&capture);
        let options = json!({
            "size": 128, "steps": 150, "cap": 1500, "rounds": 2, "pose_source": "given", "held_out": 4,
            "train_on": "deblurred",
        });
        parts.extend([text("preset", "preview"), text("options", &options.to_string())]);
        let reply = self.upload("/v1/jobs", &parts, &[]).expect(202);
        reply.json()["id"].as_str().expect("id").to_owned()
    }

    /// Waits until the job trains a round.
    fn wait_for_training(&self, job: &str, round: u32) {
        self.wait(job, "training", |shown| {
            assert!(
                shown["finished_at"].is_null(),
                "the job was over before it was seen to train: {shown:#}"
            );
            shown["stage"] == "reconstruct" && shown["round"] == round
        });
    }

    fn names(&self, job: &str) -> Vec<String> {
        let answer = self.get(&format!("/v1/jobs/{job}/artifacts"), &[]).expect(200).json();
        let artifacts = answer["artifacts"].as_array().expect("artifacts");
        artifacts.iter().map(|file| file["name"].as_str().expect("name").to_owned()).collect()
    }

    fn picture(&self, reply: Reply) -> Image {
        let path = self.folder.path().join("picture.png");
        fs::write(&path, reply.expect(200).body).expect("written");
        Image::load(&path).expect("a picture")
    }

    fn log(&self, job: &str) -> String {
        self.get(&format!("/v1/jobs/{job}/log?limit=2000"), &[]).expect(200).text()
    }
}

/// Starts the server and reads its address from the log.
fn serve(folder: &Path) -> (Child, Client) {
    let mut child = fled()
        .args(["serve", "--listen", "127.0.0.1:0", "--data"])
        .arg(folder.join("data"))
        .env_remove("RUST_LOG")
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts");
    let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines();
    let address = lines
        .by_ref()
        .map(|line| line.expect("UTF-8"))
        .find_map(|line| line.split_once("listening on ").map(|(_, address)| address.to_owned()));
    // Keep reading, or the server blocks once the pipe is full.
    std::thread::spawn(move || lines.for_each(drop));
    (child, Client::new(address.expect("an address"), PATIENCE))
}

/// Every file of a capture folder, named by its path.
fn folder_parts(capture: &Path) -> Vec<Part> {
    let (mut parts, mut folders) = (Vec::new(), vec![capture.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(capture).expect("inside").display().to_string();
                parts.push(file(&name, &fs::read(&path).expect("a file")));
            }
        }
    }
    parts
}

fn events_of<'a>(
    events: &'a [(i64, String, Value)],
    name: &'a str,
) -> impl Iterator<Item = &'a Value> {
    events.iter().filter(move |(_, kind, _)| kind == name).map(|(.., data)| data)
}

#[test]
fn a_posted_capture_becomes_a_job_with_results_and_renders() {
    let server = Server::start();
    let job = server.submit();
    server.wait_for_training(&job, 2);
    let view = |query: &str| server.get(&format!("/v1/jobs/{job}/render?{query}"), &[]);
    let early = server.picture(view("azimuth=5&format=png"));
    assert!(
        fled_core::metrics::mean_v(&early) > 0.01,
        "round 1, seen while round 2 trains, is black"
    );
    let webp = view("azimuth=5&format=webp").expect(200);
    assert_eq!(
        (webp.header("content-type"), &webp.body[8..12]),
        ("image/webp", b"WEBP".as_slice())
    );

    let done = server.wait(&job, "over", |shown| shown["finished_at"].is_string());
    assert_eq!(
        (&done["state"], &done["error"]),
        (&"succeeded".into(), &Value::Null),
        "{}",
        server.log(&job)
    );
    assert_eq!((&done["attempts"], &done["progress"]), (&1.into(), &1.0.into()));
    check_rounds(&server, &job, &done);
    check_artifacts(&server, &job);
    check_views(&server, &job);

    let events = server.events(&job, 0, usize::MAX);
    assert_eq!(events_of(&events, "round_finished").count(), 2);
    assert_eq!(events_of(&events, "state").last().expect("states")["state"], "succeeded");
}

/// Checks that the table of rounds equals that of `metrics.json`, with every split and every view.
fn check_rounds(server: &Server, job: &str, done: &Value) {
    let rounds = server.get(&format!("/v1/jobs/{job}/rounds"), &[]).expect(200).json();
    assert_eq!(rounds["rounds"].as_array().map(Vec::len), Some(2));
    assert_eq!((&rounds["registered"], &rounds["best_round"]), (&12.into(), &done["best_round"]));
    let held_out =
        rounds["rounds"][1]["records"].as_array().expect("records").iter().find(|record| {
            record["split"] == "held_out"
                && record["image"] == "render"
                && record["reference"] == "gt"
        });
    assert_eq!(held_out.expect("a held-out record against ground truth")["views"], 3);
    let metrics =
        server.get(&format!("/v1/jobs/{job}/artifacts/metrics.json"), &[]).expect(200).json();
    assert_eq!(metrics["rounds"], rounds["rounds"], "two tellings of the same rounds");
    let views = rounds["rounds"][1]["views"].as_array().expect("views");
    assert_eq!(views.len(), 12);
    assert!(views.iter().all(|view| view["psnr_db"].is_f64()), "{views:?}");
}

fn check_artifacts(server: &Server, job: &str) {
    let names = server.names(job);
    for name in ["scene.ply", "cameras.json", "metrics.json", "config.json", "rounds/2/scene.ply"] {
        assert!(names.iter().any(|known| known == name), "{name} is missing in {names:?}");
    }
    let private = names.iter().find(|name| name.starts_with("work/"));
    assert_eq!(private, None, "what only a resumed run reads is no artifact");
}

/// Checks that a photograph's view renders as in the pipeline, and other aspect ratios, depth and a
/// crop as in `fled render`, with square pixels.
fn check_views(server: &Server, job: &str) {
    let view = |query: &str| server.get(&format!("/v1/jobs/{job}/render?{query}"), &[]);
    let camera =
        &server.get(&format!("/v1/jobs/{job}/artifacts/cameras.json"), &[]).expect(200).json()[1];
    let name = camera["name"].as_str().expect("name");
    let seen = server.picture(view(&format!("view={name}&format=png")));
    let restored = server.get(&format!("/v1/jobs/{job}/artifacts/restored/{name}.png"), &[]);
    let restored = server.picture(restored);
    let psnr = fled_core::metrics::psnr(&seen, &restored);
    assert!(psnr > 45.0, "the service and the pipeline render differently: {psnr:.1} dB");
    let folder = server.folder.path();
    let (run, file) =
        (folder.join(format!("data/jobs/{job}/output")), folder.join("by_command.png"));
    let half = half_of(camera);
    let (query, flag) = (format!("crop={half}"), format!("--crop={half}"));
    let pictures = [
        ("", &[][..]),
        ("show=depth", &["--depth"]),
        (&query, &[&flag]),
        (&format!("show=depth&{query}"), &["--depth", &flag]),
    ];
    let pictures = pictures.map(|(query, flags)| {
        let query = format!("view={name}&width=60&height=90&format=png&{query}");
        let by_service = server.picture(view(&query));
        let mut command = fled();
        command.arg("render").arg(&run).args(flags);
        command.args(["--view", name, "--size", "60x90", "-o"]);
        succeed(command.arg(&file));
        let by_command = Image::load(&file).expect("a picture");
        assert!(by_service == by_command, "{query}: two pictures");
        by_service
    });
    let [whole, far, part, part_far] = pictures.map(|picture| fled_core::metrics::mean_v(&picture));
    assert!(part > 0.1 * whole && part < 0.9 * whole, "{part} of {whole} are in half of the scene");
    assert!(part_far < 0.9 * far, "depth: {part_far} of {far} are in half of the scene");
    view(&format!("view={name}&crop=sphere:1e6,0,0,1")).expect(422);
}

/// A box around everything on one side of a camera.
fn half_of(camera: &Value) -> String {
    let row = |row: usize| -> [f64; 4] {
        serde_json::from_value(camera["world_to_camera"][row].clone()).expect("a row")
    };
    let [right, down, ahead] = [row(0), row(1), row(2)];
    let mut centre =
        [0, 1, 2].map(|k| -right[k] * right[3] - down[k] * down[3] - ahead[k] * ahead[3]);
    let along = |k: &usize| right[*k].abs();
    let axis = (0..3).max_by(|a, b| along(a).total_cmp(&along(b))).expect("an axis");
    centre[axis] += 1000.0;
    let mut size = [9999.0; 3];
    size[axis] = 2000.0;
    let numbers = [centre, size].concat().iter().map(f64::to_string).collect::<Vec<_>>();
    format!("box:{}", numbers.join(","))
}

#[test]
fn a_restarted_server_finishes_the_job_it_was_training() {
    let mut server = Server::start();
    let job = server.submit();
    for round in [1, 2] {
        server.wait_for_training(&job, round);
        server.kill();
        assert!(gone(&job), "the job's processes outlived their server");
        server.restart();
    }
    let done = server.wait(&job, "over", |shown| shown["finished_at"].is_string());
    assert_eq!((&done["state"], &done["attempts"]), (&"succeeded".into(), &3.into()), "{done:#}");
    assert!(server.log(&job).contains("round 1: reconstruct already done"), "{}", server.log(&job));
    let events = server.events(&job, 0, usize::MAX);
    let numbers: Vec<i64> = events.iter().map(|(id, ..)| *id).collect();
    assert_eq!(numbers, (1..=numbers.len() as i64).collect::<Vec<_>>(), "a gap or a duplicate");
    let rounds = server.get(&format!("/v1/jobs/{job}/rounds"), &[]).expect(200).json();
    assert_eq!(rounds["rounds"].as_array().map(Vec::len), Some(2));
    server.get(&format!("/v1/jobs/{job}/artifacts/scene.ply"), &[]).expect(200);
}

#[test]
fn a_job_whose_process_is_killed_is_retried_and_finishes() {
    let server = Server::start();
    let job = server.submit();
    server.wait_for_training(&job, 2);
    let processes = pids_of(&job);
    assert!(!processes.is_empty(), "no process carries the job's mark");
    processes.into_iter().for_each(kill);
    let done = server.wait(&job, "over", |shown| shown["finished_at"].is_string());
    assert_eq!((&done["state"], &done["attempts"]), (&"succeeded".into(), &2.into()), "{done:#}");
    let log = server.log(&job);
    assert!(log.contains("SIGKILL"), "the log must tell what happened: {log}");
    assert!(log.contains("round 1: reconstruct already done"), "round 1 was done again: {log}");
}

#[test]
fn black_pictures_are_each_refused_with_a_reason() {
    let server = Server::start();
    let black: Image = Image::new(160, 120);
    let png = black.encode(EncodeFormat::Png).expect("encode");
    let parts: Vec<Part> = (0..12).map(|i| file(&format!("{i:03}.png"), &png)).collect();
    for path in ["/v1/captures", "/v1/jobs"] {
        let reply = server.upload(path, &parts, &[]).expect(422);
        assert_eq!(reply.header("content-type"), "application/problem+json");
        let problem = reply.json();
        assert_eq!((&problem["code"], &problem["status"]), (&"bad_input".into(), &422.into()));
        assert!(problem["hint"].as_str().is_some_and(|hint| !hint.is_empty()), "{problem}");
        let images = problem["capture"]["images"].as_array().expect("assessments");
        let black = |image: &&Value| {
            image["accepted"] == false
                && image["reason"].as_str().is_some_and(|why| why.contains("black"))
        };
        assert_eq!(images.iter().filter(black).count(), 12, "{problem}");
    }
    let left = server.get("/v1/captures", &[]).expect(200).json();
    assert_eq!(left["captures"].as_array().map(Vec::len), Some(0), "a refused capture was kept");
}

#[test]
fn tokens_are_created_listed_and_revoked_at_run_time() {
    let server = Server::start();
    let data = server.folder.path().join("data");
    let token = |arguments: &[&str]| {
        let mut command = fled();
        command.arg("token").args(arguments).arg("--data").arg(&data);
        command.output().expect("run")
    };
    let made = token(&["create", "--scope", "jobs:read,renders", "--name", "viewer"]);
    assert!(made.status.success(), "{made:?}");
    let secret = String::from_utf8(made.stdout).expect("text");
    let header = format!("Bearer {}", secret.trim());
    assert!(secret.starts_with("fled_") && secret.lines().count() == 1);
    server.get("/v1/jobs", &[]).expect(401);
    let shown = [("authorization", header.as_str())];
    server.get("/v1/jobs", &shown).expect(200);
    server.post("/v1/jobs", b"{}", &shown).expect(403);
    let listed = String::from_utf8(token(&["list"]).stdout).expect("text");
    for word in ["jobs:read,renders", "viewer", "last used"] {
        assert!(listed.contains(word), "{listed}");
    }
    assert!(!listed.contains(secret.trim()), "{listed}");
    let id = listed.split_whitespace().next().expect("an id");
    assert!(token(&["revoke", id]).status.success());
    assert_eq!(token(&["revoke", id]).status.code(), Some(2));
    assert_eq!(token(&["create", "--scope", "all"]).status.code(), Some(2));
    server.get("/v1/jobs", &shown).expect(401);
    server.get("/v1/jobs", &[]).expect(401);
}
