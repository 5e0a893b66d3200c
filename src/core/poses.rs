//! The request and result of structure from motion, from COLMAP or from poses supplied with the
//! capture.

pub mod align;
pub mod matching;
pub mod overlap;
mod picture;
pub mod pnp;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use fled_capture::poses::*;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::camera::normalisation::Normalisation;
use crate::cancel::{CancelToken, Cancelled};
use crate::capture::PreparedImage;
use crate::event::ProgressSink;
use crate::photo_path::PhotoPath;
pub use picture::svg;

/// Finds the viewpoints of photographs. Two implementations: COLMAP as a subprocess, and poses
/// supplied with the capture.
pub trait Sfm {
    /// Poses of as many of the request's views as can be found, and sparse points.
    ///
    /// # Errors
    /// [`PosesError`]; [`PosesError::TooFew`] is an expected outcome for a capture, not a fault.
    fn poses(
        &self,
        request: &PoseRequest<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError>;

    /// A description that changes if the results may change: part of the stage's fingerprint.
    fn describe(&self) -> String;
}

/// The request to an [`Sfm`].
#[derive(Clone, Copy, Debug)]
pub struct PoseRequest<'a> {
    /// The photographs, in the capture's order (sequential matching relies on it).
    pub views: &'a [PoseView],
    /// A dedicated directory; created, filled, and left with `colmap.log` in it.
    pub work_dir: &'a Path,
    /// Random seed, if the tool has one.
    pub seed: u64,
    /// Identifies build and tools: what those of another stamp left in the directory is not used.
    pub stamp: &'a str,
    /// Files of matches that other searches kept: pairs that they have compared are known.
    pub earlier: &'a [PathBuf],
}

/// One photograph whose pose is requested.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseView {
    /// The view's own safe name (a stem without extension).
    pub name: String,
    /// The owner's path of the photograph.
    pub path: PhotoPath,
    /// Its image.
    pub prepared: PreparedImage,
    /// Size of the upright original, px.
    pub original: (usize, usize),
    /// Focal length in px of the original photograph, if in its metadata.
    pub focal_px: Option<f64>,
    /// How much each of its pixels counts, 0 to 1, if it has masks.
    pub mask: Option<PreparedImage>,
}

/// The result. As JSON it is the stage's stored result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Poses {
    /// Registered views, in the request's order.
    pub views: Vec<PosedView>,
    /// The owner's paths of the photographs of all requested views, by view name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub photographs: BTreeMap<String, PhotoPath>,
    /// Sparse points.
    pub points: Vec<SparsePoint>,
    /// Number of registered views.
    pub registered: usize,
    /// Number of requested views.
    pub total: usize,
    /// The source: `colmap 3.8`, or a file.
    pub source: String,
    /// The fallback strategy used: learned matches of all pairs (`L`, with a loose mapper `M`), of
    /// the strongest (`N`, `O`), of those that agree (`P`, `Q`); COLMAP's own features (`A`..=`E`,
    /// and `G` on the plain photographs); or all of these on deblurred photographs (`F`). `None`
    /// for given poses.
    #[serde(rename = "rung")]
    pub strategy: Option<char>,
    /// The verdict on every requested view; empty if the poses were given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub verdicts: Vec<PoseVerdict>,
    /// The names of connected views, if they form several parts of three or more that no matches
    /// connect; else empty.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Vec<String>>,
    /// Names of the views that given poses hold out from training, such as the test split of a
    /// published set.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held_out: Vec<String>,
    /// Mean reprojection error, px of the pose copies; `None` if not measured.
    pub mean_reprojection_error: Option<f64>,
    /// Mean number of views that see a point; `None` without points.
    pub mean_track: Option<f64>,
    /// Whether no strategy met the acceptance criteria and the best one was used.
    pub low_confidence: bool,
    /// Fingerprint of the network that contributed to them, or would have; without it, any other
    /// network gives the same poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<String>,
    /// Wall seconds.
    pub seconds: f64,
    /// The normalisation of views and points; the identity for found poses, and in what users see.
    #[serde(default, skip_serializing_if = "Normalisation::is_identity")]
    pub normalisation: Normalisation,
}

