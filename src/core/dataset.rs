//! Poses supplied with a capture: a COLMAP model, NeRF's `transforms.json`, or LLFF's
//! `poses_bounds.npy`.

mod doubt;
mod frusta;
mod given_view;
mod placed;
mod read;
mod transforms;
mod upright;

pub(crate) use transforms::masks as masks_of_transforms;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use doubt::doubt_of_fit;
use given_view::GivenView;
use placed::Placed;

use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::event::ProgressSink;
use crate::photo_path::{PhotoPath, Tie, find_each};
use crate::poses::left_out::in_words;
use crate::poses::model::SparseModel;
use crate::poses::{
    LeftOut, PoseRequest, PoseView, PosedView, Poses, PosesError, Sfm, SparsePoint, name_of,
};

/// Width and height, px.
type Size = (usize, usize);

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

/// Poses from a file or directory, as an [`Sfm`].
pub struct GivenPoses {
    path: PathBuf,
    format: Format,
    photographs: Vec<PhotoPath>,
    triangulate: Option<Triangulate>,
    refine: Option<Refine>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Model,
    Transforms,
    PosesBounds,
}

/// Contents of a format besides the views.
#[derive(Default)]
struct Given {
    points: Vec<SparsePoint>,
    mean_error: Option<f64>,
    mean_track: Option<f64>,
    /// Unusable frames, by their names in the file.
    left_out: Vec<LeftOut>,
    warnings: Vec<String>,
}

/// How poses are matched to photographs; `None` for an unusable pose in the file.
enum Assignment {
    /// By photograph path.
    ByPath(Vec<(PhotoPath, Option<GivenView>)>),
    /// By Python's sort order of the paths.
    ByOrder(Vec<Option<GivenView>>),
}

impl GivenPoses {
    /// `path`: a directory with a COLMAP model (text or binary), a `.json` or a `.npy` file.
    /// `photographs`: all photographs of the capture, including unused ones, so that their poses go
    /// to no other photograph.
    ///
    /// # Errors
    /// [`PosesError::BadFile`] if it is none of these. [`Sfm::poses`] reads the content.
    pub fn open(path: &Path, photographs: &[PhotoPath]) -> Result<Self, PosesError> {
        let extension = path.extension().and_then(|extension| extension.to_str());
        let format = match extension.map(str::to_ascii_lowercase).as_deref() {
            _ if SparseModel::stands_in(path) => Format::Model,
            Some("json") => Format::Transforms,
            Some("npy") => Format::PosesBounds,
            _ => {
                let reason = "neither a COLMAP model, a transforms.json nor a poses_bounds.npy";
                return Err(PosesError::bad_file(path, reason));
            }
        };
        Ok(Self {
            path: path.to_owned(),
            format,
            photographs: photographs.to_vec(),
            triangulate: None,
            refine: None,
        })
    }

    /// Reads the file without keeping it, and returns how many photographs have a pose.
    ///
    /// # Errors
    /// The error with which [`Sfm::poses`] will fail.
    pub fn check(&self) -> Result<usize, PosesError> {
        let assigned = self.assign(self.read()?.0)?;
        Ok(assigned.iter().flatten().count())
    }

    /// The names of photographs in the file; empty for formats without names.
    ///
    /// # Errors
    /// Those of [`Self::check`].
    pub fn names(&self) -> Result<Vec<PhotoPath>, PosesError> {
        Ok(self.sizes()?.into_iter().map(|(name, _)| name).collect())
    }

