//! What a replica asks a worker to do at once, besides jobs, and what comes of it.

use fled_core::camera::NamedCamera;
use fled_core::video::Plan;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::wire::NamedFile;
use crate::render::{Format, Shown};

/// What is asked for: a worker does one of each at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = ErrandKind)]
pub enum Kind {
    /// A picture.
    View,
    /// A video.
    Video,
}

impl Kind {
    /// In the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Video => "video",
        }
    }
}

/// What a worker is asked to do at once.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Errand {
    /// A UUID.
    pub id: String,
    /// Of which job.
    pub job: String,
    /// What it needs of the job's files.
    pub files: Vec<NamedFile>,
    /// `{"view": ..}` or `{"video": ..}`.
    #[schema(value_type = Object)]
    pub task: Task,
}

/// What is to be made.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// A picture.
    View {
        /// Of which scene: its path in the job's folder.
        scene: String,
        /// Pose, intrinsics and size.
        camera: Box<NamedCamera>,
        /// What it shows.
        shown: Shown,
        /// Brighter by so many stops.
        #[serde(default)]
        ev: f64,
        /// The file format.
        format: Format,
    },
    /// A video.
    Video {
        /// Its way and its pictures.
        plan: Box<Plan>,
    },
}

impl Task {
    /// Of which kind it is.
    pub fn kind(&self) -> Kind {
        match self {
            Self::View { .. } => Kind::View,
            Self::Video { .. } => Kind::Video,
        }
    }
}

/// A worker looks for something to do.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
pub struct Willing {
    /// Of which kind.
    pub kind: Kind,
}

/// How far a worker is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Headway {
    /// So many pictures are done.
    pub done: u32,
    /// Of so many; 0 where that is not known.
    pub total: u32,
}

/// Whether to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Awaited {
    /// Whether somebody still waits for it.
    pub awaited: bool,
}

/// What came of an errand.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// A file, which the store has now.
    Made {
        /// BLAKE3 of its bytes, 64 lower hexadecimal digits.
        digest: String,
        /// How many bytes.
        bytes: u64,
    },
    /// This worker cannot; another may, or whoever asked.
    Failed {
        /// What happened.
        detail: String,
    },
}
