//! Poses that came with a capture, as a source of poses.

mod frusta;

use std::path::Path;
use std::time::Instant;

use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::capture::{CapturePoses, GivenPosesFile, Placement};
use crate::dataset::PlacedPoses;
use crate::event::ProgressSink;
use crate::poses::left_out::in_words;
use crate::poses::{PoseRequest, PoseView, PosedView, Poses, PosesError, Sfm, SparsePoint};

/// Points guessed for poses without points: as many as the smallest preset's cap.
const GUESSED_POINTS: usize = 10_000;

/// Fewer triangulated points are not a scene.
const LEAST_POINTS: usize = 100;

/// Finds points for views with known poses, as `ColmapCli::triangulate` does.
pub type Triangulate = Box<
    dyn Fn(
        &PoseRequest<'_>,
        &[PosedView],
        &mut dyn ProgressSink,
        &CancelToken,
    ) -> Result<Vec<SparsePoint>, PosesError>,
>;

/// Finds better poses in the world of the given ones, as `ColmapCli::refine` does.
pub type Refine = Box<
    dyn Fn(
        &PoseRequest<'_>,
        &[PosedView],
        &mut dyn ProgressSink,
        &CancelToken,
    ) -> Result<Option<Poses>, PosesError>,
>;

/// Mean error of triangulated points, px of the pose copies, above which matches do not fit the
/// poses if most points have two views, the minimum for a point. On two real captures with correct
/// poses, bright and dark, 0.10 to 0.21 of the points have two and the error is 0.65 to 1.04; with
/// three views all have two, and it is 0.33 to 0.71. With inverted poses, x y z w for w x y z or a
/// principal point in the corner, 0.53 or more have two, and it is 1.24 or more.
const WORST_FIT: f64 = 1.15;

/// Poses that came with a capture, as an [`Sfm`].
pub struct GivenSfm {
    source: GivenPosesFile,
    placed: PlacedPoses,
    triangulate: Option<Triangulate>,
    refine: Option<Refine>,
}

impl GivenSfm {
    /// # Errors
    /// [`PosesError::File`] for poses that could not be read.
    pub fn new(given: &CapturePoses) -> Result<Self, PosesError> {
        let placed = match &given.placement {
            Placement::Placed(placed) => placed.clone(),
            Placement::Unusable { file, reason } => {
                return Err(PosesError::bad_file(Path::new(file), reason));
            }
        };
        Ok(Self { source: given.file.clone(), placed, triangulate: None, refine: None })
    }

    /// Sets the callback that triangulates points for poses without points.
    #[must_use]
    pub fn triangulated_by(self, triangulate: Triangulate) -> Self {
        Self { triangulate: Some(triangulate), ..self }
    }

    /// Sets the callback that refines the poses of a `transforms.json`, which phones write during
    /// the walk; the other formats come from a bundle adjustment.
    #[must_use]
    pub fn refined_by(self, refine: Refine) -> Self {
        let is_rough = matches!(self.source, GivenPosesFile::Transforms(_));
        Self { refine: Some(refine).filter(|_| is_rough), ..self }
    }

