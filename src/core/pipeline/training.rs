//! V_i: training, from a checkpoint, the scene before, or the points.

use std::cell::RefCell;
use std::path::PathBuf;
use std::time::Instant;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::config::{NoiseMode, ShakeModel, Start};
use super::error::PipelineError;
use super::job::Job;
use super::tone::Tone;
use super::views::View;
use crate::camera::{Camera, Split};
use crate::event::{Event, Stage};
use crate::gaussians::{Gaussians, ply};
use crate::image::Image;
use crate::metrics;
use crate::metrics::report::NoiseMapStatistics;
use crate::poses::{Poses, SparsePoint};
use crate::reconstruct::{
    self, Beginning, Checkpoint, Registration, Response, TrainConfig, TrainHooks, TrainStart,
    Trained, TrainingView,
};

/// V_i with the facts of its training, as stored beside its `scene.ply`.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The Gaussians.
    pub gaussians: Gaussians,
    /// How they were trained.
    pub training: Training,
}

/// Facts of one training.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Training {
    pub(super) steps: u64,
    pub(super) steps_per_second: f64,
    pub(super) non_finite_gradients: u64,
    pub(super) noise: Option<NoiseMapStatistics>,
    pub(super) shake_px: Option<f64>,
    /// Of all views, in their order.
    pub(super) cameras: Vec<Camera>,
    /// Mean way that the corrections of the cameras moved the middle of the images, px.
    pub(super) pose_correction_px: Option<f64>,
}

/// What a round is trained on.
pub struct Material<'a> {
    /// i, 1-based.
    pub round: u32,
    /// All views, with their cameras and splits.
    pub views: &'a [View],
    /// D_i, or H_i where the shake explains it (`train_on`), in the order of the views.
    pub images: &'a [Image],
    /// How light became the values of the images.
    pub response: Response,
}

impl Job<'_, '_> {
    /// V_i: noise-aware splats on the training views of D_i.
    pub fn reconstruct(
        &mut self,
        material: &Material<'_>,
        poses: &Poses,
        previous: Option<(Scene, Option<Tone>)>,
    ) -> Result<Scene, PipelineError> {
        let round = material.round;
        let key = self.stage_fingerprint(Stage::Reconstruct, round);
        let name = format!("reconstruct-{round}");
        let (scene_file, facts) = (
            self.workspace.round(round).join("scene.ply"),
            self.workspace.round(round).join("training.json"),
        );
        if let (Some(seconds), Some(training)) = (
            self.workspace.finished(&name, &key),
            self.workspace.read_json::<Training>(&facts),
        ) {
            let gaussians = ply::read(&scene_file)?;
            self.skip_stage(Stage::Reconstruct, round, seconds);
            return Ok(Scene {
                gaussians,
                training,
            });
        }
        let started = Instant::now();
        let scene = self.stage(Stage::Reconstruct, round, |job| {
            let config = job.train_config(material, poses);
            let start = job.train_start(material, poses, previous, &config)?;
            let scene = job.train(material, start, &config)?;
            job.workspace.make_folder(&job.workspace.round(round))?;
            ply::write(&scene.gaussians, &scene_file)?;
            job.workspace.write_json(&facts, &scene.training)?;
            Ok(scene)
        })?;
        self.workspace
            .stamp(&name, &key, started.elapsed().as_secs_f64())?;
        Ok(scene)
    }

    /// From the checkpoint of an interrupted training, the scene of the round before, or the
    /// points.
    fn train_start(
        &mut self,
        material: &Material<'_>,
        poses: &Poses,
        previous: Option<(Scene, Option<Tone>)>,
        config: &TrainConfig,
    ) -> Result<TrainStart, PipelineError> {
        let round = material.round;
        let key = self.stage_fingerprint(Stage::Reconstruct, round);
        if self.workspace.finished("checkpoint", &key).is_some() {
            match std::fs::read(self.checkpoint_path()).map(|bytes| Checkpoint::from_bytes(&bytes))
            {
                Ok(Ok(checkpoint)) => {
                    self.sink.log(format!(
                        "round {round}: resumed at step {}",
                        checkpoint.step
                    ));
                    return Ok(TrainStart::Resume(checkpoint));
                }
                _ => self.sink.warn(
                    "checkpoint",
                    "the checkpoint cannot be read; the round starts again".to_owned(),
                ),
            }
        }
        if let (Start::Warm, Some((scene, Some(tone)))) = (self.options.start, previous) {
            let mut gaussians = scene.gaussians;
            let curve = tone.scene();
            gaussians.map_colours(|rgb| curve.apply_colour(rgb), |rgb| curve.slope(rgb));
            return Ok(TrainStart::Fresh(gaussians));
        }
        let cameras: Vec<Camera> = material.views.iter().map(|view| view.camera).collect();
        Ok(TrainStart::Fresh(reconstruct::initialise(
            &coloured_points(poses, material.views, material.images),
            &cameras,
            Beginning {
                cap: config.cap,
                fill_up: self.options.fill_up as usize,
            },
            &config.schedule(),
        )))
    }

