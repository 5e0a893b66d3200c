//! What a run leaves: the report after every round, and the delivered scene.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::json;

use super::Outcome;
use super::error::PipelineError;
use super::job::Job;
use super::judge::BRIGHTENED;
use super::training::Training;
use crate::camera::NamedCamera;
use crate::deblur::DeblurInfo;
use crate::event::Event;
use crate::metrics::Report;
use crate::poses::Poses;

impl Job<'_, '_> {
    /// The outcome of an earlier run of the same inputs, when it had delivered.
    pub(super) fn delivered(&mut self) -> Option<Outcome> {
        let seconds = self.workspace.finished("run", &self.inputs)?;
        let report: Report = self
            .workspace
            .read_json(&self.workspace.path("metrics.json"))?;
        self.sink.log(
            "this capture was finished with these options before; its result stands".to_owned(),
        );
        self.sink.event(&Event::Progress {
            progress: 1.0,
            eta_seconds: Some(0.0),
        });
        self.sink.event(&Event::Finished {
            best_round: report.best_round,
            seconds,
        });
        Some(Outcome { report })
    }

    /// Facts of the poses for the report.
    pub(super) fn note_poses(&mut self, poses: &Poses) {
        let rung = poses.rung.map(String::from);
        self.poses_facts = BTreeMap::from([
            ("source".to_owned(), json!(poses.source)),
            ("rung".to_owned(), json!(rung)),
            ("registered".to_owned(), json!(poses.registered)),
            ("total".to_owned(), json!(poses.total)),
            ("points".to_owned(), json!(poses.points.len())),
            (
                "mean_reprojection_error_px".to_owned(),
                json!(poses.mean_reprojection_error),
            ),
            ("mean_track".to_owned(), json!(poses.mean_track)),
            ("low_confidence".to_owned(), json!(poses.low_confidence)),
        ]);
    }

    /// Writes `metrics.json` with the rounds so far.
    pub(super) fn write_report(&mut self) -> Result<Report, PipelineError> {
        let report = self.report();
        self.workspace
            .write_json(&self.workspace.path("metrics.json"), &report)?;
        Ok(report)
    }

    fn report(&self) -> Report {
        let model =
            |info: &DeblurInfo| format!("{} sha256:{} on {}", info.id, info.sha256, info.provider);
        let models = self
            .networks()
            .iter()
            .map(|(use_of, info)| ((*use_of).to_owned(), model(info)))
            .collect();
        let count = |key: &str| {
            self.poses_facts
                .get(key)
                .and_then(serde_json::Value::as_u64)
                .unwrap_or_default() as u32
        };
        Report {
            best_round: self.best_round(),
            rounds: self.rounds.clone(),
            registered: count("registered"),
            views: count("total"),
            stages: self
                .seconds
                .iter()
                .map(|(stage, s)| (stage.name().to_owned(), *s))
                .collect(),
            adapter: self.tools.gpu.describe().to_string(),
            models,
            fallbacks: self.tools.fallbacks.clone(),
            poses: self.poses_facts.clone(),
            seed: self.options.seed,
            config: json!(self.options),
        }
    }

    /// The last round that was not judged worse than the one before it.
    fn best_round(&self) -> u32 {
        let mut best = 1;
        for round in &self.rounds {
            if round.worse_than_previous {
                break;
            }
            best = round.round;
        }
        best
    }

    /// Copies the best round's scene and renders to the top of the folder and removes what only
    /// a resumed run would read.
    pub(super) fn deliver(mut self) -> Result<Outcome, PipelineError> {
        let report = self.write_report()?;
        let best = self.workspace.round(report.best_round);
        if report.best_round as usize != self.rounds.len() {
            let message = format!(
                "round {} scored worse than round {}, which is delivered",
                self.rounds.len(),
                report.best_round
            );
            self.sink.warn("round_worse", message);
        }
        let brightened = best.join(BRIGHTENED);
        let scene = if brightened.exists() {
            brightened
        } else {
            best.join("scene.ply")
        };
        let bytes = fs::read(&scene).map_err(|e| PipelineError::io(&scene, e))?;
        self.workspace
            .write(&self.workspace.path("scene.ply"), &bytes)?;
        self.deliver_cameras(&best)?;
        let seconds = self.started.elapsed().as_secs_f64();
        self.workspace.stamp("run", &self.inputs, seconds)?;
        let work = self.workspace.work();
        for folder in ["deblurred", "brightened", "training.checkpoint"] {
            let path = work.join(folder);
            let gone = if path.is_dir() {
                fs::remove_dir_all(&path)
            } else {
                fs::remove_file(&path)
            };
            match gone {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                    self.sink
                        .log(format!("cannot remove {}: {e}", path.display()));
                }
                _ => {}
            }
        }
        self.sink.event(&Event::Progress {
            progress: 1.0,
            eta_seconds: Some(0.0),
        });
        self.sink.event(&Event::Finished {
            best_round: report.best_round,
            seconds,
        });
        Ok(Outcome { report })
    }

    /// The cameras as the delivered round found them; a later round has moved them a little.
    fn deliver_cameras(&self, best: &Path) -> Result<(), PipelineError> {
        let path = self.workspace.path("cameras.json");
        let training: Option<Training> = self.workspace.read_json(&best.join("training.json"));
        let named: Option<Vec<NamedCamera>> = self.workspace.read_json(&path);
        let (Some(training), Some(named)) = (training, named) else {
            return Ok(());
        };
        let placed: Vec<NamedCamera> = named
            .into_iter()
            .zip(&training.cameras)
            .map(|(named, camera)| NamedCamera::new(named.name, camera, named.split))
            .collect();
        self.workspace.write_json(&path, &placed)
    }
}
