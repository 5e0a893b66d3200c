//! Evaluation of runs against sharp photographs not used in training: the measure behind every
//! claim about quality.
//!
//! The photographs come with their own poses. The training cameras have poses in both worlds, and
//! the similarity between these maps the other cameras into the run's world. There the scene is
//! rendered and compared twice: with the mapped camera, and with the camera registered to the sharp
//! photograph while the scene stays fixed. The second score judges the scene; the difference
//! between the two judges the poses.

mod elongated;
mod error;
mod lpips;
mod page;
pub mod report;
mod score;
mod seen;
mod subject;
pub mod suite;
mod truth;

use std::path::Path;

use fled_core::camera::Camera;
use fled_core::cancel::CancelToken;
use fled_core::device::Device;
use fled_core::image::Image;
use fled_core::mask::Mask;
use fled_core::metrics;
use fled_core::reconstruct::{Registration, TrainingView};
use fled_core::render::{Renderer, UploadedGaussians};

pub use error::EvaluationError;
pub use lpips::Lpips;
pub use page::{csv, table, write};
pub use subject::Subject;
pub use truth::Truth;

use report::{Evaluation, TestView, ViewScores};
use seen::Witnesses;
use truth::{Placed, TruthView};

/// Largest movement of a camera at which registration stops, px.
const SETTLED_PX: f64 = 0.05;
/// Most repetitions of registration. One moves a camera by up to 4 px.
const REGISTRATIONS: usize = 3;

/// The inputs of an evaluation.
pub struct Request<'a> {
    /// The run.
    pub subject: &'a Subject,
    /// The sharp photographs.
    pub truth: &'a Truth,
    /// The run whose scene decides which pixels two training views see; usually the judged run
    /// itself.
    pub seen_from: &'a Subject,
    /// Folder of masks named like the test views, white where they are scored; `None` scores
    /// everything.
    pub masks: Option<&'a Path>,
    /// Whether test views are restricted to those between two training views in the order of names.
    pub inside: bool,
    pub device: &'a Device,
    /// The network of LPIPS.
    pub lpips: Option<&'a mut Lpips>,
    pub cancel: &'a CancelToken,
}

/// The scores, and the pictures that they compare.
pub struct Judged {
    pub evaluation: Evaluation,
    /// Pictures of every test view, in the same order.
    pub pictures: Vec<Pictures>,
}

/// The pictures of a test view.
pub struct Pictures {
    /// The render from the registered camera.
    pub render: Image,
    /// The sharp photograph.
    pub truth: Image,
}

/// Judges a run.
///
/// # Errors
/// [`EvaluationError`]: run and truth share too few views, no test view is left, a photograph
/// cannot be read, or a device error.
pub fn evaluate(request: Request<'_>) -> Result<Judged, EvaluationError> {
    let Request { subject, truth, .. } = request;
    let tie = truth.tie(subject)?;
    let names = truth.test_views(subject, request.inside);
    if names.is_empty() {
        return Err(EvaluationError::NoTestViews);
    }
    let placed = truth.placed(&names, subject, &tie)?;
    let loaded = placed.iter().map(|placed| placed.load(subject.size()));
    let views = loaded.collect::<Result<Vec<_>, _>>()?;
    let renderer = Renderer::new(request.device);
    let scene = renderer.upload(&subject.gaussians)?;
    let registered = register(&request, &renderer, &scene, &views)?;
    let seen = seen_masks(&request, &names, &renderer)?;
    let scored = scored_masks(&request, &placed, &views)?;
    let mut judge = Judge { renderer: &renderer, scene: &scene, lpips: request.lpips };
    let (mut rows, mut pictures) = (Vec::new(), Vec::new());
    let masks = scored.iter().zip(&seen);
    for ((view, camera), (scored, seen)) in views.into_iter().zip(&registered).zip(masks) {
        request.cancel.check()?;
        let (mapped, _) = judge.scores(&view, &view.camera, scored, seen)?;
        let (scores, render) = judge.scores(&view, camera, scored, seen)?;
        rows.push(TestView {
            nearest: subject.nearest(camera).to_owned(),
            seen: seen.share(),
            moved_px: moved_px(&view.camera, camera, subject.depth()),
            mapped,
            registered: scores,
            name: view.name,
        });
        let truth = view.photograph;
        pictures.push(Pictures { render, truth });
    }
    let mean_of = |scores: fn(&TestView) -> &ViewScores| {
        let all: Vec<&ViewScores> = rows.iter().map(scores).collect();
        score::mean(&all)
    };
    let evaluation = Evaluation {
        training_views: subject.training().count(),
        tied_views: tie.views,
        camera_error: tie.error,
        gaussians: subject.gaussians.len(),
        elongated: elongated::count(subject),
        size: subject.size(),
        adapter: request.device.to_string(),
        lpips_network: judge.lpips.map(|lpips| lpips.checksum().to_owned()),
        mapped: mean_of(|row| &row.mapped),
        registered: mean_of(|row| &row.registered),
        views: rows,
    };
    Ok(Judged { evaluation, pictures })
}

