//! The stages up to D_i as methods of the job, in the order of Algorithm 1.

use std::path::Path;
use std::time::Instant;

use super::config::Guide;
use super::error::PipelineError;
use super::find_poses;
use super::job::Job;
use super::training::Scene;
use super::views::{self, View};
use super::workspace::fingerprint;
use crate::camera::NamedCamera;
use crate::event::Stage;
use crate::image::{EncodeFormat, Image};
use crate::poses::Poses;

/// JPEG quality of the pictures that people look at; metrics never read them.
const PREVIEW_QUALITY: u8 = 90;

impl Job<'_, '_> {
    /// Structure from motion, once a job, or what an earlier run of the same capture found.
    pub fn poses(&mut self) -> Result<Poses, PipelineError> {
        let source = self.tools.sfm.describe();
        let shared = fingerprint(&[
            &self.capture.fingerprint,
            &source,
            &self.options.seed.to_string(),
            "any network",
        ]);
        // What a network had a hand in is of no use to a run with another one.
        let key = fingerprint(&[&shared, &format!("{:?}", self.networks())]);
        let path = self.workspace.path("poses.json");
        let cache = self.tools.pose_cache.clone();
        let cached = |key: &str| {
            cache
                .as_ref()
                .map(|folder| folder.join(format!("{key}.json")))
        };
        let finished = |key| self.workspace.finished("poses", key);
        let known = finished(&shared)
            .or(finished(&key))
            .and_then(|_| self.workspace.read_json(&path));
        let reused: Option<Poses> = known.or_else(|| {
            let of_any = self
                .workspace
                .read_json(&cached(&shared)?)
                .filter(find_poses::without_network);
            let poses = of_any.or_else(|| self.workspace.read_json(&cached(&key)?))?;
            self.sink.log(format!(
                "poses: those of an earlier run of this capture ({source})"
            ));
            Some(poses)
        });
        let poses = match reused {
            Some(poses) => {
                self.skip_stage(Stage::Poses, 0, poses.seconds);
                poses
            }
            None => self.stage(Stage::Poses, 0, Self::find_poses)?,
        };
        if poses.low_confidence {
            self.sink
                .warn("poses_low_confidence", low_confidence(&poses));
        }
        if poses.registered < poses.total {
            let message = format!(
                "{} of {} photographs have a pose; the others are left out",
                poses.registered, poses.total
            );
            self.sink.warn("poses_missing", message);
        }
        self.workspace.write_json(&path, &poses)?;
        let key = if find_poses::without_network(&poses) {
            shared
        } else {
            key
        };
        if let Some(kept) = cached(&key).filter(|kept| !kept.exists()) {
            self.workspace.write_json(&kept, &poses)?;
        }
        self.workspace.stamp("poses", &key, poses.seconds)?;
        self.inputs = self.rounds_fingerprint(&poses);
        self.note_poses(&poses);
        Ok(poses)
    }

    fn rounds_fingerprint(&self, poses: &Poses) -> String {
        let options = serde_json::to_string(self.options).unwrap_or_default();
        let poses = serde_json::to_string(poses).unwrap_or_default();
        let networks = self.networks();
        let networks: Vec<String> = networks
            .iter()
            .map(|(use_of, info)| format!("{use_of} {info:?}"))
            .collect();
        fingerprint(&[
            &self.capture.fingerprint,
            &poses,
            &options,
            &networks.join(" "),
            &self.tools.gpu.describe().to_string(),
        ])
    }

    /// L_j: the registered photographs, undistorted, at working size; cameras and pictures of
    /// the input are written for whoever looks at the run.
    pub fn views(&mut self, poses: &Poses) -> Result<Vec<View>, PipelineError> {
        let views = views::load(self.capture, poses, self.options, self.cancel)?;
        self.write_cameras(&views)?;
        for view in &views {
            self.preview(&self.workspace.path("inputs"), &view.name, &view.dark)?;
            if let Some(gt) = &view.gt {
                self.preview(&self.workspace.path("gt"), &view.name, gt)?;
            }
        }
        Ok(views)
    }

    /// Moves the views to where the training of `scene` found them.
    pub fn place(&mut self, views: &mut [View], scene: &Scene) -> Result<(), PipelineError> {
        for (view, camera) in views.iter_mut().zip(&scene.training.cameras) {
            view.camera = *camera;
        }
        self.write_cameras(views)
    }