    fn checkpoint_path(&self) -> PathBuf {
        self.workspace.work().join("training.checkpoint")
    }

    fn train_config(&self, material: &Material<'_>, poses: &Poses) -> TrainConfig {
        let cameras: Vec<Camera> = material.views.iter().map(|view| view.camera).collect();
        TrainConfig {
            steps: self.options.steps,
            cap: self.options.cap as usize,
            sh_degree: self.options.sh_degree,
            noise: self.options.noise,
            shake: (self.options.shake == ShakeModel::Kernel).then(|| material.response.clone()),
            refine_poses: self
                .options
                .refine_poses
                .then(|| reconstruct::scene_depth(&cameras, &points(poses))),
            resolution_schedule: self.options.resolution_schedule,
            warm: material.round > 1 && self.options.start == Start::Warm,
            background: self.options.background,
            dropout: self.options.dropout,
            densify: self.options.densify,
            view_colour: self.options.view_colour,
            seed: self
                .options
                .seed
                .wrapping_add(u64::from(material.round) << 32),
            extent: reconstruct::scene_extent(&cameras, &points(poses), self.options.extent),
        }
    }

    fn train(
        &mut self,
        material: &Material<'_>,
        start: TrainStart,
        config: &TrainConfig,
    ) -> Result<Scene, PipelineError> {
        let round = material.round;
        let training = training_views(material, Split::Train);
        let trained = self.train_with_hooks(round, &training, start, config)?;
        for warning in &trained.warnings {
            self.sink
                .warn("training", format!("round {round}: {warning}"));
        }
        let seconds = trained.seconds.max(1e-9);
        let cameras = self.cameras_after(material, &trained, config)?;
        let correction = correction_px(material.views, &cameras, config.refine_poses);
        Ok(Scene {
            gaussians: trained.gaussians,
            training: Training {
                steps: trained.steps,
                steps_per_second: trained.steps as f64 / seconds,
                non_finite_gradients: trained.non_finite_gradients,
                shake_px: trained.shake_px,
                cameras,
                pose_correction_px: correction,
                noise: trained
                    .noise
                    .filter(|_| self.options.noise != NoiseMode::Off),
            },
        })
    }

    /// The cameras of all views: those that trained as the training left them, the others found in
    /// its scene.
    fn cameras_after(
        &self,
        material: &Material<'_>,
        trained: &Trained,
        config: &TrainConfig,
    ) -> Result<Vec<Camera>, PipelineError> {
        let held_out = training_views(material, Split::HeldOut);
        let registered = match config.refine_poses {
            Some(depth) if !held_out.is_empty() => {
                let (gpu, shake) = (self.tools.gpu, config.shake.as_ref());
                Registration::new(gpu, &held_out, &trained.gaussians, shake)?
                    .cameras(depth, self.cancel)?
            }
            _ => held_out.iter().map(|view| view.camera).collect(),
        };
        let (mut trained, mut registered) = (trained.cameras.iter(), registered.iter());
        let of = |view: &View| match view.split {
            Split::Train => trained.next(),
            Split::HeldOut => registered.next(),
        };
        let given = material.views.iter().map(|view| view.camera);
        Ok(material
            .views
            .iter()
            .map(of)
            .zip(given)
            .map(|(found, given)| *found.unwrap_or(&given))
            .collect())
    }

