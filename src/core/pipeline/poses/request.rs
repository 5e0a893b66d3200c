//! The request for poses.

use std::path::{Path, PathBuf};

use crate::pipeline::context::Context;
use crate::pipeline::tools::Tools;
use crate::pipeline::workspace::fingerprint;
use crate::poses::{PoseRequest, PoseView, Poses, PosesError};

/// Asks for the poses of `views`; COLMAP works in `work_dir`, and `earlier` are files of matches
/// that other searches kept.
///
/// # Errors
/// [`PosesError`], that of a capture which cannot be placed among them.
pub fn ask(
    context: &mut Context<'_>,
    tools: &Tools<'_>,
    views: &[PoseView],
    work_dir: &Path,
    earlier: &[PathBuf],
    seed: u64,
) -> Result<Poses, PosesError> {
    let stamp = fingerprint(&[&tools.sfm.describe()]);
    let request = PoseRequest { views, work_dir, seed, stamp: &stamp, earlier };
    tools.sfm.poses(&request, context.sink, context.cancel)
}
