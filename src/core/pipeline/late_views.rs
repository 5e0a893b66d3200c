//! Views that join or leave the scene once there is one to compare them with: late views.
//!
//! Structure from motion needs what two shaken photographs have in common. A scene is sharp and
//! seen from everywhere: a photograph that could not be placed among the others may be placed by
//! renders of it. And a view that stands where it does not belong does not look like its render.

mod place;

use super::context::Context;
use super::dependencies::Dependencies;
use super::error::PipelineError;
use super::evaluate::likenesses;
use super::poses::publish;
use super::reconstruct::TrainedScene;
use super::round::Round;
use super::tools::Tools;
use super::views::{self, View};
use crate::camera::Split;
use crate::capture::{Capture, CaptureView};
use crate::event::Stage;
use crate::image::Image;
use crate::metrics::RoundMetrics;
use crate::poses::{PoseStatus, PosedView, Poses};
use crate::render::Renderer;
use place::{Placed, Scene, place};

/// A view belongs to the scene from this share of the middle fit on. Of 12 views of castle, shaken
/// by 4.4 px, 11 have fits of 0.91 to 0.96, and one that stands 8 degrees off has 0.39, though it
/// was trained on; four that the scene placed have 0.56 to 0.86.
const BELONGS_FROM: f64 = 0.5;

/// A finished round, and what it was made from.
#[derive(Clone, Copy)]
pub struct FinishedRound<'a> {
    /// All photographs.
    pub capture: &'a Capture,
    /// Where they were found.
    pub poses: &'a Poses,
    /// The round.
    pub round: &'a Round,
    /// Those with a pose, where the round's training left them.
    pub views: &'a [View],
    /// R_i.
    pub renders: &'a [Image],
    /// V_i.
    pub scene: &'a TrainedScene,
    /// How each view fits its render.
    pub metrics: &'a RoundMetrics,
}

/// What the round's scene says about poses: those of the next rounds, where they are others.
///
/// # Errors
/// [`PipelineError::Photograph`], [`PipelineError::Render`], [`PipelineError::Poses`],
/// [`PipelineError::Io`], [`PipelineError::Cancelled`].
pub fn late_views(
    context: &mut Context<'_>,
    tools: &Tools<'_>,
    finished: &FinishedRound<'_>,
    depends_on: &Dependencies,
) -> Result<Option<Poses>, PipelineError> {
    let fitted = with_fits(finished.poses, finished.metrics);
    publish(context.workspace, &fitted)?;
    let leaving = leaving(finished);
    let without_pose = views::unregistered(finished.capture, finished.poses);
    let looked_for: Vec<&CaptureView> = finished
        .capture
        .views
        .iter()
        .filter(|view| without_pose.contains(&view.name) || leaving.contains(&view.name))
        .collect();
    if looked_for.is_empty() || (leaving.is_empty() && tools.matching.is_none()) {
        return Ok(None);
    }
    let number = finished.round.number;
    let path = context.workspace.folder().round(number).late_views();
    let poses: Poses = context.once(
        Stage::Poses,
        number,
        depends_on,
        |workspace| workspace.read_json(&path),
        |context| {
            let placed = find(context, tools, finished, &looked_for, &leaving, depends_on)?;
            let poses = changed(&fitted, finished.capture, &leaving, placed);
            context.workspace.write_json(&path, &poses)?;
            Ok(poses)
        },
    )?;
    tell(context, &poses, &leaving);
    publish(context.workspace, &poses)?;
    let stay_away = leaving.is_empty() && poses.views.len() == finished.poses.views.len();
    Ok((!stay_away).then_some(poses))
}

/// The names of the views that train and do not fit. Those held out stay: without the worst of them
/// every score would be better.
fn leaving(finished: &FinishedRound<'_>) -> Vec<String> {
    let rows = || {
        let rows = finished.metrics.views.iter();
        rows.filter(|row| row.split == Some(Split::Train))
            .filter_map(|row| Some((row, row.fit?)))
    };
    let Some(middle) = middle(rows().map(|(_, fit)| fit)) else {
        return Vec::new();
    };
    let mut leaving: Vec<(f64, &str)> = rows()
        .filter(|(_, fit)| *fit < BELONGS_FROM * middle)
        .map(|(row, fit)| (fit, &*row.name))
        .collect();
    // The worst first, and never so many that there is no scene.
    leaving.sort_by(|a, b| a.0.total_cmp(&b.0));
    leaving.truncate(rows().count().saturating_sub(views::LEAST_VIEWS));
    leaving
        .into_iter()
        .map(|(_, name)| name.to_owned())
        .collect()
}

