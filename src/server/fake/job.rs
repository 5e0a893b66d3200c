//! A fake job: the events and files of `fled run`, and planned failures.

use std::error::Error;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_core::camera::normalisation::Normalisation;
use fled_core::camera::{Camera, Intrinsics, NamedCamera, Split};
use fled_core::event::{Event, Stage};
use fled_core::gaussians::{Gaussians, ply};
use fled_core::image::{EncodeFormat, Image};
use fled_core::metrics::{ChosenDetail, DetailLevel};
use fled_core::pipeline::config::{Detail, Options};
use fled_core::poses::overlap::{Overlap, OverlapLink};
use fled_core::run_folder::{RoundPictures, RunFolder};
use glam::DVec3;

use crate::protocol::{argument, say, tell};
use crate::saved::Saved;
use crate::scores;

/// Ticks per stage, each a `StageAdvanced`.
const TICKS: u64 = 10;

/// Gaussians in a real scene.
const BALLS: usize = 1000;

type Outcome = Result<(), Box<dyn Error>>;

struct Job {
    capture: PathBuf,
    output: PathBuf,
    options: Options,
    /// `word` or `word:milliseconds per tick`.
    plan: String,
    tick: Duration,
    /// Names of the photographs.
    names: Vec<String>,
    started: Instant,
    /// The checkpoint that training resumes from, if the plan is `saves`.
    saved: Option<Saved>,
}

pub fn run(arguments: &[OsString]) -> Outcome {
    let after = |name| argument(arguments, name);
    let options: Options = serde_json::from_slice(&fs::read(after("--options")?)?)?;
    let (plan, tick) = match options.adapter.split_once(':') {
        Some((plan, tick)) => (plan.to_owned(), tick.parse()?),
        None => (options.adapter.clone(), 2),
    };
    let capture = PathBuf::from(&arguments[0]);
    let output = after("--out")?;
    let checkpoint = RunFolder::new(&output).work().checkpoint();
    let saved = (plan == "saves").then(|| Saved::new(checkpoint));
    let job = Job {
        saved: saved.transpose()?,
        names: names(&capture)?,
        capture,
        output,
        options,
        plan,
        tick: Duration::from_millis(tick),
        started: Instant::now(),
    };
    job.play().or_else(|error| {
        // The real program reports disk errors in this way.
        if error.is::<io::Error>() {
            return fail("io", &error.to_string(), "Free some space.");
        }
        Err(error)
    })
}

impl Job {
    fn play(&self) -> Outcome {
        eprintln!("a line on standard error <script>alert(1)</script>");
        say("a line that is no event");
        tell(&Event::Planned {
            rounds: self.options.round_count(),
            views: self.names.len() as u32,
            shake: None,
            size: None,
            steps: None,
        });
        if self.options.detail == Detail::Auto {
            let because = "a fake device is not a GPU".to_owned();
            let detail = ChosenDetail { level: DetailLevel::Standard, because };
            tell(&Event::DetailChosen { detail });
        }
        match self.plan.as_str() {
            "apart" => {
                tell(&Event::OverlapFound(self.overlap()));
                return fail("few_poses", "4 of 8 photographs could be placed", "Take more.");
            }
            "few_poses" => {
                return fail("few_poses", "3 of 20 photographs could be placed", "Take more.");
            }
            "leak" => {
                let detail = format!("{}: is damaged", self.capture.join("images").display());
                return fail("bad_input", &detail, "None.");
            }
            "bad_word" => return fail("no_such_kind", "an unknown kind", "None."),
            "silent" => sleep(Duration::from_secs(600)),
            "crash" => std::process::abort(),
            "crash-once" if self.first("crashed")? => std::process::abort(),
            _ => {}
        }
        self.stage(Stage::Poses, 0)?;
        self.write_cameras()?;
        let code = "low_confidence".to_owned();
        tell(&Event::Warning { code, message: "poses <b>may</b> be wrong".to_owned() });
        for round in 1..=self.options.round_count() {
            for stage in &Stage::ALL[1..] {
                self.stage(*stage, round)?;
            }
            self.write_round(round)?;
            let plan = self.has_truth().then_some(&self.plan);
            let metrics = scores::metrics(round, &self.names, plan);
            tell(&Event::RoundFinished { metrics: Box::new(metrics) });
            if self.plan == "crash-late" && self.first("crashed")? {
                std::process::abort();
            }
        }
        let scene = format!("ply of round {}", self.options.round_count());
        self.write_scene("scene.ply", &scene)?;
        tell(&Event::Finished {
            best_round: self.options.round_count(),
            seconds: self.started.elapsed().as_secs_f64(),
        });
        Ok(())
    }

