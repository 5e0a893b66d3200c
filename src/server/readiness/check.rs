//! Results of the readiness checks.

use std::time::Instant;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One thing that has to be in order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Check {
    /// `database`, `disk`, `adapter`, `colmap`, `onnxruntime`, `models` ...
    pub name: String,
    /// Whether it is in order.
    pub ok: bool,
    /// What was found.
    pub detail: String,
    /// What to do, when it is not in order.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub hint: String,
}

/// Cached results and their time.
#[derive(Clone, Debug)]
pub struct Remembered {
    pub(super) at: Instant,
    pub(super) checks: Vec<Check>,
}
