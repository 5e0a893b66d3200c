//! What structure from motion is asked and what it answers, whoever answers: COLMAP or poses
//! that came with the capture.

pub mod align;
pub mod bounds;
pub mod left_out;
pub mod lens;
pub mod matching;
pub mod model;
pub(crate) mod npy;
mod picture;
pub mod pnp;
mod rigid;
pub(crate) mod text;
pub mod turn;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::camera::normalisation::Normalisation;
use crate::cancel::{CancelToken, Cancelled};
use crate::capture::PreparedImage;
use crate::event::ProgressSink;
use crate::image::Image;
use crate::mask::Masking;
use crate::photo_path::PhotoPath;
pub use left_out::LeftOut;
pub use lens::{Distortion, Lens};
pub use picture::svg;
pub(crate) use rigid::{Rotation, rotation};

/// Finds where each photograph was taken from. Two implementations: COLMAP by subprocess, and
/// poses given with the capture.
pub trait Sfm {
    /// Poses of as many of the request's views as can be found, and sparse points.
    ///
    /// # Errors
    /// [`PosesError`]; [`PosesError::TooFew`] is expected data about a capture, not a fault.
    fn poses(
        &self,
        request: &PoseRequest<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError>;

    /// What answers, in words that change when its answers may: part of the stage's fingerprint.
    fn describe(&self) -> String;
}

/// What is asked of an [`Sfm`].
#[derive(Clone, Copy, Debug)]
pub struct PoseRequest<'a> {
    /// The photographs, in the capture's order (sequential matching relies on it).
    pub views: &'a [PoseView],
    /// A directory of its own; created, filled, and left with `colmap.log` in it.
    pub work_dir: &'a Path,
    /// Seed of what is random, where the tool has one.
    pub seed: u64,
}

/// One photograph to be posed.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseView {
    /// The view's own safe name (a stem without extension).
    pub name: String,
    /// What its owner calls the photograph.
    pub path: PhotoPath,
    /// The original photograph, for its header alone.
    pub file: PathBuf,
    /// What is read in its place.
    pub prepared: PreparedImage,
    /// Size of the upright original, px.
    pub original: (usize, usize),
    /// Focal length in px of the original photograph, where its metadata tell.
    pub focal_px: Option<f64>,
    /// Its mask.
    pub masking: Option<Masking>,
}

/// The answer. As JSON it is the stage's stored result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Poses {
    /// Registered views, in the request's order.
    pub views: Vec<PosedView>,
    /// What the owner calls the photographs of all views asked for, by the views' names.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub photographs: BTreeMap<String, PhotoPath>,
    /// Sparse points.
    pub points: Vec<SparsePoint>,
    /// Number of registered views.
    pub registered: usize,
    /// Number of views asked for.
    pub total: usize,
    /// Who answered: `colmap 3.8`, or which file.
    pub source: String,
    /// The fallback strategy that was taken: learned matches of all pairs (`L`, by a loose mapper
    /// `M`), of the strongest (`N`, `O`), of those that agree (`P`, `Q`); COLMAP's own features
    /// (`A`..=`E`, and `G` on the plain photographs); or all of it on deblurred photographs (`F`).
    /// `None` for given poses.
    #[serde(rename = "rung")]
    pub strategy: Option<char>,
    /// What is said about the place of every view asked for; empty where the poses were given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub verdicts: Vec<PoseVerdict>,
    /// The names of the views that hang together, where they fall into several parts of three or
    /// more that no matches connect; else empty.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Vec<String>>,
    /// Names of the views that given poses keep from training, as the test split of a published
    /// set.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held_out: Vec<String>,
    /// Mean reprojection error, px of the pose copies; `None` where nobody measured one.
    pub mean_reprojection_error: Option<f64>,
    /// Mean number of views a point was seen in; `None` without points.
    pub mean_track: Option<f64>,
    /// Whether no strategy met the acceptance rule and the best of them was taken.
    pub low_confidence: bool,
    /// Fingerprint of the network that had a hand in them, or would have had: without one they
    /// are what a run with any other network finds, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<String>,
    /// Wall seconds.
    pub seconds: f64,
    /// What was done to the world of views and points; the identity in what is found, and in what
    /// users see.
    #[serde(default, skip_serializing_if = "Normalisation::is_identity")]
    pub normalisation: Normalisation,
}

impl Poses {
    /// In a world of ordinary size about the origin.
    #[must_use]
    pub fn normalised(self) -> Self {
        let cameras: Vec<Camera> = self.views.iter().map(|view| view.camera).collect();
        self.within(Normalisation::of(&cameras))
    }

    /// Of the world, normalised so.
    #[must_use]
    pub fn within(self, normalisation: Normalisation) -> Self {
        let camera = |camera: &Camera| normalisation.within(camera);
        let moved = self.moved(camera, |point| normalisation.point_within(point));
        Self { normalisation, ..moved }
    }

    /// In the world that they were found or given in.
    #[must_use]
    pub fn in_world(self) -> Self {
        let by = self.normalisation;
        let moved = self.moved(|camera| by.in_world(camera), |point| by.point_in_world(point));
        Self { normalisation: Normalisation::default(), ..moved }
    }

    fn moved(mut self, camera: impl Fn(&Camera) -> Camera, point: impl Fn(DVec3) -> DVec3) -> Self {
        for view in &mut self.views {
            view.camera = camera(&view.camera);
        }
        for sparse in &mut self.points {
            sparse.position = point(sparse.position.into()).to_array();
        }
        self
    }