    /// Four photographs that match one another, two that match each other, and the others, which
    /// match none; the strongest pair between the groups is too weak.
    fn overlap(&self) -> Overlap {
        let (most, rest) = self.names.split_at(self.names.len().min(4));
        let (two, rest) = rest.split_at(rest.len().min(2));
        let groups = [most, two].into_iter().chain(rest.chunks(1));
        let link = |(first, second, matches): &(usize, usize, usize)| OverlapLink {
            first: self.names[*first].clone(),
            second: self.names[*second].clone(),
            matches: *matches,
            connects: *matches >= 30,
        };
        let links = [(0, 1, 240), (1, 2, 180), (2, 3, 64), (0, 2, 41), (4, 5, 130), (3, 4, 17)];
        let is_there = |(_, second, _): &&(usize, usize, usize)| *second < self.names.len();
        Overlap {
            groups: groups.map(<[String]>::to_vec).filter(|group| !group.is_empty()).collect(),
            links: links.iter().filter(is_there).map(link).collect(),
        }
    }

    /// Runs one stage, or skips it if an earlier attempt has finished it.
    fn stage(&self, stage: Stage, round: u32) -> Outcome {
        tell(&Event::StageStarted { stage, round });
        let mark = self.output.join(format!(".done-{}-{round}", stage.name()));
        let skipped = mark.exists();
        let start = Instant::now();
        if !skipped {
            let saved = self.saved.as_ref().filter(|_| stage == Stage::Reconstruct);
            let first = saved.map_or(Ok(0), Saved::step)?;
            for done in first + 1..=TICKS {
                sleep(self.tick_of(stage));
                let steps_per_second = (stage == Stage::Reconstruct).then_some(25.0);
                tell(&Event::StageAdvanced { stage, round, done, total: TICKS, steps_per_second });
                if stage == Stage::Reconstruct {
                    self.show_training(round, done)?;
                }
                saved.map_or(Ok(()), |saved| saved.done(done))?;
            }
            saved.map_or(Ok(()), Saved::forget)?;
            if stage == Stage::Reconstruct {
                fs::remove_file(RunFolder::new(&self.output).work().live_picture())?;
            }
            fs::write(mark, "")?;
        }
        tell(&Event::StageFinished {
            stage,
            round,
            seconds: start.elapsed().as_secs_f64(),
            skipped,
        });
        let index = Stage::ALL.iter().position(|&s| s == stage).unwrap_or(0) as f64;
        let progress = (f64::from(round.max(1) - 1) + (index + 1.0) / 7.0)
            / f64::from(self.options.round_count());
        let left = self.left_after(stage, round).as_secs_f64();
        tell(&Event::Progress { progress, eta_seconds: Some(left) });
        Ok(())
    }

