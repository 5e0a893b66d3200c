//! Poses that come with a capture: a COLMAP model, NeRF's `transforms.json`, or LLFF's
//! `poses_bounds.npy`.

mod frusta;
mod given_view;
mod transforms;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use given_view::GivenView;

use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::event::ProgressSink;
use crate::image::read_header;
use crate::photo_path::{PhotoPath, find_each};
use crate::poses::bounds::read_poses_bounds;
use crate::poses::model::SparseModel;
use crate::poses::{
    Distortion, Lens, PoseRequest, PoseView, PosedView, Poses, PosesError, Sfm, SparsePoint,
    name_of,
};

/// Points that are guessed where poses came without points: as many as the smallest preset's cap.
const GUESSED_POINTS: usize = 10_000;

/// Fewer triangulated points than this are no scene.
const LEAST_POINTS: usize = 100;

/// Finds points for views whose poses are known, as `ColmapCli::triangulate` does.
pub type Triangulate = Box<
    dyn Fn(
        &PoseRequest<'_>,
        &[PosedView],
        &mut dyn ProgressSink,
        &CancelToken,
    ) -> Result<Vec<SparsePoint>, PosesError>,
>;

/// Finds better poses in the world of given ones, as `ColmapCli::refine` does.
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

/// What a format holds.
struct Given {
    views: Assignment,
    points: Vec<SparsePoint>,
    mean_error: Option<f64>,
    mean_track: Option<f64>,
}

/// How poses find their photographs.
enum Assignment {
    /// By the photograph's path.
    ByPath(Vec<(PhotoPath, GivenView)>),
    /// By the order in which Python sorts the paths.
    ByOrder(Vec<GivenView>),
}

