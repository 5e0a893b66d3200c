//! Random kills of a server and its child processes, and the state of the work afterwards.
//!
//! `FLED_KILLS=200 cargo test --release -p fled-server --test it kills -- --nocapture` kills more
//! often than CI does; both print a table.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread::{JoinHandle, scope, sleep, spawn};
use std::time::{Duration, Instant};

use crate::support::{Server, gone, photographs};
use fled_tests::{Client, pids_of};
use serde_json::Value;

/// Default number of kills.
const KILLS: usize = 20;
/// Milliseconds per tick; a stage of a fake job takes ten of them.
const PLAN: &str = "slow:15";
/// Range of times between a job's start and a kill, in milliseconds.
const AFTER_MS: (u64, u64) = (20, 450);
/// Timeout of everything that should happen quickly.
const SOON: Duration = Duration::from_secs(20);

/// The process to kill.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Target {
    Server,
    Job,
    Renderer,
    Validator,
}

impl Target {
    fn stops_the_job(self) -> bool {
        matches!(self, Self::Server | Self::Job)
    }
}

/// Statistics of the kills of one target.
#[derive(Debug, Default)]
struct Tally {
    kills: usize,
    /// Time that the job had spent in a stage that it had to repeat.
    repeated: Duration,
    most: Duration,
}

/// Pseudo-random numbers that are the same in every run (splitmix64).
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % end
    }

    fn wait(&mut self, (from, to): (u64, u64)) -> Duration {
        Duration::from_millis(from + self.below(to - from))
    }

    fn target(&mut self) -> Target {
        match self.below(10) {
            0..=3 => Target::Server,
            4 | 5 => Target::Job,
            6 | 7 => Target::Renderer,
            _ => Target::Validator,
        }
    }
}

type Events = Vec<(i64, String, Value)>;

struct KillRun {
    server: Server,
    dice: Dice,
    /// The files of an undisturbed job.
    expected: BTreeMap<PathBuf, Vec<u8>>,
    /// A finished job whose views take 700 ms.
    slow: String,
    /// Captures that were answered with 201.
    accepted: Vec<String>,
    tallies: BTreeMap<Target, Tally>,
}

#[test]
#[ignore = "make test-nightly"]
fn nothing_is_lost_after_random_kills() {
    let number = |name, default| std::env::var(name).map_or(default, |n| n.parse().expect(name));
    let kills = number("FLED_KILLS", KILLS);
    let mut run = KillRun::new(number("FLED_KILLS_SEED", 7) as u64);
    let start = Instant::now();
    let mut jobs = 0;
    while run.kills() < kills {
        run.job(kills);
        jobs += 1;
    }
    let lost = run.lost();
    let seconds = start.elapsed().as_secs_f64();
    eprintln!("{jobs} jobs, {seconds:.0} s, {} captures", run.accepted.len());
    eprintln!("| killed | times | seconds of work done again | most at once | lost |");
    eprintln!("|---|---|---|---|---|");
    for (target, tally) in &run.tallies {
        eprintln!(
            "| {target:?} | {} | {:.1} | {:.2} | {lost} |",
            tally.kills,
            tally.repeated.as_secs_f64(),
            tally.most.as_secs_f64(),
        );
    }
    assert_eq!(lost, 0);
    assert!(run.kills() >= kills);
}

impl KillRun {
    fn new(seed: u64) -> Self {
        let server = Server::start();
        let calm = server.job("ok");
        let slow = server.job("ok");
        for job in [&calm, &slow] {
            server.wait_state(job, "succeeded");
        }
        let output = output(&server, &calm);
        fs::write(self::output(&server, &slow).join("scene.ply"), "slow").expect("written");
        Self {
            expected: files(&output),
            server,
            dice: Dice(seed),
            slow,
            accepted: Vec::new(),
            tallies: BTreeMap::new(),
        }
    }

    fn kills(&self) -> usize {
        self.tallies.values().map(|tally| tally.kills).sum()
    }