fn middle(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Those of the photographs that the scene places, and that fit it there.
fn find(
    context: &mut Context<'_>,
    tools: &Tools<'_>,
    finished: &FinishedRound<'_>,
    looked_for: &[&CaptureView],
    leaving: &[String],
    depends_on: &Dependencies,
) -> Result<Vec<(Placed, f64)>, PipelineError> {
    let Some(matching) = tools.matching else {
        return Ok(Vec::new());
    };
    let scene = Scene {
        finished,
        leaving,
        options: depends_on.options(),
    };
    let placed = place(context, &scene, matching, looked_for)?;
    let renderer = Renderer::new(tools.gpu);
    let uploaded = renderer.upload(&finished.scene.gaussians)?;
    let renders = placed
        .iter()
        .map(|placed| renderer.render_scene(&uploaded, &placed.camera))
        .collect::<Result<Vec<_>, _>>()?;
    let images: Vec<Image> = placed.iter().map(|placed| placed.image.clone()).collect();
    let likenesses = likenesses(&renders, &images, &finished.round.response);
    let stayed = finished.metrics.views.iter();
    let stayed = stayed.filter(|row| !leaving.contains(&row.name));
    let fits = stayed.filter_map(|row| row.fit);
    let least = BELONGS_FROM * middle(fits).unwrap_or(1.0);
    let mut found = Vec::new();
    for (placed, likeness) in placed.into_iter().zip(likenesses) {
        let joins = likeness.fit >= least;
        context.sink.log(format!(
            "late view {}: {} of {} points that renders show agree, {:.1} px off, fit {:.2}, {}",
            placed.posed.name,
            placed.agreeing,
            placed.matches,
            placed.error_px,
            likeness.fit,
            if joins {
                "joins".to_owned()
            } else {
                format!("below {least:.2}: stays away")
            }
        ));
        if joins {
            found.push((placed, likeness.fit));
        }
    }
    Ok(found)
}

/// The poses with how each view fitted its render.
fn with_fits(poses: &Poses, metrics: &RoundMetrics) -> Poses {
    let mut poses = poses.clone();
    for row in metrics.views.iter().filter(|row| row.fit.is_some()) {
        poses.verdict_of(&row.name).fit = row.fit;
    }
    poses
}

/// The poses after some views left and others joined, in the capture's order.
fn changed(
    poses: &Poses,
    capture: &Capture,
    leaving: &[String],
    placed: Vec<(Placed, f64)>,
) -> Poses {
    let mut poses = poses.clone();
    poses.views.retain(|view| !leaving.contains(&view.name));
    for name in leaving {
        poses.verdict_of(name).status = PoseStatus::TakenOut;
    }
    for (placed, fit) in placed {
        let verdict = poses.verdict_of(&placed.posed.name);
        verdict.status = PoseStatus::Late;
        verdict.matches = placed.matches;
        verdict.fitting = placed.agreeing;
        verdict.error_px = Some(placed.error_px);
        verdict.fit = Some(fit);
        poses.views.push(placed.posed);
    }
    let place = |posed: &PosedView| {
        capture
            .views
            .iter()
            .position(|view| view.name == posed.name)
    };
    poses.views.sort_by_key(place);
    poses.registered = poses.views.len();
    poses
}

fn tell(context: &mut Context<'_>, poses: &Poses, leaving: &[String]) {
    let of = |status: PoseStatus| -> Vec<&str> {
        let verdicts = poses.verdicts.iter();
        let those = verdicts.filter(|verdict| verdict.status == status);
        those.map(|verdict| &*verdict.name).collect()
    };
    let out: Vec<&str> = of(PoseStatus::TakenOut)
        .into_iter()
        .filter(|name| leaving.iter().any(|leaving| leaving == name))
        .collect();
    if !out.is_empty() {
        let message = format!(
            "{} of {} photographs fit the scene far worse than the others and are taken out: {}; \
             their poses are wrong, or something moved before them",
            out.len(),
            poses.total,
            out.join(", ")
        );
        context.sink.warn("views_taken_out", message);
    }
    let late = of(PoseStatus::Late);
    if !late.is_empty() {
        let message = format!(
            "placed by the scene, for the next round: {}",
            late.join(", ")
        );
        context.sink.log(message);
    }
}

/// The views of the next rounds: those that stay, where they are, and those that join.
///
/// # Errors
/// [`PipelineError::Photograph`], [`PipelineError::Io`].
pub fn changed_views(
    context: &Context<'_>,
    finished: &FinishedRound<'_>,
    poses: &Poses,
    size: usize,
) -> Result<Vec<View>, PipelineError> {
    let capture = finished.capture;
    let mut views = Vec::with_capacity(poses.views.len());
    for posed in &poses.views {
        let before = finished.views.iter().find(|view| view.name == posed.name);
        let was_late = |view: &&View| !poses.is_late(&view.name) || view.is_late;
        if let Some(view) = before.filter(was_late) {
            views.push(view.clone());
            continue;
        }
        let photograph = capture.views.iter().find(|view| view.name == posed.name);
        let Some(photograph) = photograph else {
            continue;
        };
        let view = View {
            is_late: true,
            ..views::view(photograph, posed, Split::Train, size)?
        };
        views::show(context.workspace, &view)?;
        views.push(view);
    }
    Ok(views)
}