    /// Emits the events for viewers of a training. Views are held out according to the options, and
    /// compared with ground truth if the capture has it.
    fn show_training(&self, round: u32, done: u64) -> Outcome {
        let (step, steps) = (100 * done as u32, 100 * TICKS as u32);
        let learnt = done as f64 + f64::from(round);
        tell(&Event::TrainingSeen {
            round,
            step,
            steps,
            loss: 0.2 / learnt,
            gaussians: 1000 * done,
        });
        let held_out = self.options.held_out != "none";
        if held_out {
            tell(&Event::HeldOutSeen {
                round,
                step,
                steps,
                psnr_cc_db: 28.0 - 16.0 / learnt,
                ssim: 0.9 - 0.5 / learnt,
                views: 3,
                truth: self.has_truth(),
            });
        }
        let Some(view) = self.names.first() else {
            return Ok(());
        };
        let picture = RunFolder::new(&self.output).work().live_picture();
        self.picture(&picture, view, 0.2 + 0.08 * done as f32)?;
        tell(&Event::ViewSeen { round, step, view: view.clone(), held_out });
        Ok(())
    }

    /// The time of the stages after this one.
    fn left_after(&self, stage: Stage, round: u32) -> Duration {
        let of = |stage: &Stage| TICKS as u32 * self.tick_of(*stage);
        let later: Duration = Stage::ALL.iter().filter(|other| **other > stage).map(of).sum();
        let rounds = self.options.round_count().saturating_sub(round.max(1));
        later + rounds * Stage::ALL.iter().map(of).sum::<Duration>()
    }

    /// A plan named after a stage slows only that stage down; `saves` slows training down.
    fn tick_of(&self, stage: Stage) -> Duration {
        let trains = self.saved.as_ref().map(|_| Stage::Reconstruct.name());
        let plan = trains.unwrap_or(&self.plan);
        let lingers = Stage::ALL.iter().any(|stage| stage.name() == plan);
        if lingers && stage.name() != plan { Duration::from_millis(2) } else { self.tick }
    }

    /// Returns whether the capture has ground truth.
    fn has_truth(&self) -> bool {
        self.capture.join("gt").exists()
    }

    /// Returns whether this is the first call, over all attempts.
    fn first(&self, what: &str) -> Result<bool, Box<dyn Error>> {
        let mark = self.output.join(format!(".{what}"));
        let first = !mark.exists();
        fs::write(mark, "")?;
        Ok(first)
    }

    fn write_cameras(&self) -> Outcome {
        let k = Intrinsics { width: 160, height: 90, fx: 120.0, fy: 120.0, cx: 80.0, cy: 45.0 };
        let cameras: Vec<NamedCamera> = self
            .names
            .iter()
            .enumerate()
            .map(|(i, name)| {
                let eye = DVec3::new(i as f64 - 1.0, -0.5, -4.0);
                let split = if i % 8 == 0 { Split::HeldOut } else { Split::Train };
                NamedCamera::new(name, &Camera::look_at(k, eye, DVec3::ZERO, DVec3::Y), split)
            })
            .collect();
        fs::write(self.output.join("cameras.json"), serde_json::to_vec(&cameras)?)?;
        self.write_points()?;
        let drawing = r#"<svg xmlns="http://www.w3.org/2000/svg" width="400" height="200"/>"#;
        fs::write(self.output.join("poses.svg"), drawing)?;
        for name in &self.names {
            let folder = RunFolder::new(&self.output);
            self.picture(&folder.input(name), name, 0.15)?;
            if self.has_truth() {
                self.picture(&folder.truth(name), name, 1.0)?;
            }
        }
        Ok(())
    }

    /// Sparse points on a sphere around the origin.
    fn write_points(&self) -> Outcome {
        let point = |i: u32| {
            let (turn, height) = (2.4 * f64::from(i), f64::from(i) / 200.0 - 1.0);
            let away = (1.0 - height * height).sqrt();
            serde_json::json!({ "position": [away * turn.cos(), height, away * turn.sin()],
                "colour": [200, 160, 90], "error": 0.4, "track": 3 })
        };
        let points: Vec<_> = (0..400).map(point).collect();
        let poses = serde_json::json!({ "views": [], "points": points });
        fs::write(self.output.join("poses.json"), serde_json::to_vec(&poses)?)?;
        Ok(())
    }