    /// Runs one job from its start to its end, with kills up to the given total.
    fn job(&mut self, kills: usize) {
        let job = self.server.job(PLAN);
        let mut events = Events::new();
        let mut listener = self.listen(&job, 0);
        // The progress at the last kill of the job or its server, and whether there was none since
        // the one before.
        let (mut seen, mut in_vain) = (0.0, false);
        while self.kills() < kills {
            let wait = self.dice.wait(AFTER_MS);
            let Some((shown, in_stage)) = self.watch(&job, wait) else {
                break;
            };
            let target = self.dice.target();
            // After three kills in a row without progress a job fails, as it should.
            if target.stops_the_job() && in_vain && progress(&shown) <= seen {
                continue;
            }
            let killed = match target {
                Target::Server => {
                    self.kill_server(&job);
                    events.extend(listener.join().unwrap_or_default());
                    listener = self.listen(&job, events.last().map_or(0, |event| event.0));
                    true
                }
                Target::Job => kill(&pids_of(&job)),
                Target::Renderer => self.kill_renderer(),
                Target::Validator => self.kill_validator(),
            };
            if target.stops_the_job() {
                let now = progress(&self.server.show(&job));
                (in_vain, seen) = (now <= seen, now);
            }
            if killed {
                let repeated = target.stops_the_job().then_some(in_stage);
                self.count(target, repeated.unwrap_or_default());
            }
        }
        self.server.wait_state(&job, "succeeded");
        events.extend(listener.join().unwrap_or_default());
        check_events(&events);
        let left = files(&output(&self.server, &job));
        let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&left), names(&self.expected));
        for (name, bytes) in &self.expected {
            assert_eq!(&left[name], bytes, "{} differs", name.display());
        }
    }

    fn count(&mut self, target: Target, repeated: Duration) {
        let tally = self.tallies.entry(target).or_default();
        tally.kills += 1;
        tally.repeated += repeated;
        tally.most = tally.most.max(repeated);
    }

    /// Reads the job's events until this server or the job ends.
    fn listen(&self, job: &str, after: i64) -> JoinHandle<Events> {
        let (client, job) = (Client::new(self.server.base.clone(), SOON), job.to_owned());
        spawn(move || client.events(&job, after, usize::MAX))
    }

    /// Waits until the job has run for `wait`. Returns the job and how long it has been in its
    /// stage; `None` once it is over.
    fn watch(&self, job: &str, wait: Duration) -> Option<(Value, Duration)> {
        let start = Instant::now();
        let mut running: Option<Instant> = None;
        let mut stage = (Value::Null, Value::Null);
        let mut since = Instant::now();
        loop {
            let shown = self.server.show(job);
            match shown["state"].as_str() {
                Some("running") => {
                    let now = (shown["stage"].clone(), shown["round"].clone());
                    if running.is_none() || now != stage {
                        (stage, since) = (now, Instant::now());
                    }
                    let running = running.get_or_insert_with(Instant::now);
                    if running.elapsed() >= wait {
                        return Some((shown, since.elapsed()));
                    }
                }
                Some("queued") => running = None,
                Some("succeeded") => return None,
                _ => panic!("{shown:#}"),
            }
            assert!(start.elapsed() < SOON, "it does not run: {shown:#}");
            sleep(Duration::from_millis(4));
        }
    }

    /// Kills the server during an upload, which is either answered and stored, or absent.
    fn kill_server(&mut self, job: &str) {
        let client = self.server.begin_upload("/v1/captures", &photographs(4));
        sleep(self.dice.wait((0, 120)));
        self.server.kill();
        assert!(gone(job), "the job's process outlived its server");
        self.take(client);
        self.server.restart();
        let here = self.server.show(job);
        assert!(
            ["queued", "running", "succeeded"].contains(&here["state"].as_str().expect("state"))
        );
    }

    /// Kills the renderer during a render.
    fn kill_renderer(&mut self) -> bool {
        let mut view = || {
            let azimuth = self.dice.below(360_000) as f64 / 1000.0;
            format!("/v1/jobs/{}/render?azimuth={azimuth}", self.slow)
        };
        let (first, second) = (view(), view());
        let wait = self.dice.wait((50, 400));
        let server = &self.server;
        scope(|scope| {
            let asked = scope.spawn(move || server.get(&first, &[]));
            sleep(wait);
            let killed = kill(&children(server, "render-worker"));
            let status = asked.join().expect("an answer").status;
            assert!([200, 503].contains(&status), "{status}");
            server.get(&second, &[]).expect(200);
            killed
        })
    }

    /// Kills the validator during an upload.
    fn kill_validator(&mut self) -> bool {
        let client = self.server.begin_upload("/v1/captures", &photographs(40));
        let start = Instant::now();
        let mut killed = false;
        while !killed && start.elapsed() < Duration::from_millis(300) {
            killed = kill(&children(&self.server, "assess-worker"));
        }
        let answer = self.take(client);
        let known = ["HTTP/1.1 201 ", "HTTP/1.1 422 "];
        assert!(known.iter().any(|known| answer.starts_with(known)), "{answer}");
        killed
    }

    /// Reads the answer to an upload, and records the capture if it was accepted.
    fn take(&mut self, mut client: TcpStream) -> String {
        client.set_read_timeout(Some(SOON)).expect("set");
        let mut answer = Vec::new();
        let mut piece = [0; 4096];
        // A kept-alive connection does not end: the answer ends with its JSON.
        while !whole(&answer) {
            match client.read(&mut piece) {
                Ok(0) | Err(_) => break,
                Ok(count) => answer.extend_from_slice(&piece[..count]),
            }
        }
        let answer = String::from_utf8_lossy(&answer).into_owned();
        if answer.starts_with("HTTP/1.1 201 ") {
            let line = answer.lines().find_map(|line| line.strip_prefix("location: "));
            let id = line.and_then(|path| path.rsplit('/').next()).expect("a location");
            self.accepted.push(id.to_owned());
        }
        answer
    }

    /// Counts accepted captures that are missing or incomplete.
    fn lost(&self) -> usize {
        let is_lost = |id: &&String| {
            let shown = self.server.get(&format!("/v1/captures/{id}"), &[]);
            let images = self.server.data.path().join("data/captures").join(id).join("images");
            let named = || shown.json()["images"].as_array().map_or(0, Vec::len);
            shown.status != 200 || files(&images).len() != named()
        };
        self.accepted.iter().filter(is_lost).count()
    }
}

