//! Results of the readiness checks.

use std::time::Instant;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One check of the server.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Check {
    /// Name: `database`, `disk`, `adapter`, `colmap`, `onnxruntime`, `models` and so on.
    pub name: String,
    /// Whether the check passed.
    pub ok: bool,
    /// What was found.
    pub detail: String,
    /// What to do if it failed.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub hint: String,
}

/// Cached results and their time.
#[derive(Clone, Debug)]
pub struct Remembered {
    pub(super) at: Instant,
    pub(super) checks: Vec<Check>,
}