impl GivenPoses {
    /// `path`: a directory with a COLMAP model (text or binary), a `.json` or a `.npy` file.
    /// `photographs`: all of the capture, those too that are not used: theirs are no one else's
    /// poses.
    ///
    /// # Errors
    /// [`PosesError::BadFile`] when it is none of them. The content is read by [`Sfm::poses`].
    pub fn open(path: &Path, photographs: &[PhotoPath]) -> Result<Self, PosesError> {
        let format = match path.extension().and_then(|extension| extension.to_str()) {
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

    /// Reads the file and forgets it: whether [`Sfm::poses`] will be able to.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn check(&self) -> Result<(), PosesError> {
        self.assign(self.read()?.views).map(drop)
    }

    /// With somebody who finds points where the poses come without.
    #[must_use]
    pub fn triangulated_by(self, triangulate: Triangulate) -> Self {
        Self {
            triangulate: Some(triangulate),
            ..self
        }
    }

    /// With somebody who refines poses of a `transforms.json`, which phones write as they walk; the
    /// other formats come out of a bundle adjustment.
    #[must_use]
    pub fn refined_by(self, refine: Refine) -> Self {
        Self {
            refine: Some(refine).filter(|_| self.format == Format::Transforms),
            ..self
        }
    }

    /// Refined poses; `None` where the given ones are taken as they are.
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
        // The given lenses are what EXIF would tell.
        let focal = |view: &PoseView| {
            let given = views.iter().find(|given| given.name == view.name);
            given.map(|given| given.lens.intrinsics.fx)
        };
        let known = request.views.iter().map(|view| PoseView {
            focal_px: focal(view).or(view.focal_px),
            ..view.clone()
        });
        let known: Vec<PoseView> = known.collect();
        let request = PoseRequest {
            views: &known,
            ..*request
        };
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
                "and only {} could be triangulated",
                points.len()
            ))),
            Err(PosesError::Cancelled(cancelled)) => Err(cancelled.into()),
            Err(error) => Ok(Err(format!("and triangulation failed ({error})"))),
        }
    }

    /// Points for poses that came without, in their normalised world: triangulated ones or, where
    /// there are none, guessed ones. `bounds` are in the world that was given.
    fn found_points(
        &self,
        request: &PoseRequest<'_>,
        near: &Poses,
        bounds: &[Option<(f64, f64)>],
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Vec<SparsePoint>, PosesError> {
        let reason = match self.triangulated(request, &near.views, sink, cancel)? {
            Ok(points) => return Ok(points),
            Err(reason) => reason,
        };
        let cameras: Vec<Camera> = near.views.iter().map(|view| view.camera).collect();
        let scale = near.normalisation.scale;
        let scaled = |both: &Option<(f64, f64)>| both.map(|(a, b)| (scale * a, scale * b));
        let bounds: Vec<_> = bounds.iter().map(scaled).collect();
        let points = frusta::guess(&cameras, &bounds, GUESSED_POINTS, request.seed);
        let count = points.len();
        let message = format!(
            "the poses came without points, {reason}: {count} random ones take their place"
        );
        sink.warn("points_guessed", message);
        Ok(points)
    }

    fn read(&self) -> Result<Given, PosesError> {
        match self.format {
            Format::Model => SparseModel::read(&self.path).map(|model| from_model(&model)),
            Format::Transforms => Ok(Given {
                views: Assignment::ByPath(transforms::read(&self.path)?),
                points: Vec::new(),
                mean_error: None,
                mean_track: None,
            }),
            Format::PosesBounds => {
                let rows = read_poses_bounds(&self.path)?;
                let view = |row: &crate::poses::bounds::BoundedCamera| GivenView {
                    lens: Lens {
                        intrinsics: row.camera.intrinsics,
                        distortion: Distortion::None,
                    }
                    .into(),
                    world_to_camera: row.camera.world_to_camera,
                    bounds: Some((row.near, row.far)),
                };
                let views = Assignment::ByOrder(rows.iter().map(view).collect());
                Ok(Given {
                    views,
                    points: Vec::new(),
                    mean_error: None,
                    mean_track: None,
                })
            }
        }
    }

    /// The pose of each photograph of the capture, where it has one.
    fn assign(&self, given: Assignment) -> Result<Vec<Option<GivenView>>, PosesError> {
        match given {
            Assignment::ByPath(mut views) => {
                // A frame that is written twice says nothing else.
                views.sort_by(|a, b| a.0.cmp(&b.0));
                views.dedup();
                let (names, views): (Vec<_>, Vec<_>) = views.into_iter().unzip();
                let found = find_each(&names, &self.photographs);
                let found =
                    found.map_err(|tie| PosesError::bad_file(&self.path, tie.to_string()))?;
                Ok(found.into_iter().map(|at| at.map(|at| views[at])).collect())
            }
            Assignment::ByOrder(rows) => self.assign_by_order(rows),
        }
    }

    /// Rows belong to all photographs that there were, in the order of their paths' bytes.
    fn assign_by_order(&self, rows: Vec<GivenView>) -> Result<Vec<Option<GivenView>>, PosesError> {
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
        if let Some(twice) = order
            .windows(2)
            .find(|pair| self.photographs[pair[0]] == self.photographs[pair[1]])
        {
            let name = &self.photographs[twice[0]];
            return refused(format!(
                "two photographs are called `{name}`, which have no order"
            ));
        }
        let mut assigned = vec![None; rows.len()];
        for (at, row) in order.into_iter().zip(rows) {
            assigned[at] = Some(row);
        }
        Ok(assigned)
    }

    /// Tells where a reader who counts numbers would give rows to other photographs.
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

/// Indices of paths in the order in which Python sorts them.
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
        let given = self.read()?;
        cancel.check()?;
        let assigned = self.assign(given.views)?;
        self.warn_of_order(sink);
        let all = self.photographs.iter().zip(&assigned);
        let of_photograph: HashMap<&PhotoPath, &GivenView> = { all }
            .filter_map(|(path, given)| Some((path, given.as_ref()?)))
            .collect();
        let total = request.views.len();
        let mut views = Vec::new();
        let mut bounds = Vec::new();
        for view in request.views {
            if let Some(&given) = of_photograph.get(&view.path) {
                views.push(posed(view, given)?);
                bounds.push(given.bounds);
            }
        }
        let registered = views.len();
        if registered < 3 {
            let file = match self.format {
                Format::Model => "the COLMAP model".into(),
                Format::Transforms | Format::PosesBounds => name_of(&self.path),
            };
            let advice = format!("the names in {file} must be those of the photographs");
            return Err(PosesError::TooFew {
                registered,
                total,
                advice,
            });
        }
        // Far from the origin COLMAP, too, loses its digits.
        let near = Poses {
            views: views.clone(),
            ..Poses::default()
        };
        let near = near.normalised();
        let normalisation = near.normalisation;
        let in_world = |poses| {
            Poses {
                normalisation,
                ..poses
            }
            .in_world()
        };
        if let Some(poses) = self.refined(request, &near.views, sink, cancel)? {
            return Ok(in_world(poses));
        }
        let points = if given.points.is_empty() {
            let points = self.found_points(request, &near, &bounds, sink, cancel)?;
            let found = Poses {
                points,
                ..Poses::default()
            };
            in_world(found).points
        } else {
            given.points
        };
        Ok(Poses {
            views,
            points,
            registered,
            total,
            source: self.describe(),
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
        let points = if self.triangulate.is_some() {
            ", points triangulated where it has none"
        } else {
            ""
        };
        let refined = match self.refine {
            Some(_) => ", refined where the matches say otherwise",
            None => "",
        };
        format!("given {what}{refined}{points}")
    }
}

/// A given pose at the photograph's own size, which may differ from the one it was computed at.
fn posed(view: &PoseView, given: &GivenView) -> Result<PosedView, PosesError> {
    let header =
        read_header(&view.file).map_err(|e| PosesError::bad_file(&view.file, e.to_string()))?;
    let lens = given.lens.at(header.width, header.height);
    let camera = Camera {
        intrinsics: lens.pinhole(),
        world_to_camera: given.world_to_camera,
    };
    Ok(PosedView {
        name: view.name.clone(),
        camera,
        lens,
    })
}

fn from_model(model: &SparseModel) -> Given {
    let view = |image| GivenView {
        lens: model.camera_of(image).lens().into(),
        world_to_camera: image.world_to_camera(),
        bounds: None,
    };
    let by_path = model
        .images
        .iter()
        .map(|image| (PhotoPath::new(&image.name), view(image)))
        .collect();
    Given {
        views: Assignment::ByPath(by_path),
        points: model.sparse_points(),
        mean_error: model.mean_error(),
        mean_track: model.mean_track(),
    }
}

#[cfg(test)]
mod tests;