    fn write_round(&self, round: u32) -> Outcome {
        let names = &self.names;
        for name in names {
            let gain = 0.6 + 0.15 * round as f32;
            for kind in RoundPictures::ALL {
                let path = RunFolder::new(&self.output).round(round).picture(kind, name);
                let less = if kind == RoundPictures::Enhanced { 0.1 } else { 0.0 };
                self.picture(&path, name, gain - less)?;
            }
            let folder = RunFolder::new(&self.output);
            fs::create_dir_all(folder.restored())?;
            self.photograph(name, gain)?
                .save_as(&folder.restored_view(name), EncodeFormat::Png16)?;
        }
        let cameras = self.output.join("cameras.json");
        let of_round = self.output.join(format!("rounds/{round}/cameras.json"));
        fs::copy(cameras, of_round)?;
        let scene = if self.plan == "bad_scene" { "crash" } else { "ply" };
        self.write_scene(&format!("rounds/{round}/scene.ply"), scene)?;
        let verdict = |name| {
            serde_json::json!({ "name": name, "status": "registered", "matches": 40,
                "fitting": 38, "error_px": 0.5 })
        };
        let verdicts: Vec<_> = names.iter().map(verdict).collect();
        let report = serde_json::json!({ "adapter": "played <i>adapter</i>",
            "seed": self.options.seed, "views": names.len(), "registered": names.len(),
            "shaken_views": names.len() / 4, "capture_shake": "shaken",
            "exposure": scores::exposure(names), "poses": { "verdicts": verdicts } });
        fs::write(self.output.join("metrics.json"), serde_json::to_vec(&report)?)?;
        Ok(())
    }

    /// Writes `words`, or a real scene of grey balls if the plan is `splats`.
    fn write_scene(&self, name: &str, words: &str) -> Outcome {
        let path = self.output.join(name);
        if self.plan != "splats" {
            return Ok(fs::write(path, words)?);
        }
        let place = |i: usize| [i % 10, i / 10 % 10, i / 100].map(|n| n as f32 / 5.0 - 1.0);
        let scene = Gaussians {
            means: (0..BALLS).map(place).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; BALLS],
            log_scales: vec![[-3.0; 3]; BALLS],
            opacity_logits: vec![2.0; BALLS],
            sh: vec![0.0; 3 * BALLS],
            sh_degree: 0,
        };
        Ok(ply::write(&scene, &Normalisation::default(), &path)?)
    }

    /// Writes a photograph of the capture with a gain.
    fn picture(&self, path: &Path, name: &str, gain: f32) -> Outcome {
        fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
        self.photograph(name, gain)?.save(path)?;
        Ok(())
    }

    /// A photograph of the capture with a gain.
    fn photograph(&self, name: &str, gain: f32) -> Result<Image, Box<dyn Error>> {
        let source = fs::read_dir(self.capture.join("images"))?
            .flatten()
            .find(|entry| entry.path().file_stem().is_some_and(|stem| stem == name))
            .ok_or("no photograph")?;
        let image: Image = Image::load_at_most(&source.path(), 280)?;
        Ok(image.map(|v| (v * gain).min(1.0)))
    }
}

/// The names of the readable photographs, in order, as the real program lists them.
fn names(capture: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let is_read = |path: &Path| -> bool {
        let image: Result<Image, _> = Image::load_at_most(path, 16);
        image.is_ok()
    };
    let mut names: Vec<String> = fs::read_dir(capture.join("images"))?
        .flatten()
        .filter(|entry| is_read(&entry.path()))
        .filter_map(|entry| Some(entry.path().file_stem()?.to_str()?.to_owned()))
        .collect();
    names.sort();
    Ok(names)
}

fn fail(kind: &str, detail: &str, hint: &str) -> Outcome {
    tell(&Event::Failed {
        kind: kind.to_owned(),
        detail: detail.to_owned(),
        hint: hint.to_owned(),
    });
    std::process::exit(3);
}
