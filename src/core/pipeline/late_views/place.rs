//! Places photographs by key points that they share with renders of a scene.

use std::collections::BTreeMap;
use std::path::PathBuf;

use glam::DVec2;

use super::finished_round::FinishedRound;
use crate::camera::{Camera, Split};
use crate::capture::CaptureView;
use crate::colmap::brightened;
use crate::event::Stage;
use crate::image::{EncodeFormat, Image};
use crate::mask::Mask;
use crate::photo_path::PhotoPath;
use crate::pipeline::config::Options;
use crate::pipeline::context::{Advance, Context};
use crate::pipeline::error::PipelineError;
use crate::pipeline::pictures;
use crate::pipeline::views::{self, View};
use crate::poses::matching::{Correspondences, Matching, Pairs};
use crate::poses::pnp::{Sighting, meeting, resect};
use crate::poses::{Lens, PosedView};

/// Largest distance between a sighting and the projection of its point, px of an image whose longer
/// side is 560: a key point of a shaken photograph lies anywhere along its path.
const NEAR_PX: f64 = 6.0;

/// Least number of agreeing sightings that place a photograph.
const MIN_AGREEING: usize = 20;

/// Most renders that a photograph is compared with, spread over the capture.
const MAX_RENDERS: usize = 60;

/// The scene by which photographs are placed.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    pub finished: &'a FinishedRound<'a>,
    /// The names of views with doubtful poses, whose renders are not used.
    pub leaving: &'a [String],
    pub options: &'a Options,
}

/// A photograph with a place.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The pose, with the camera at the original's size.
    pub posed: PosedView,
    /// The owner's path of the photograph.
    pub path: PhotoPath,
    /// The camera at working size.
    pub camera: Camera,
    /// The photograph at the round's brightness and working size.
    pub image: Image,
    /// The pixels of it that count.
    pub mask: Option<Mask>,
    /// Key points shared with renders.
    pub matches: usize,
    /// Matches that agree with the place.
    pub agreeing: usize,
    /// Their root mean square error, px of the working size.
    pub error_px: f64,
}

/// By key point of a photograph, the renders that show it, and where.
type Seen<'a> = BTreeMap<u32, Vec<(&'a Camera, DVec2)>>;

/// A photograph to place, with the lens of another one.
struct Query {
    posed: PosedView,
    view: View,
}

/// Places as many of the photographs as possible.
///
/// # Errors
/// As [`super::late_views`].
pub fn place(
    context: &mut Context<'_>,
    scene: &Scene<'_>,
    matching: &dyn Matching,
    photographs: &[&CaptureView],
) -> Result<Vec<Placed>, PipelineError> {
    let mut queries = Vec::new();
    for photograph in photographs {
        context.cancel.check()?;
        match scene.query(photograph)? {
            Some(query) => queries.push(query),
            None => context.sink.log(format!(
                "late view {}: no photograph of its size has a pose",
                photograph.path
            )),
        }
    }
    let references = scene.references(queries.len());
    if queries.is_empty() || references.is_empty() {
        return Ok(Vec::new());
    }
    let pictures = scene.pictures(context, &queries, &references)?;
    let (number, cancel) = (scene.finished.round.number, context.cancel);
    let mut advance = |done, total| {
        let per_second = None;
        context.advance(Stage::Poses, number, Advance { done, total, per_second });
    };
    let pairs = Pairs::Across(queries.len());
    let mut found = match matching.matches(&pictures, pairs, None, &mut advance, cancel) {
        Ok(found) => found,
        Err(error) if error.is_about_the_tool() => {
            let message = format!("photographs without a pose cannot be placed: {error}");
            context.sink.warn("matcher_failed", message);
            return Ok(Vec::new());
        }
        Err(error) => return Err(error.into()),
    };
    let is_masked =
        |query: &Query, point| query.view.mask.as_ref().is_some_and(|mask| !mask.holds_at(point));
    found.retain(|at, point| !queries.get(at).is_some_and(|query| is_masked(query, point)));
    let sightings = scene.sightings(&found, queries.len(), &references);
    let mut placed = Vec::new();
    for (query, sightings) in queries.into_iter().zip(&sightings) {
        cancel.check()?;
        placed.extend(scene.resect(context, query, sightings));
    }
    Ok(placed)
}