impl Poses {
    /// In a world of ordinary size around the origin.
    #[must_use]
    pub fn normalised(self) -> Self {
        let cameras: Vec<Camera> = self.views.iter().map(|view| view.camera).collect();
        self.within(Normalisation::of(&cameras))
    }

    /// In the world with this normalisation.
    #[must_use]
    pub fn within(self, normalisation: Normalisation) -> Self {
        let camera = |camera: &Camera| normalisation.within(camera);
        let moved = self.moved(camera, |point| normalisation.point_within(point));
        Self { normalisation, ..moved }
    }

    /// In the world in which they were found or given.
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

    /// The verdict on the view of this name; a default one for a view with a pose but no verdict.
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

/// The verdict on a view's pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseVerdict {
    /// The view's name.
    pub name: String,
    /// Whether it has a pose.
    pub status: PoseStatus,
    /// Its matches with other placed views, found by the networks; 0 without networks.
    pub matches: usize,
    /// Number of those that fit the poses.
    pub fitting: usize,
    /// Mean reprojection error of the points that it sees, px of the pose copies; for a late view
    /// px of its working size. `None` if not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_px: Option<f64>,
    /// Correlation of its structures with those of its render, with the same shake, in the last
    /// round that rendered it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<f64>,
}

/// Whether a view has a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseStatus {
    /// Placed and consistent.
    Registered,
    /// Placed, but contradicted by stronger matches than those that placed it: it is left out.
    Doubtful,
    /// Not placed.
    NotFound,
    /// At its rough given pose: its matches could not place it.
    Given,
    /// Placed by a round's scene; it trains from the next round on.
    Late,
    /// Placed, but it fitted a round's scene far worse than the others: it is left out.
    TakenOut,
}

/// Why there are no poses.
#[derive(Debug, thiserror::Error)]
pub enum PosesError {
    /// Structure from motion worked, but the photographs do not suffice. An expected outcome.
    #[error("only {registered} of {total} photographs could be placed in one scene")]
    TooFew {
        /// Photographs in the largest model.
        registered: usize,
        /// Photographs requested.
        total: usize,
        /// Advice for the user.
        advice: String,
    },
    /// The program cannot be started.
    #[error("cannot start `{program}`: {reason}")]
    Missing {
        /// The attempted program.
        program: String,
        /// The system's message.
        reason: String,
    },
    /// The program did not exit, or was silent for too long, and was killed.
    #[error("`colmap {command}` was stopped after {seconds} s {why}")]
    Timeout {
        /// COLMAP's subcommand.
        command: String,
        /// The time limit in seconds.
        seconds: u64,
        /// `in all` or `without output`.
        why: &'static str,
    },
    /// The program failed for a reason unrelated to the photographs.
    #[error("`colmap {command}` failed ({status}): {tail}")]
    Tool {
        /// COLMAP's subcommand.
        command: String,
        /// Exit code or signal.
        status: String,
        /// Its last lines.
        tail: String,
    },
    /// The networks that find key points and matches failed.
    #[error("key points and matches: {detail}")]
    Matching {
        /// The cause.
        detail: String,
    },
    /// Given poses, a model or a picture that cannot be used, read or written.
    #[error(transparent)]
    File(#[from] PoseFileError),
    /// Cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The unconnected parts of a capture, for a message.
pub(crate) fn in_words(parts: &[Vec<String>]) -> String {
    let names: Vec<String> =
        parts.iter().map(|part| format!("{} ({})", part.len(), part.join(", "))).collect();
    format!(
        "{} places that no matches connect, with {} photographs",
        parts.len(),
        names.join(" and ")
    )
}

impl PosesError {
    /// Whether the tool failed at the task itself, so that a smaller or different task may succeed.
    pub fn is_about_the_tool(&self) -> bool {
        matches!(self, Self::Tool { .. } | Self::Matching { .. })
    }

    /// An adapter for `map_err` that adds the path.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let failed = PoseFileError::io(path);
        move |source| failed(source).into()
    }

    /// A file with unusable content.
    pub fn bad_file(file: &Path, reason: impl Into<String>) -> Self {
        PoseFileError::bad_file(file, reason).into()
    }
}
