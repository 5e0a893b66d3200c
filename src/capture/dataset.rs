//! Poses supplied with a capture: a COLMAP model, NeRF's `transforms.json`, or LLFF's
//! `poses_bounds.npy`.

mod doubt;
mod given_view;
mod placed;
mod read;
mod transforms;
mod upright;

pub(crate) use transforms::masks as masks_of_transforms;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use given_view::GivenView;
use placed::Placed;

use crate::capture::{CaptureView, CaptureWarning, MIN_VIEWS};
use crate::photo_path::{PhotoPath, Tie, find_each};
use crate::poses::left_out::in_words;
use crate::poses::model::SparseModel;
use crate::poses::{LeftOut, PoseFileError, PosedView, SparsePoint, name_of};

/// Width and height, px.
type Size = (usize, usize);

/// A file or directory with poses for photographs.
pub struct GivenPoses {
    path: PathBuf,
    format: Format,
    photographs: Vec<PhotoPath>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Model,
    Transforms,
    PosesBounds,
}

/// Poses that came with a capture, in pixels of its upright photographs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlacedPoses {
    /// The name of their file, for messages.
    pub file: String,
    /// The photographs with a pose, in the capture's order.
    pub views: Vec<PosedView>,
    /// Nearest and farthest depth of each, world units, if the format has them.
    pub depths: Vec<Option<(f64, f64)>>,
    /// Names of the views that the poses hold out from training.
    pub held_out: Vec<String>,
    /// Points that came along, in the world of the views.
    pub points: Vec<SparsePoint>,
    /// Mean reprojection error of these points, px, if the format has it.
    pub mean_error: Option<f64>,
    /// Mean number of views that see a point, if the format has it.
    pub mean_track: Option<f64>,
    /// Poses that are not used, or only after a change.
    pub warnings: Vec<CaptureWarning>,
    /// Number of poses that were turned upright with their photographs.
    pub turned: usize,
    /// Poses that cannot be used, by their names in the file.
    pub left_out: Vec<LeftOut>,
    /// A name in the file and one of a photograph, if too few photographs have the names in it.
    pub unlike_names: Option<String>,
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
    /// [`PoseFileError::BadFile`] if it is none of these. [`Self::place`] reads the content.
    pub fn open(path: &Path, photographs: &[PhotoPath]) -> Result<Self, PoseFileError> {
        let extension = path.extension().and_then(|extension| extension.to_str());
        let format = match extension.map(str::to_ascii_lowercase).as_deref() {
            _ if SparseModel::stands_in(path) => Format::Model,
            Some("json") => Format::Transforms,
            Some("npy") => Format::PosesBounds,
            _ => {
                let reason = "neither a COLMAP model, a transforms.json nor a poses_bounds.npy";
                return Err(PoseFileError::bad_file(path, reason));
            }
        };
        Ok(Self { path: path.to_owned(), format, photographs: photographs.to_vec() })
    }

    /// The number of photographs with a pose in the file.
    ///
    /// # Errors
    /// Those of [`Self::place`].
    pub fn count(&self) -> Result<usize, PoseFileError> {
        let assigned = self.assign(self.read()?.0)?;
        Ok(assigned.iter().flatten().count())
    }

    /// The names of photographs in the file; empty for formats without names.
    ///
    /// # Errors
    /// Those of [`Self::place`].
    pub fn names(&self) -> Result<Vec<PhotoPath>, PoseFileError> {
        Ok(self.sizes()?.into_iter().map(|(name, _)| name).collect())
    }

    /// As [`Self::names`], with the picture size of each lens, px, if the file gives it.
    ///
    /// # Errors
    /// Those of [`Self::place`].
    pub fn sizes(&self) -> Result<Vec<(PhotoPath, Option<Size>)>, PoseFileError> {
        let size = |view: GivenView| view.lens.size();
        Ok(match self.read()?.0 {
            Assignment::ByPath(views) => {
                views.into_iter().map(|(name, view)| (name, view.and_then(size))).collect()
            }
            Assignment::ByOrder(_) => Vec::new(),
        })
    }

    /// The poses of the photographs of a capture.
    ///
    /// # Errors
    /// [`PoseFileError`] for a file that cannot be read or assigned.
    pub fn place(&self, views: &[CaptureView]) -> Result<PlacedPoses, PoseFileError> {
        let (assignment, mut given) = self.read()?;
        let assigned = self.assign(assignment)?;
        let all = self.photographs.iter().zip(&assigned);
        let of_photograph: HashMap<&PhotoPath, &GivenView> =
            { all }.filter_map(|(path, given)| Some((path, given.as_ref()?))).collect();
        let placed = Placed::of(views, &of_photograph, &mut given)?;
        let is_few = placed.views.len() < MIN_VIEWS;
        let unlike_names = if is_few { self.unlike_names() } else { None };
        let mut warnings: Vec<CaptureWarning> = self.warning_of_order().into_iter().collect();
        warnings.extend(self.warnings(&given, &placed));
        Ok(PlacedPoses {
            file: self.label().into_owned(),
            views: placed.views,
            depths: placed.bounds,
            held_out: placed.held_out,
            points: given.points,
            mean_error: given.mean_error,
            mean_track: given.mean_track,
            turned: placed.turned.len(),
            left_out: given.left_out,
            warnings,
            unlike_names,
        })
    }

    fn read(&self) -> Result<(Assignment, Given), PoseFileError> {
        match self.format {
            Format::Model => read::model(&self.path),
            Format::Transforms => read::transforms(&self.path),
            Format::PosesBounds => read::poses_bounds(&self.path),
        }
    }

    /// Warnings about poses that are not used, or only after a change.
    fn warnings(&self, given: &Given, placed: &Placed) -> Vec<CaptureWarning> {
        let file = self.label();
        let mut warnings = Vec::new();
        if !given.left_out.is_empty() {
            let message = format!("{file}: left out are {}", in_words(&given.left_out));
            warnings.push(CaptureWarning::new("poses_left_out", message));
        }
        for message in &given.warnings {
            warnings.push(CaptureWarning::new("poses_mended", format!("{file}: {message}")));
        }
        if !placed.doubts.is_empty() {
            let message = format!("{file}: {}", in_words(&placed.doubts));
            warnings.push(CaptureWarning::new("poses_unlikely", message));
        }
        if let Some(first) = placed.assumed.first() {
            let message = format!(
                "{file}: the poses of {} photographs, the first is {first}, are taken to be those \
                 of the pixels as they are stored, and are turned upright with them by EXIF; if \
                 the program that made them turned the photographs itself, give upright copies \
                 without EXIF orientation",
                placed.assumed.len()
            );
            warnings.push(CaptureWarning::new("poses_turned", message));
        }
        warnings
    }

    /// The file's name for messages. A model from a zip or an upload is in one of our own folders.
    fn label(&self) -> std::borrow::Cow<'_, str> {
        let name = name_of(&self.path);
        match self.format {
            Format::Model if !name.starts_with("sparse") => "the COLMAP model".into(),
            _ => name,
        }
    }

    /// An example of a name in the file and the name of a photograph, for a mismatch.
    fn unlike_names(&self) -> Option<String> {
        let names = self.names().ok()?;
        let name = { names.iter() }.find(|name| !self.photographs.contains(name))?;
        let photograph = self.photographs.first()?;
        Some(format!("it has `{name}`, and a photograph is called `{photograph}`"))
    }

    /// The pose of each photograph of the capture, if it has one.
    fn assign(&self, given: Assignment) -> Result<Vec<Option<GivenView>>, PoseFileError> {
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
                let refused =
                    |tie: Tie| PoseFileError::bad_file(Path::new(&*label), tie.to_string());
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
    ) -> Result<Vec<Option<GivenView>>, PoseFileError> {
        let refused = |reason: String| Err(PoseFileError::bad_file(&self.path, reason));
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

    /// A warning if a reader that sorts by number would assign rows to other photographs.
    fn warning_of_order(&self) -> Option<CaptureWarning> {
        let order = by_bytes(&self.photographs);
        let pair = order.windows(2).find(|pair| pair[0] > pair[1])?;
        let message = format!(
            "{}: its rows are taken for the photographs in the order of the letters of their \
             names, as LLFF sorts them: {} before {}; number them with equally many digits if \
             that is wrong",
            name_of(&self.path),
            self.photographs[pair[0]],
            self.photographs[pair[1]]
        );
        let is_by_order = self.format == Format::PosesBounds;
        is_by_order.then(|| CaptureWarning::new("poses_order", message))
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

#[cfg(test)]
mod tests;