impl Scene<'_> {
    /// The photograph undistorted with the lens of a posed one of the same size, of the most
    /// similar focal length if EXIF records one.
    fn query(&self, photograph: &CaptureView) -> Result<Option<Query>, PipelineError> {
        let focal_of = |posed: &PosedView| {
            let views = &self.finished.capture.views;
            views.iter().find(|view| view.name == posed.name)?.focal_px
        };
        let unlike = |posed: &&PosedView| match (photograph.focal_px, focal_of(posed)) {
            (Some(wanted), Some(focal)) => (wanted / focal).ln().abs(),
            _ => f64::INFINITY,
        };
        let fits = |posed: &&PosedView| {
            let Lens { intrinsics, .. } = posed.lens;
            (intrinsics.width, intrinsics.height) == (photograph.width, photograph.height)
        };
        let same_size = self.finished.poses.views.iter().filter(fits);
        let Some(other) = same_size.min_by(|a, b| unlike(a).total_cmp(&unlike(b))) else {
            return Ok(None);
        };
        let posed = PosedView { name: photograph.name.clone(), ..other.clone() };
        let size = self.options.longest_side() as usize;
        let view = views::view(photograph, &posed, Split::Train, size)?;
        Ok(Some(Query { posed, view }))
    }

    /// Indices of the views whose renders are matched with each of that many photographs.
    fn references(&self, photographs: usize) -> Vec<usize> {
        let all: Vec<usize> = (0..self.finished.views.len())
            .filter(|&index| !self.leaving.contains(&self.finished.views[index].name))
            .collect();
        // As many pairs as among sixty photographs, but at least eight renders per photograph.
        let most = (1800 / photographs.max(1)).clamp(8, MAX_RENDERS).min(all.len());
        (0..most).map(|index| all[index * all.len() / most]).collect()
    }

    /// Writes photographs and renders as files, at the brightness that suits the networks.
    fn pictures(
        &self,
        context: &Context<'_>,
        queries: &[Query],
        references: &[usize],
    ) -> Result<Vec<PathBuf>, PipelineError> {
        let folder = context.workspace.folder().work().late_views();
        let write = |file: String, image: &Image, mask: Option<&Mask>| {
            context.cancel.check()?;
            let path = folder.join(file);
            pictures::write(context.workspace, &path, &brightened(image, mask), EncodeFormat::Png)?;
            Ok(path)
        };
        let dark = queries.iter().map(|Query { view, .. }| {
            write(format!("{}.png", view.name), &view.dark, view.mask.as_ref())
        });
        let renders = references.iter().map(|&index| {
            let file = format!("{}.render.png", self.finished.views[index].name);
            write(file, &self.finished.renders[index], None)
        });
        dark.chain(renders).collect()
    }

    /// For each photograph, its key points that at least two renders show, at the positions where
    /// these see them.
    fn sightings(
        &self,
        found: &Correspondences,
        queries: usize,
        references: &[usize],
    ) -> Vec<Vec<Sighting>> {
        let mut seen: Vec<Seen<'_>> = vec![BTreeMap::new(); queries];
        for pair in &found.pairs {
            let camera = &self.finished.views[references[pair.second - queries]].camera;
            for &[query, render] in &pair.matches {
                let at = pixel(found, pair.second, render);
                seen[pair.first].entry(query).or_default().push((camera, at));
            }
        }
        let near = near_px(self.finished.views);
        let of = |(query, seen): (usize, &Seen<'_>)| {
            let sighting = |(&point, rays): (&u32, &Vec<_>)| {
                Some(Sighting { pixel: pixel(found, query, point), point: meeting(rays, near)? })
            };
            seen.iter().filter_map(sighting).collect()
        };
        seen.iter().enumerate().map(of).collect()
    }

    /// Resects the photograph at the place on which most sightings agree.
    fn resect(
        &self,
        context: &mut Context<'_>,
        query: Query,
        sightings: &[Sighting],
    ) -> Option<Placed> {
        let Query { posed, view } = query;
        let k = view.camera.intrinsics;
        let near = near_px(self.finished.views);
        let found = resect(&k, sightings, near, self.options.seed);
        let agreeing = found.as_ref().map_or(0, |found| found.inliers.len());
        let Some(found) = found.filter(|_| agreeing >= MIN_AGREEING) else {
            context.sink.log(format!(
                "late view {}: {agreeing} of {} points that renders show agree, too few",
                view.path,
                sightings.len()
            ));
            return None;
        };
        let tone = self.finished.round.tone.scene();
        let camera = Camera { world_to_camera: found.camera.world_to_camera, ..posed.camera };
        Some(Placed {
            posed: PosedView { camera, ..posed },
            path: view.path,
            camera: found.camera,
            image: tone.apply(&view.dark),
            mask: view.mask,
            matches: sightings.len(),
            agreeing,
            error_px: found.rms_px,
        })
    }
}

/// Position of a key point in its picture.
fn pixel(found: &Correspondences, picture: usize, point: u32) -> DVec2 {
    let [x, y] = found.key_points[picture][point as usize];
    DVec2::new(x.into(), y.into())
}

/// [`NEAR_PX`] at the size of the views.
fn near_px(views: &[View]) -> f64 {
    let side = |view: &View| view.dark.width().max(view.dark.height());
    NEAR_PX * views.iter().map(side).max().unwrap_or(0) as f64 / 560.0
}
