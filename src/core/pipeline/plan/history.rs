//! How fast this machine was in its last runs.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::work::Part;
use crate::pipeline::error::PipelineError;
use crate::pipeline::workspace::{CODE_VERSION, Workspace};

/// Most runs that are kept.
const KEPT: usize = 20;
/// Most costs of a part that are asked.
const ASKED: usize = 3;

/// The cost of a part of a finished run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    pub part: Part,
    /// The device, network or method.
    pub by: String,
    /// Its work, as [`super::work`] has it.
    pub work: f64,
    pub seconds: f64,
}

/// The content of `costs.json`. The costs of another version of the code say nothing about this
/// one.
#[derive(Serialize, Deserialize)]
struct Kept<R> {
    code_version: u32,
    runs: R,
}

/// The costs of this machine's last runs, the newest last.
#[derive(Clone, Debug, Default)]
pub struct History {
    file: Option<PathBuf>,
    runs: Vec<Vec<Cost>>,
}

impl History {
    /// The history in `folder`; none where nothing is cached or kept yet.
    pub fn open(folder: Option<&Path>, workspace: &Workspace) -> Self {
        let file = folder.map(|folder| folder.join("costs.json"));
        let kept = file.as_ref().and_then(|file| workspace.read_json::<Kept<Vec<_>>>(file));
        let kept = kept.filter(|kept| kept.code_version == CODE_VERSION);
        Self { file, runs: kept.map(|kept| kept.runs).unwrap_or_default() }
    }

    /// Seconds a unit of work that a part took lately.
    pub fn pace(&self, part: Part, by: &str) -> Option<f64> {
        let newest = self.runs.iter().rev().flatten();
        let costs = newest.filter(|cost| cost.part == part && cost.by == by);
        let (work, seconds) = costs
            .take(ASKED)
            .fold((0.0, 0.0), |(work, seconds), cost| (work + cost.work, seconds + cost.seconds));
        (work > 0.0).then(|| seconds / work)
    }

    /// Adds a run. Nothing is kept of one that only loaded what earlier ones had made.
    pub fn add(&mut self, run: Vec<Cost>) {
        if !run.is_empty() {
            self.runs.push(run);
            self.runs.drain(..self.runs.len().saturating_sub(KEPT));
        }
    }

    /// Writes the file, if there is to be one.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn write(&self, workspace: &Workspace) -> Result<(), PipelineError> {
        match &self.file {
            Some(file) => {
                let kept = Kept { code_version: CODE_VERSION, runs: &self.runs };
                workspace.write_json(file, &kept)
            }
            None => Ok(()),
        }
    }
}