    /// Trains with progress, cancellation and checkpoints wired to the job.
    fn train_with_hooks(
        &mut self,
        round: u32,
        views: &[TrainingView],
        start: TrainStart,
        config: &TrainConfig,
    ) -> Result<Trained, PipelineError> {
        let (path, key) = (
            self.checkpoint_path(),
            self.stage_fingerprint(Stage::Reconstruct, round),
        );
        let (gpu, cancel) = (self.tools.gpu, self.cancel);
        let job = RefCell::new(self);
        let mut progress = |done: u64, total: u64, rate: f64| {
            let job = &mut **job.borrow_mut();
            let stage = Stage::Reconstruct;
            job.sink.event(&Event::StageAdvanced {
                stage,
                round,
                done,
                total,
                steps_per_second: Some(rate),
            });
            job.plan
                .advance(stage, done as f64 / total.max(1) as f64, job.sink);
        };
        let mut checkpoint = |checkpoint: &Checkpoint| {
            let job = &mut **job.borrow_mut();
            let saved = job
                .workspace
                .write(&path, &checkpoint.to_bytes())
                .and_then(|()| job.workspace.stamp("checkpoint", &key, 0.0));
            // A checkpoint that cannot be written costs time after a crash, not this run.
            if let Err(error) = saved {
                job.sink
                    .warn("checkpoint", format!("round {round}: {error}"));
            }
        };
        let mut hooks = TrainHooks {
            cancel,
            progress: &mut progress,
            checkpoint: Some(&mut checkpoint),
        };
        Ok(reconstruct::train(gpu, views, start, config, &mut hooks)?)
    }
}

/// The views of one split with their images of this round.
fn training_views(material: &Material<'_>, split: Split) -> Vec<TrainingView> {
    material
        .views
        .iter()
        .zip(material.images)
        .filter(|(view, _)| view.split == split)
        .map(|(view, image)| TrainingView {
            name: view.name.clone(),
            camera: view.camera,
            image: image.clone(),
            noise_sigma: metrics::noise_sigma(image) as f32,
        })
        .collect()
}

/// How far what lies at `depth` in the middle of the views was moved, mean, px.
fn correction_px(views: &[View], cameras: &[Camera], depth: Option<f64>) -> Option<f64> {
    let depth = depth?;
    let moved = views.iter().zip(cameras).filter_map(|(view, after)| {
        let before = view.camera;
        let point = before.centre() + depth * before.forward();
        Some((after.project(point)?.0 - before.project(point)?.0).length())
    });
    let moved: Vec<f64> = moved.collect();
    (!moved.is_empty()).then(|| moved.iter().sum::<f64>() / moved.len() as f64)
}

/// The sparse points in the colours that the round trains on: the median over the training views
/// that a point falls into. COLMAP's own colours are those of its brightened copies; splats that
/// start much too bright turn transparent before they turn dark, and holes stay.
fn coloured_points(poses: &Poses, views: &[View], images: &[Image]) -> Vec<reconstruct::Point> {
    let seen = |position: [f64; 3]| -> Vec<[f32; 3]> {
        views
            .iter()
            .zip(images)
            .filter(|(view, _)| view.split == Split::Train)
            .filter_map(|(view, image)| {
                let (pixel, _) = view.camera.project(position.into())?;
                let inside = pixel.cmpge(DVec2::ZERO).all()
                    && pixel.x < image.width() as f64
                    && pixel.y < image.height() as f64;
                inside.then(|| image.get(pixel.x as usize, pixel.y as usize))
            })
            .collect()
    };
    let colour = |point: &SparsePoint| {
        let seen = seen(point.position);
        if seen.is_empty() {
            return point.colour;
        }
        std::array::from_fn(|channel| {
            let mut values: Vec<f32> = seen.iter().map(|rgb| rgb[channel]).collect();
            values.sort_by(f32::total_cmp);
            (values[values.len() / 2].clamp(0.0, 1.0) * 255.0).round() as u8
        })
    };
    poses
        .points
        .iter()
        .map(|point| (point.position.map(|x| x as f32), colour(point)))
        .collect()
}

/// Positions and colours of the sparse points, as the trainer takes them.
fn points(poses: &Poses) -> Vec<reconstruct::Point> {
    poses
        .points
        .iter()
        .map(|point| (point.position.map(|x| x as f32), point.colour))
        .collect()
}
