//! What the process that makes a video tells, a line of JSON each.

use serde::{Deserialize, Serialize};

/// A line from it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VideoEvent {
    /// So many pictures are rendered.
    Rendered {
        /// Pictures.
        done: u32,
        /// Of so many.
        total: u32,
    },
    /// There will be no video.
    Failed {
        /// What happened.
        detail: String,
        /// What to do.
        hint: String,
    },
}