fn progress(shown: &Value) -> f64 {
    shown["progress"].as_f64().expect("a number")
}

/// Returns whether an answer has its announced length.
fn whole(answer: &[u8]) -> bool {
    let text = String::from_utf8_lossy(answer).to_lowercase();
    let Some((head, body)) = text.split_once("\r\n\r\n") else {
        return false;
    };
    let length = head.lines().find_map(|line| line.strip_prefix("content-length: "));
    length.is_some_and(|length| length.parse() == Ok(body.len()))
}

/// Checks that every event occurs once, and that the last one is success.
#[track_caller]
fn check_events(events: &[(i64, String, Value)]) {
    let ids: Vec<i64> = events.iter().map(|event| event.0).collect();
    let all: Vec<i64> = (1..=ids.len() as i64).collect();
    assert_eq!(ids, all, "a gap or a duplicate");
    let last = events.last().map(|(_, name, data)| (name.as_str(), &data["state"]));
    assert_eq!(last, Some(("state", &"succeeded".into())));
}

fn output(server: &Server, job: &str) -> PathBuf {
    server.data.path().join("data/jobs").join(job).join("output")
}

/// All files below a folder, except hidden ones, which belong to the fake job.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if !entry.file_name().to_string_lossy().starts_with('.') {
                let name = path.strip_prefix(folder).expect("below").to_owned();
                found.insert(name, fs::read(path).expect("a file"));
            }
        }
    }
    found
}

/// The server's child processes with this argument.
fn children(server: &Server, what: &str) -> Vec<u32> {
    let is_one = |process: &PathBuf| {
        let line = fs::read(process.join("cmdline")).unwrap_or_default();
        line.split(|&byte| byte == 0).any(|word| word == what.as_bytes())
    };
    let pid = |process: PathBuf| process.file_name()?.to_str()?.parse().ok();
    let children = server.children().into_iter();
    children.filter(is_one).filter_map(pid).collect()
}

/// Sends SIGKILL; returns whether any process received it.
fn kill(processes: &[u32]) -> bool {
    let kill = |pid: &u32| {
        let status = Command::new("kill").args(["-9", &pid.to_string()]).status();
        status.expect("kill").success()
    };
    processes.iter().filter(|pid| kill(pid)).count() > 0
}