    /// As [`Self::names`], with the picture size of each lens, px, if the file gives it.
    ///
    /// # Errors
    /// Those of [`Self::check`].
    pub fn sizes(&self) -> Result<Vec<(PhotoPath, Option<Size>)>, PosesError> {
        let size = |view: GivenView| view.lens.size();
        Ok(match self.read()?.0 {
            Assignment::ByPath(views) => {
                views.into_iter().map(|(name, view)| (name, view.and_then(size))).collect()
            }
            Assignment::ByOrder(_) => Vec::new(),
        })
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
        Self { refine: Some(refine).filter(|_| self.format == Format::Transforms), ..self }
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

    fn read(&self) -> Result<(Assignment, Given), PosesError> {
        match self.format {
            Format::Model => read::model(&self.path),
            Format::Transforms => read::transforms(&self.path),
            Format::PosesBounds => read::poses_bounds(&self.path),
        }
    }

    /// Warns about poses that are not used, or only after a change.
    fn warn(&self, given: &Given, placed: &Placed, sink: &mut dyn ProgressSink) {
        let file = self.label();
        if !given.left_out.is_empty() {
            let message = format!("{file}: left out are {}", in_words(&given.left_out));
            sink.warn("poses_left_out", message);
        }
        for message in &given.warnings {
            sink.warn("poses_mended", format!("{file}: {message}"));
        }
        if !placed.doubts.is_empty() {
            let message = format!("{file}: {}", in_words(&placed.doubts));
            sink.warn("poses_unlikely", message);
        }
        if !placed.turned.is_empty() {
            sink.log(format!(
                "poses: {} photographs are turned upright by EXIF, and their given poses with them",
                placed.turned.len()
            ));
        }
        if let Some(first) = placed.assumed.first() {
            let message = format!(
                "{file}: the poses of {} photographs, the first is {first}, are taken to be those \
                 of the pixels as they are stored, and are turned upright with them by EXIF; if \
                 the program that made them turned the photographs itself, give upright copies \
                 without EXIF orientation",
                placed.assumed.len()
            );
            sink.warn("poses_turned", message);
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
                    sink.warn("poses_unlikely", format!("{}: {doubt}", self.label()));
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

    /// The file's name for messages. A model from a zip or an upload is in one of our own folders.
    fn label(&self) -> std::borrow::Cow<'_, str> {
        let name = name_of(&self.path);
        match self.format {
            Format::Model if !name.starts_with("sparse") => "the COLMAP model".into(),
            _ => name,
        }
    }

    /// The error when too few photographs have a pose.
    fn too_few(&self, registered: usize, total: usize, given: &Given) -> PosesError {
        if !given.left_out.is_empty() {
            let reason = format!(
                "{registered} of {total} photographs have a pose that can be used: {}",
                in_words(&given.left_out)
            );
            return PosesError::bad_file(Path::new(&*self.label()), reason);
        }
        let advice = format!(
            "the names in {} must be those of the photographs{}",
            self.label(),
            self.unlike_names().unwrap_or_default()
        );
        PosesError::TooFew { registered, total, advice }
    }

    /// An example of a name in the file and the name of a photograph, for a mismatch.
    fn unlike_names(&self) -> Option<String> {
        let names = self.names().ok()?;
        let name = { names.iter() }.find(|name| !self.photographs.contains(name))?;
        let photograph = self.photographs.first()?;
        Some(format!("; it has `{name}`, and a photograph is called `{photograph}`"))
    }

    /// The pose of each photograph of the capture, if it has one.
    fn assign(&self, given: Assignment) -> Result<Vec<Option<GivenView>>, PosesError> {
        match given {
            Assignment::ByPath(mut views) => {
                // A duplicated frame adds nothing; a frame in two splits trains.
                views.sort_by(|a, b| a.0.cmp(&b.0));
                views.dedup_by(|again, first| {
                    let is_same = again.0 == first.0 && trained(again.1) == trained(first.1);
                    if let (true, Some(first), Some(again)) = (is_same, &mut first.1, again.1) {
                        first.held_out &= again.held_out;
                    }
                    is_same
                });
                let (names, views): (Vec<_>, Vec<_>) = views.into_iter().unzip();
                let found = find_each(&names, &self.photographs);
                let label = self.label();
                let refused = |tie: Tie| PosesError::bad_file(Path::new(&*label), tie.to_string());
                let found = found.map_err(refused)?;
                Ok(found.into_iter().map(|at| views[at?]).collect())
            }
            Assignment::ByOrder(rows) => self.assign_by_order(rows),
        }
    }

    /// Rows belong to all original photographs, in byte order of their paths.
    fn assign_by_order(
        &self,
        rows: Vec<Option<GivenView>>,
    ) -> Result<Vec<Option<GivenView>>, PosesError> {
        let refused = |reason: String| Err(PosesError::bad_file(&self.path, reason));
        if rows.len() != self.photographs.len() {
            return refused(format!(
                "{} poses for {} photographs, and only their order tells which is whose: the rows \
                 must be those of all photographs, sorted by name",
                rows.len(),
                self.photographs.len()
            ));
        }
        let order = by_bytes(&self.photographs);
        if let Some(twice) =
            order.windows(2).find(|pair| self.photographs[pair[0]] == self.photographs[pair[1]])
        {
            let name = &self.photographs[twice[0]];
            return refused(format!("two photographs are called `{name}`, which have no order"));
        }
        let mut assigned = vec![None; rows.len()];
        for (at, row) in order.into_iter().zip(rows) {
            assigned[at] = row;
        }
        Ok(assigned)
    }

    /// Warns when a reader that sorts by number would assign rows to other photographs.
    fn warn_of_order(&self, sink: &mut dyn ProgressSink) {
        let order = by_bytes(&self.photographs);
        let differs = order.windows(2).find(|pair| pair[0] > pair[1]);
        if let (Format::PosesBounds, Some(pair)) = (self.format, differs) {
            let message = format!(
                "{}: its rows are taken for the photographs in the order of the letters of their \
                 names, as LLFF sorts them: {} before {}; number them with equally many digits \
                 if that is wrong",
                name_of(&self.path),
                self.photographs[pair[0]],
                self.photographs[pair[1]]
            );
            sink.warn("poses_order", message);
        }
    }
}

/// The view, marked for training.
fn trained(view: Option<GivenView>) -> Option<GivenView> {
    let held_out = false;
    view.map(|view| GivenView { held_out, ..view })
}

/// Indices of paths in Python's sort order.
fn by_bytes(paths: &[PhotoPath]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..paths.len()).collect();
    order.sort_by_key(|&at| &paths[at]);
    order
}

impl Sfm for GivenPoses {
    fn poses(
        &self,
        request: &PoseRequest<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError> {
        let start = Instant::now();
        let (assignment, mut given) = self.read()?;
        cancel.check()?;
        let assigned = self.assign(assignment)?;
        self.warn_of_order(sink);
        let all = self.photographs.iter().zip(&assigned);
        let of_photograph: HashMap<&PhotoPath, &GivenView> =
            { all }.filter_map(|(path, given)| Some((path, given.as_ref()?))).collect();
        let total = request.views.len();
        let placed = Placed::of(request.views, &of_photograph, &mut given)?;
        self.warn(&given, &placed, sink);
        let Placed { views, bounds, held_out, .. } = placed;
        let registered = views.len();
        if registered < 3 {
            return Err(self.too_few(registered, total, &given));
        }
        // Far from the origin COLMAP also loses precision.
        let near = Poses { views: views.clone(), ..Poses::default() };
        let near = near.normalised();
        if let Some(poses) = self.refined(request, &near.views, sink, cancel)? {
            let poses = Poses { normalisation: near.normalisation, held_out, ..poses };
            return Ok(poses.in_world());
        }
        let points = match given.points.is_empty() {
            true => self.found_points(request, near, &bounds, sink, cancel)?,
            false => given.points,
        };
        Ok(Poses {
            views,
            points,
            registered,
            total,
            source: self.describe(),
            held_out,
            mean_reprojection_error: given.mean_error,
            mean_track: given.mean_track,
            seconds: start.elapsed().as_secs_f64(),
            ..Poses::default()
        })
    }

    fn describe(&self) -> String {
        let what = match self.format {
            Format::Model => "COLMAP model",
            Format::Transforms => "transforms.json",
            Format::PosesBounds => "poses_bounds.npy",
        };
        let points =
            if self.triangulate.is_some() { ", points triangulated where it has none" } else { "" };
        let refined = match self.refine {
            Some(_) => ", refined where the matches say otherwise",
            None => "",
        };
        format!("given {what}{refined}{points}")
    }
}

#[cfg(test)]
mod tests;
