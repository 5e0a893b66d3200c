//! The run to be judged.

use std::path::Path;

use serde::de::DeserializeOwned;

use fled_core::camera::{Camera, NamedCamera, Split};
use fled_core::gaussians::{Gaussians, ply};
use fled_core::poses::{Lens, Poses};
use fled_core::reconstruct::{Point, scene_depth};
use fled_core::run_folder::RunFolder;

use super::error::EvaluationError;

/// A scene and the cameras that it was trained with, both in the world of the training.
pub struct Subject {
    /// The scene, at the target brightness.
    pub gaussians: Gaussians,
    cameras: Vec<NamedCamera>,
    poses: Poses,
    depth: f64,
}

impl Subject {
    /// Longest side of its views, px.
    pub fn longest_side(&self) -> usize {
        let side = |named: &NamedCamera| named.camera().intrinsics;
        let sides = self.cameras.iter().map(side).map(|k| k.width.max(k.height));
        sides.max().unwrap_or(0)
    }

    /// Reads the results of a run.
    ///
    /// # Errors
    /// [`EvaluationError::Run`].
    pub fn open(run: &RunFolder) -> Result<Self, EvaluationError> {
        let scene = run.scene();
        let scene = ply::read(&scene).map_err(|error| EvaluationError::run(&scene, error))?;
        let cameras: Vec<NamedCamera> = read(&run.cameras())?;
        let within = |named: &NamedCamera| {
            let camera = scene.normalisation.within(&named.camera());
            NamedCamera::new(&named.name, &camera, named.split)
        };
        let cameras = cameras.iter().map(within).collect();
        Ok(Self::new(scene.gaussians, cameras, read(&run.poses())?))
    }

    pub(super) fn new(gaussians: Gaussians, cameras: Vec<NamedCamera>, poses: Poses) -> Self {
        let point = |mean: &[f32; 3]| Point { position: *mean, colour: [0; 3] };
        let points: Vec<Point> = gaussians.means.iter().map(point).collect();
        let all: Vec<Camera> = cameras.iter().map(NamedCamera::camera).collect();
        let depth = scene_depth(&all, &points);
        Self { gaussians, cameras, poses, depth }
    }

    /// The lens found for a view, at the size of the original photograph.
    ///
    /// # Errors
    /// [`EvaluationError::NoLens`] if the poses do not belong to the scene.
    pub fn lens(&self, name: &str) -> Result<Lens, EvaluationError> {
        let view = self.poses.views.iter().find(|view| view.name == name);
        let no_lens = || EvaluationError::NoLens { view: name.to_owned() };
        view.map(|view| view.lens).ok_or_else(no_lens)
    }

    /// The training views with their cameras.
    pub fn training(&self) -> impl Iterator<Item = (&str, Camera)> + Clone {
        self.cameras
            .iter()
            .filter(|camera| camera.split == Split::Train)
            .map(|camera| (camera.name.as_str(), camera.camera()))
    }

    /// Longest side of the views, px.
    pub fn size(&self) -> usize {
        let sides = |camera: &NamedCamera| camera.intrinsics.width.max(camera.intrinsics.height);
        self.cameras.iter().map(sides).max().unwrap_or(1)
    }

    /// Median depth of the scene in its views, world units.
    pub fn depth(&self) -> f64 {
        self.depth
    }

    /// The training view most similar to this camera: the one with the least sum of the distance
    /// between the points at the scene's depth in the middle of both pictures and the distance
    /// between the cameras.
    pub fn nearest(&self, camera: &Camera) -> &str {
        let middle = |camera: &Camera| camera.centre() + self.depth * camera.forward();
        let apart = |other: &Camera| {
            middle(other).distance(middle(camera)) + other.centre().distance(camera.centre())
        };
        let mut views: Vec<_> = self.training().collect();
        views.sort_by(|(_, a), (_, b)| apart(a).total_cmp(&apart(b)));
        views.first().map_or("", |(name, _)| name)
    }
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, EvaluationError> {
    let bytes = std::fs::read(path).map_err(|error| EvaluationError::run(path, error))?;
    serde_json::from_slice(&bytes).map_err(|error| EvaluationError::run(path, error))
}
