//! A stub of fled, whose scores are functions of steps and seed.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::made_up::evaluation;
use crate::evaluation::suite::error::SuiteError;
use crate::evaluation::suite::file::Suite;
use crate::evaluation::suite::records::Records;
use crate::evaluation::suite::runner::{Hands, run};
use crate::evaluation::suite::setup::Setup;
use crate::evaluation::suite::summary::Summary;

/// A folder with a program, captures and a suite, and the stub that runs them.
pub struct Pretended {
    folder: tempfile::TempDir,
    pub content: Value,
    models: Vec<PathBuf>,
    pub machine: BTreeMap<String, String>,
}

/// A side effect of the stub, given the arguments; returns an error line if the program is to fail.
pub type Mischief<'a> = &'a dyn Fn(&str) -> Option<String>;

impl Pretended {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let top = folder.path();
        for capture in ["fox", "hare"] {
            for material in ["dark", "truth"] {
                let folder = top.join(capture).join(material);
                fs::create_dir_all(&folder).expect("folder");
                fs::write(folder.join("1.png"), format!("{capture} {material}")).expect("file");
            }
        }
        fs::write(top.join("program"), "build 1").expect("file");
        let capture = |name: &str| {
            json!({
                "name": name,
                "materials": {"dark": format!("{name}/dark")},
                "truth": format!("{name}/truth")
            })
        };
        let content = json!({
            "question": "What two rounds bring",
            "preset": "preview",
            "seeds": 2,
            "inside": true,
            "captures": [capture("fox"), capture("hare")],
            "configurations": [
                {"name": "plain", "set": {"rounds": 1, "steps": 100}},
                {"name": "as long", "set": {"rounds": 1}, "seconds_of": "fled"},
                {"name": "fled", "set": {"steps": 1000}}
            ],
            "gain": {"of": "fled", "over": "plain", "ceiling": "as long"}
        });
        Self {
            folder,
            content,
            models: Vec::new(),
            machine: BTreeMap::from([("adapter".to_owned(), "none".to_owned())]),
        }
    }

    pub fn top(&self) -> &Path {
        self.folder.path()
    }

    /// The result of the suite, and the arguments of all calls of the program, with paths relative
    /// to the folder.
    pub fn done(
        &self,
        mischief: Option<Mischief<'_>>,
    ) -> (Result<Summary, SuiteError>, Vec<String>) {
        let mut calls = Vec::new();
        let mut start = |words: &[OsString]| {
            let words: Vec<&str> = words.iter().map(|word| word.to_str().expect("UTF-8")).collect();
            let line = words.join(" ").replace(&format!("{}/", self.top().display()), "");
            let failure = mischief.and_then(|mischief| mischief(&line));
            calls.push(line);
            if let Some(line) = failure {
                return Ok(Err(line));
            }
            pretend(&words);
            Ok(Ok(()))
        };
        let mut tell = |_: &str| ();
        let hands = mischief.is_some().then_some(Hands { start: &mut start, tell: &mut tell });
        let path = self.top().join("suite.json");
        fs::write(&path, self.content.to_string()).expect("file");
        let outcome = (|| {
            let suite = Suite::read(&path)?;
            let program = self.top().join("program");
            let (machine, models) = (self.machine.clone(), self.models.clone());
            let setup = Setup::open(&program, machine, models)?;
            let records = Records::new(self.top().join("out"));
            let runs = run(&suite, &setup, &records, hands)?;
            Ok(Summary::new(&suite, runs))
        })();
        (outcome, calls)
    }

    /// Like [`Self::done`], with a program that succeeds.
    pub fn well(&self) -> (Summary, Vec<String>) {
        let (outcome, calls) = self.done(Some(&|_| None));
        (outcome.expect("a suite"), calls)
    }
}

/// Writes the results that fled would write: the scores are functions of steps and seed.
fn pretend(words: &[&str]) {
    let after = |flag: &str| {
        let at = words.iter().position(|word| *word == flag);
        words[at.expect("the flag") + 1]
    };
    let out = Path::new(after("--out"));
    fs::create_dir_all(out.join("work")).expect("folder");
    if words[0] == "run" {
        let set = |key: &str| {
            let find = |word: &&str| word.strip_prefix(key)?.strip_prefix('=')?.parse().ok();
            words.iter().find_map(find).unwrap_or(2_u64)
        };
        fs::write(out.join("metrics.json"), report(set("rounds"), set("steps"))).expect("file");
        let psnr = 20.0 + set("steps") as f64 / 1000.0 + set("seed") as f64;
        fs::write(out.join("psnr"), psnr.to_string()).expect("file");
        return;
    }
    let psnr = fs::read_to_string(Path::new(words[1]).join("psnr")).expect("a run");
    let judged = evaluation(&[("a", psnr.parse().expect("dB"))]);
    let text = serde_json::to_string(&judged).expect("JSON");
    // Fails where a test has blocked the path.
    let _ = fs::write(out.join("evaluation.json"), text);
}

/// `metrics.json` of rounds at ten steps per second.
fn report(rounds: u64, steps: u64) -> String {
    let round = |round| {
        json!({
            "round": round, "seconds": 1.0, "gaussians": 900, "steps": steps,
            "steps_per_second": 10.0, "records": [], "noise_sigma": {}, "sharpness": {},
            "mean_brightness": 0.4, "clipped": 0.0, "noise_ceiling_db": 30.0, "shake_px": null,
            "pose_correction_px": null, "non_finite_gradients": 0, "anchor": [1.0, 1.0],
            "worse_than_previous": false
        })
    };
    let rounds: Vec<Value> = (1..=rounds).map(round).collect();
    json!({
        "rounds": rounds, "best_round": 1, "registered": 12, "views": 12,
        "stages": {"poses": 3.0, "reconstruct": 20.0}, "adapter": "none", "models": {},
        "fallbacks": [], "poses": {}, "seed": 0, "config": {}
    })
    .to_string()
}

/// The calls that are runs, each as its capture and its options.
pub fn runs(calls: &[String]) -> Vec<String> {
    let runs = calls.iter().filter(|line| line.starts_with("run "));
    runs.map(|line| {
        let words: Vec<&str> = line.split(' ').collect();
        let set = words.iter().filter(|word| word.contains('='));
        let set = set.copied().collect::<Vec<_>>().join(" ");
        format!("{}: {set}", words[1])
    })
    .collect()
}