    fn write_cameras(&self, views: &[View]) -> Result<(), PipelineError> {
        let cameras: Vec<NamedCamera> = views
            .iter()
            .map(|view| NamedCamera::new(&view.name, &view.camera, view.split))
            .collect();
        self.workspace
            .write_json(&self.workspace.path("cameras.json"), &cameras)
    }

    /// D_i: every view through the network, from round 2 on guided by HR.
    pub fn deblur(
        &mut self,
        round: u32,
        views: &[View],
        enhanced: &[Image],
        guides: Option<&[Image]>,
    ) -> Result<Vec<Image>, PipelineError> {
        let guides = guides.filter(|_| self.options.guide != Guide::None);
        self.each_view(Stage::Deblur, round, "deblurred", views, |job, i| {
            let image = job
                .tools
                .deblurrer
                .deblur(&enhanced[i], guides.map(|guides| &guides[i]))?;
            Ok((image, job.tools.deblurrer.take_warnings()))
        })
    }

    /// A network's stage: `work` on every view, with its warnings. Each result is kept under `kind`
    /// until the run has ended, so that a stage is done once, and told, so that it is known to be
    /// alive.
    pub(super) fn each_view(
        &mut self,
        stage: Stage,
        round: u32,
        kind: &str,
        views: &[View],
        mut work: impl FnMut(&mut Self, usize) -> Result<(Image, Vec<String>), PipelineError>,
    ) -> Result<Vec<Image>, PipelineError> {
        let key = self.stage_fingerprint(stage, round);
        let name = format!("{}-{round}", stage.name());
        let folder = self.workspace.work().join(kind).join(round.to_string());
        let file = |view: &View| folder.join(format!("{}.f32", view.name));
        if let Some(seconds) = self.workspace.finished(&name, &key) {
            let stored: Option<Vec<Image>> = views
                .iter()
                .map(|view| read_planar(&file(view), view))
                .collect();
            if let Some(stored) = stored {
                self.skip_stage(stage, round, seconds);
                return Ok(stored);
            }
        }
        let started = Instant::now();
        let images = self.stage(stage, round, |job| {
            let mut images = Vec::with_capacity(views.len());
            for (i, view) in views.iter().enumerate() {
                job.cancel.check()?;
                let (image, warnings) = work(job, i)?;
                for warning in warnings {
                    job.sink
                        .warn(stage.name(), format!("{}: {warning}", view.name));
                }
                job.workspace
                    .write(&file(view), bytemuck::cast_slice(image.data()))?;
                images.push(image);
                job.advance(stage, round, i + 1, views.len());
            }
            if round > 0 {
                job.previews(round, kind, views, &images)?;
            }
            Ok(images)
        })?;
        self.workspace
            .stamp(&name, &key, started.elapsed().as_secs_f64())?;
        Ok(images)
    }

    pub(super) fn previews(
        &self,
        round: u32,
        kind: &str,
        views: &[View],
        images: &[Image],
    ) -> Result<(), PipelineError> {
        let folder = self.workspace.round(round).join(kind);
        views
            .iter()
            .zip(images)
            .try_for_each(|(view, image)| self.preview(&folder, &view.name, image))
    }

    pub(super) fn preview(
        &self,
        folder: &Path,
        name: &str,
        image: &Image,
    ) -> Result<(), PipelineError> {
        self.picture(
            &folder.join(format!("{name}.jpg")),
            image,
            EncodeFormat::Jpeg(PREVIEW_QUALITY),
        )
    }

    /// Writes a picture whole or not at all.
    pub(super) fn picture(
        &self,
        path: &Path,
        image: &Image,
        format: EncodeFormat,
    ) -> Result<(), PipelineError> {
        let bytes = image
            .encode(format)
            .map_err(|source| PipelineError::Photograph {
                name: path.display().to_string(),
                source,
            })?;
        self.workspace.write(path, &bytes)
    }
}

fn low_confidence(poses: &Poses) -> String {
    format!(
        "the poses met no acceptance rule ({} of {} views, {} points): look at the result before you rely on it",
        poses.registered,
        poses.total,
        poses.points.len()
    )
}

fn read_planar(path: &Path, view: &View) -> Option<Image> {
    let bytes = std::fs::read(path).ok()?;
    let (width, height) = (view.dark.width(), view.dark.height());
    let values: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
    (bytes.len() == 12 * width * height).then(|| Image::from_planar(width, height, values))
}