    /// Refined poses; `None` if the given ones are used as they are.
    fn refined(
        &self,
        request: &PoseRequest<'_>,
        views: &[PosedView],
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Poses>, PosesError> {
        let Some(refine) = &self.refine else {
            return Ok(None);
        };
        // Pass the given lenses in place of EXIF's.
        let focal = |view: &PoseView| {
            let given = views.iter().find(|given| given.name == view.name);
            given.map(|given| given.lens.intrinsics.fx)
        };
        let known = request
            .views
            .iter()
            .map(|view| PoseView { focal_px: focal(view).or(view.focal_px), ..view.clone() });
        let known: Vec<PoseView> = known.collect();
        let request = PoseRequest { views: &known, ..*request };
        match refine(&request, views, sink, cancel) {
            Err(PosesError::Cancelled(cancelled)) => Err(cancelled.into()),
            Err(error) => {
                let message = format!("the given poses are taken as they are: {error}");
                sink.warn("poses_unrefined", message);
                Ok(None)
            }
            refined => refined,
        }
    }

    /// Triangulated points, or why there are none.
    fn triangulated(
        &self,
        request: &PoseRequest<'_>,
        views: &[PosedView],
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Result<Vec<SparsePoint>, String>, PosesError> {
        let Some(triangulate) = &self.triangulate else {
            return Ok(Err("and nothing here can triangulate them".to_owned()));
        };
        match triangulate(request, views, sink, cancel) {
            Ok(points) if points.len() >= LEAST_POINTS => Ok(Ok(points)),
            Ok(points) => Ok(Err(format!(
                "and only {} could be triangulated, as where axes or focal lengths are other than \
                 the format has them",
                points.len()
            ))),
            Err(PosesError::Cancelled(cancelled)) => Err(cancelled.into()),
            Err(error) => Ok(Err(format!("and triangulation failed ({error})"))),
        }
    }

    /// Triangulated points, or guessed ones if there are none. `near` contains the poses in their
    /// normalised world; `bounds` and the points are in the given world.
    fn found_points(
        &self,
        request: &PoseRequest<'_>,
        near: Poses,
        bounds: &[Option<(f64, f64)>],
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Vec<SparsePoint>, PosesError> {
        let points = match self.triangulated(request, &near.views, sink, cancel)? {
            Ok(points) => {
                if let Some(doubt) = doubt_of_fit(&points) {
                    sink.warn("poses_unlikely", format!("{}: {doubt}", self.placed.file));
                }
                points
            }
            Err(reason) => {
                let cameras: Vec<Camera> = near.views.iter().map(|view| view.camera).collect();
                let scale = near.normalisation.scale;
                let scaled = |both: &Option<(f64, f64)>| both.map(|(a, b)| (scale * a, scale * b));
                let bounds: Vec<_> = bounds.iter().map(scaled).collect();
                let points = frusta::guess(&cameras, &bounds, GUESSED_POINTS, request.seed);
                let message = format!(
                    "the poses came without points, {reason}: {} random ones take their place",
                    points.len()
                );
                sink.warn("points_guessed", message);
                points
            }
        };
        Ok(Poses { points, ..near }.in_world().points)
    }

    /// The error when too few photographs have a pose.
    fn too_few(&self, total: usize) -> PosesError {
        let PlacedPoses { file, left_out, unlike_names, views, .. } = &self.placed;
        let registered = views.len();
        if !left_out.is_empty() {
            let reason = format!(
                "{registered} of {total} photographs have a pose that can be used: {}",
                in_words(left_out)
            );
            return PosesError::bad_file(Path::new(file), reason);
        }
        let example = unlike_names.as_ref().map(|example| format!("; {example}"));
        let advice = format!(
            "the names in {file} must be those of the photographs{}",
            example.unwrap_or_default()
        );
        PosesError::TooFew { registered, total, advice }
    }
}

impl Sfm for GivenSfm {
    fn poses(
        &self,
        request: &PoseRequest<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError> {
        let start = Instant::now();
        let PlacedPoses { views, held_out, points, mean_error, mean_track, .. } = &self.placed;
        for warning in &self.placed.warnings {
            sink.warn(&warning.code, warning.message.clone());
        }
        if self.placed.turned > 0 {
            sink.log(format!(
                "poses: {} photographs are turned upright by EXIF, and their given poses with them",
                self.placed.turned
            ));
        }
        let total = request.views.len();
        let registered = views.len();
        if registered < 3 {
            return Err(self.too_few(total));
        }
        // Far from the origin COLMAP also loses precision.
        let near = Poses { views: views.clone(), ..Poses::default() };
        let near = near.normalised();
        let held_out = held_out.clone();
        if let Some(poses) = self.refined(request, &near.views, sink, cancel)? {
            let poses = Poses { normalisation: near.normalisation, held_out, ..poses };
            return Ok(poses.in_world());
        }
        let points = match points.is_empty() {
            true => self.found_points(request, near, &self.placed.depths, sink, cancel)?,
            false => points.clone(),
        };
        Ok(Poses {
            views: views.clone(),
            points,
            registered,
            total,
            source: self.describe(),
            held_out,
            mean_reprojection_error: *mean_error,
            mean_track: *mean_track,
            seconds: start.elapsed().as_secs_f64(),
            ..Poses::default()
        })
    }

    fn describe(&self) -> String {
        let format = match self.source {
            GivenPosesFile::ColmapModel(_) => "COLMAP model",
            GivenPosesFile::Transforms(_) => "transforms.json",
            GivenPosesFile::PosesBounds(_) => "poses_bounds.npy",
        };
        let points =
            if self.triangulate.is_some() { ", points triangulated where it has none" } else { "" };
        let refined = match self.refine {
            Some(_) => ", refined where the matches say otherwise",
            None => "",
        };
        format!("given {format}{refined}{points}")
    }
}

/// Doubts about the poses used for triangulation.
fn doubt_of_fit(points: &[SparsePoint]) -> Option<String> {
    let count = points.len();
    let of_two = points.iter().filter(|point| point.track <= 2).count();
    let error = points.iter().map(|point| point.error).sum::<f64>() / count as f64;
    (2 * of_two > count && error > WORST_FIT).then(|| {
        format!(
            "matches between the photographs fit the poses badly: {of_two} of {count} points are \
             seen by two photographs only, and they are off by {error:.1} px; are axes and focal \
             lengths those of the format, and the photographs those of the poses?"
        )
    })
}

#[cfg(test)]
mod tests;