    /// What is said about the view of this name; of one with a pose where nothing was said before.
    pub(crate) fn verdict_of(&mut self, name: &str) -> &mut PoseVerdict {
        let verdicts = &mut self.verdicts;
        let index = verdicts.iter().position(|verdict| verdict.name == name);
        let index = index.unwrap_or_else(|| {
            verdicts.push(PoseVerdict {
                name: name.to_owned(),
                status: PoseStatus::Registered,
                matches: 0,
                fitting: 0,
                error_px: None,
                fit: None,
            });
            verdicts.len() - 1
        });
        &mut verdicts[index]
    }
}

/// What is said about a view's place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseVerdict {
    /// The view's name.
    pub name: String,
    /// Whether it has a place.
    pub status: PoseStatus,
    /// Its matches with other placed views, of the networks; 0 without networks.
    pub matches: usize,
    /// How many of them fit the poses.
    pub fitting: usize,
    /// Mean reprojection error of the points that it sees, px of the pose copies; of a late view
    /// px of its working size. `None` where nobody measured one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_px: Option<f64>,
    /// Correlation of its structures with those of its render, shaken as it is, in the last round
    /// that rendered it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<f64>,
}

/// Whether a view has a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseStatus {
    /// Placed, and nothing speaks against it.
    Registered,
    /// Placed, but stronger matches than those that placed it say otherwise: it is left out.
    Doubtful,
    /// Not placed.
    NotFound,
    /// Where rough given poses have it: it could not be placed by its matches.
    Given,
    /// Placed by a round's scene; it trains from the next round on.
    Late,
    /// Placed, but it fitted a round's scene far worse than the others did: it is left out.
    TakenOut,
}

/// A view with its pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosedView {
    /// The view's name.
    pub name: String,
    /// The pinhole camera of the *undistorted* photograph, at the original photograph's size.
    pub camera: Camera,
    /// The lens of the photograph as taken.
    pub lens: Lens,
}

impl PosedView {
    /// The photograph (or its ground truth), at any size of the same aspect, as [`Self::camera`]
    /// sees it. Size and encoding stay; without distortion it is a plain copy.
    pub fn undistort<E>(&self, image: &Image<E>) -> Image<E> {
        lens::undistort(image, &self.lens, &self.camera.intrinsics)
    }
}

/// A point that was triangulated, or guessed where poses came without points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SparsePoint {
    /// World units.
    pub position: [f64; 3],
    /// sRGB, as bright as the pose copies.
    pub colour: [u8; 3],
    /// Mean reprojection error, px of the pose copies; 0 where unknown.
    pub error: f64,
    /// Number of views that see it; 0 for a guessed point.
    pub track: u32,
}

/// Why there are no poses.
#[derive(Debug, thiserror::Error)]
pub enum PosesError {
    /// Structure from motion worked, but the photographs do not allow it. Expected data.
    #[error("only {registered} of {total} photographs could be placed in one scene")]
    TooFew {
        /// Photographs in the largest model.
        registered: usize,
        /// Photographs asked for.
        total: usize,
        /// What the user can do.
        advice: String,
    },
    /// The program is not there.
    #[error("cannot start `{program}`: {reason}")]
    Missing {
        /// The program that was tried.
        program: String,
        /// What the system said.
        reason: String,
    },
    /// The program did not end, or said nothing for too long, and was killed.
    #[error("`colmap {command}` was stopped after {seconds} s {why}")]
    Timeout {
        /// COLMAP's subcommand.
        command: String,
        /// Seconds it was given.
        seconds: u64,
        /// `in all` or `without output`.
        why: &'static str,
    },
    /// The program ended with a failure that is not about the photographs.
    #[error("`colmap {command}` failed ({status}): {tail}")]
    Tool {
        /// COLMAP's subcommand.
        command: String,
        /// Exit code or signal.
        status: String,
        /// Its last lines.
        tail: String,
    },
    /// The networks that find key points and matches.
    #[error("key points and matches: {detail}")]
    Matching {
        /// What went wrong.
        detail: String,
    },
    /// Given poses that cannot be used, or a model that cannot be read.
    #[error("{}: {reason}", name_of(file))]
    BadFile {
        /// The file at fault.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Reading or writing failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The parts of a capture that nothing connects, for a sentence.
pub(crate) fn in_words(parts: &[Vec<String>]) -> String {
    let names: Vec<String> =
        parts.iter().map(|part| format!("{} ({})", part.len(), part.join(", "))).collect();
    format!(
        "{} places that no matches connect, with {} photographs",
        parts.len(),
        names.join(" and ")
    )
}

/// Whoever gave the file knows where it lies; a client of the service need not learn where it was
/// put. One of several models is known by its number in a folder.
pub(crate) fn name_of(file: &Path) -> std::borrow::Cow<'_, str> {
    let name = |path: &'_ Path| path.file_name().unwrap_or(path.as_os_str()).to_owned();
    let own = name(file).to_string_lossy().into_owned();
    let is_number = own.bytes().all(|byte| byte.is_ascii_digit());
    match file.parent().filter(|_| is_number) {
        Some(folder) => format!("{}/{own}", name(folder).to_string_lossy()).into(),
        None => own.into(),
    }
}

impl PosesError {
    /// Whether a tool failed at what it was asked, so that asking for less or for other things may
    /// do better.
    pub fn is_about_the_tool(&self) -> bool {
        matches!(self, Self::Tool { .. } | Self::Matching { .. })
    }

    /// An adapter for `map_err` that remembers the path.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    /// A [`PosesError::BadFile`].
    pub fn bad_file(file: &Path, reason: impl Into<String>) -> Self {
        Self::BadFile { file: file.to_owned(), reason: reason.into() }
    }
}