/// Renders and scores test views.
struct Judge<'a> {
    renderer: &'a Renderer,
    scene: &'a UploadedGaussians,
    lpips: Option<&'a mut Lpips>,
}

impl Judge<'_> {
    /// The scores of a view through this camera, and its render.
    fn scores(
        &mut self,
        view: &TruthView,
        camera: &Camera,
        scored: &Mask,
        seen: &Mask,
    ) -> Result<(ViewScores, Image), EvaluationError> {
        let render = self.renderer.render_scene(self.scene, camera)?;
        let truth = &view.photograph;
        let scores = score::scores(&render, truth, scored, seen);
        let mut scores =
            scores.ok_or_else(|| EvaluationError::NothingScored { view: view.name.clone() })?;
        if let Some(lpips) = &mut self.lpips {
            // Pixels that are not scored are replaced by the truth.
            let image = scored.composite(&render, truth);
            scores.all.lpips_squeeze = lpips.distance(&image, truth)?;
        }
        Ok((scores, render))
    }
}

/// The cameras of the views, corrected until render and sharp photograph agree best.
fn register(
    request: &Request<'_>,
    renderer: &Renderer,
    scene: &UploadedGaussians,
    views: &[TruthView],
) -> Result<Vec<Camera>, EvaluationError> {
    let subject = request.subject;
    let mut cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    for _ in 0..REGISTRATIONS {
        let mut photographs = Vec::new();
        for (view, camera) in views.iter().zip(&cameras) {
            let render = renderer.render_scene(scene, camera)?;
            // Match the tone of the scene: a difference in tone is not motion.
            let fit = metrics::ColourFit::between(&view.photograph, &render);
            photographs.push(TrainingView {
                name: view.name.clone(),
                camera: *camera,
                image: fit.apply(&view.photograph),
                mask: None,
                noise: None,
                has_kernel: false,
            });
        }
        let registration =
            Registration::new(request.device, &photographs, &subject.gaussians, None)?;
        let moved = registration.cameras(subject.depth(), request.cancel)?;
        let steps = cameras.iter().zip(&moved);
        let furthest = steps
            .map(|(before, after)| moved_px(before, after, subject.depth()))
            .fold(0.0, f64::max);
        cameras = moved;
        if furthest <= SETTLED_PX {
            break;
        }
    }
    Ok(cameras)
}

/// The scored pixels of each test view.
fn scored_masks(
    request: &Request<'_>,
    placed: &[Placed<'_>],
    views: &[TruthView],
) -> Result<Vec<Mask>, EvaluationError> {
    let mask = |(placed, view): (&Placed<'_>, &TruthView)| match request.masks {
        Some(folder) => placed.mask(folder, request.subject.size()),
        None => Ok(Mask::full(view.photograph.width(), view.photograph.height())),
    };
    placed.iter().zip(views).map(mask).collect()
}

/// For each test view, the pixels that at least two training views of `seen_from` see.
fn seen_masks(
    request: &Request<'_>,
    names: &[&str],
    renderer: &Renderer,
) -> Result<Vec<Mask>, EvaluationError> {
    let from = request.seen_from;
    let tie = request.truth.tie(from)?;
    let witnesses = Witnesses::new(renderer, from)?;
    let placed = request.truth.placed(names, from, &tie)?;
    let cameras = placed.iter().map(|placed| placed.camera(request.subject.size()));
    cameras.map(|camera| witnesses.mask(renderer, &camera)).collect()
}

/// Distance by which a point at `depth` in the middle of a camera's picture moves to that of
/// another, px; at most the picture's diagonal.
fn moved_px(before: &Camera, after: &Camera, depth: f64) -> f64 {
    let k = &before.intrinsics;
    let diagonal = (k.width as f64).hypot(k.height as f64);
    let point = before.centre() + depth * before.forward();
    let ends = before.project(point).zip(after.project(point));
    ends.map_or(diagonal, |((from, _), (to, _))| (to - from).length().min(diagonal))
}

#[cfg(test)]
mod tests;
