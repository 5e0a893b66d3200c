//! Poses: found once a job, or taken from an earlier run of the same capture; and strategy F:
//! COLMAP once more, on deblurred photographs.

mod deblurred;
mod request;

use std::fs::{DirEntry, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use deblurred::STRATEGY;
use request::ask;

use super::config::{Options, PoseSource};
use super::context::{Context, stamp_name};
use super::dependencies::{Dependencies, PosesDependencies};
use super::error::PipelineError;
use super::tools::Tools;
use super::workspace::Workspace;
use crate::camera::Camera;
use crate::camera::normalisation::Normalisation;
use crate::capture::{Capture, CaptureView};
use crate::event::{ProgressSink, Stage};
use crate::poses::{PoseStatus, PoseView, Poses, PosesError, in_words, svg};
use crate::run_folder::KEPT_MATCHES;

/// Name of the folder in the cache that keeps poses, a file for each set of dependencies.
pub const CACHED: &str = "poses";

/// Extension of the files of matches in the same folder.
const MATCHES: &str = "matches";

/// Number of these files that are read, each of up to some megabytes for 60 photographs.
const MOST_FILES: usize = 16;
/// Bytes of these files that are read, in all: they are held in memory while pairs are matched.
const MOST_BYTES: u64 = 128 << 20;

/// The stage: the poses, once, and what the user should know about them.
///
/// # Errors
/// [`PipelineError::Poses`], those of the network, [`PipelineError::Io`],
/// [`PipelineError::Cancelled`].
pub fn poses(
    context: &mut Context<'_>,
    capture: &Capture,
    options: &Options,
    tools: &mut Tools<'_>,
) -> Result<Poses, PipelineError> {
    let source = tools.sfm.describe();
    let depends_on =
        PosesDependencies::new(options, &capture.fingerprint, &source, &tools.networks());
    let cache = Cache {
        folder: tools.cache.as_ref().map(|cache| cache.join(CACHED)),
        depends_on: &depends_on,
    };
    let path = context.workspace.folder().work().found_poses();
    let serves = |poses: &Poses| serves(poses, &depends_on);
    let is_here = context.workspace.read_json(&path).is_some_and(|poses| serves(&poses));
    let name = stamp_name(Stage::Poses, 0);
    let fingerprint = depends_on.first.fingerprint();
    let is_stamped = context.workspace.finished(&name, fingerprint).is_some();
    if !(is_here && is_stamped)
        && let Some(poses) = cache.read(context.workspace)
    {
        let message = format!("poses: taken from an earlier run of this capture ({source})");
        context.sink.log(message);
        context.workspace.write_json(&path, &poses)?;
        context.workspace.stamp(&name, fingerprint, poses.seconds)?;
    }
    let poses = context.once(
        Stage::Poses,
        0,
        &depends_on.first,
        |workspace| workspace.read_json(&path).filter(serves),
        |context| {
            let poses = find(context, capture, tools, &cache)?;
            context.workspace.write_json(&path, &poses)?;
            Ok(poses)
        },
    )?;
    let kept = cache.write(context.workspace, &poses);
    or_logged(kept, "the poses", context.sink);
    let called = |view: &CaptureView| (view.name.clone(), view.path.clone());
    let photographs = capture.views.iter().map(called).collect();
    let poses = Poses { photographs, ..poses };
    warn(context.sink, &poses, &capture.views);
    Ok(poses)
}

/// Writes the poses, in the world that they were found in, for those who look at the run. Not part
/// of the stage: a run that was delivered keeps those that its scene changed.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn publish(workspace: &Workspace, poses: &Poses) -> Result<(), PipelineError> {
    let folder = workspace.folder();
    workspace.write(&folder.poses_picture(), svg(poses).as_bytes())?;
    workspace.write_json(&folder.poses(), &poses.clone().in_world())
}

/// Whether poses serve a run with these dependencies: what a network had a hand in is of no use to
/// a run with another one.
fn serves(poses: &Poses, depends_on: &PosesDependencies) -> bool {
    let network = poses.network.as_deref();
    network.is_none_or(|network| network == depends_on.second.fingerprint())
}

/// The poses of earlier runs, by what they depend on.
struct Cache<'a> {
    folder: Option<PathBuf>,
    depends_on: &'a PosesDependencies,
}

impl Cache<'_> {
    fn file(&self, of: &Dependencies) -> Option<PathBuf> {
        let folder = self.folder.as_ref()?;
        Some(folder.join(format!("{}.json", of.fingerprint())))
    }

    fn read(&self, workspace: &Workspace) -> Option<Poses> {
        let of = |dependencies| workspace.read_json(&self.file(dependencies)?);
        of(&self.depends_on.first).or_else(|| of(&self.depends_on.second))
    }

    /// Keeps the poses, or records in the time of their file that they were used: what clears the
    /// cache goes by that.
    fn write(&self, workspace: &Workspace, poses: &Poses) -> Result<(), PipelineError> {
        let of = match poses.network {
            None => &self.depends_on.first,
            Some(_) => &self.depends_on.second,
        };
        let Some(file) = self.file(of) else {
            return Ok(());
        };
        if !file.exists() {
            return workspace.write_json(&file, poses);
        }
        let used = File::options().write(true).open(&file);
        // The cache may be another user's, who keeps the time.
        let _ = used.and_then(|file| file.set_modified(SystemTime::now()));
        Ok(())
    }
}

impl Cache<'_> {
    /// The files of matches that searches kept, the newest first, as far as they fit in memory.
    fn matches(&self, most_bytes: u64) -> Vec<PathBuf> {
        let entries = self.folder.iter().filter_map(|folder| std::fs::read_dir(folder).ok());
        let known = |entry: DirEntry| {
            let about = entry.metadata().ok()?;
            Some((about.modified().ok()?, entry.path(), about.len()))
        };
        let mut files: Vec<(SystemTime, PathBuf, u64)> = entries
            .flatten()
            .flatten()
            .filter(|entry| entry.path().extension().is_some_and(|end| end == MATCHES))
            .filter_map(known)
            .collect();
        files.sort_by(|one, other| other.cmp(one));
        let mut left = most_bytes;
        files.retain(|(.., bytes)| {
            let rest = left.checked_sub(*bytes);
            left = rest.unwrap_or(left);
            rest.is_some()
        });
        files.into_iter().take(MOST_FILES).map(|(_, path, _)| path).collect()
    }

    /// Keeps the matches of a search, of whatever outcome, for captures that share photographs.
    fn keep_matches(&self, workspace: &Workspace, kept: &Path) -> Result<(), PipelineError> {
        let Some(file) = self.file(&self.depends_on.first) else {
            return Ok(());
        };
        match std::fs::read(kept) {
            // Poses were given, or there are no networks.
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
            Err(error) => Err(PipelineError::io(kept, error)),
            Ok(bytes) => workspace.write(&file.with_extension(MATCHES), &bytes),
        }
    }
}

/// Logs that `what` could not be cached: without the cache, a later run only takes longer.
fn or_logged(kept: Result<(), PipelineError>, what: &str, sink: &mut dyn ProgressSink) {
    if let Err(error) = kept {
        sink.log(format!("poses: {what} are not kept for later runs: {error}"));
    }
}

fn warn_of_large_coordinates(sink: &mut dyn ProgressSink, poses: &Poses) {
    let cameras: Vec<Camera> = poses.views.iter().map(|view| view.camera).collect();
    let normalisation = Normalisation::of(&cameras);
    if normalisation.left_out {
        let [x, y, z] = normalisation.offset.to_array();
        let message = format!(
            "the poses are given in large coordinates, as UTM and other georeferenced ones are, far \
             from the origin, where the 32-bit numbers of PLY files are too coarse: PLY files leave \
             out the offset {x} {y} {z}, which is to be added to their x, y and z; it is in their \
             headers and in `scene_offset` of metrics.json"
        );
        sink.warn("coordinates_large", message);
    }
}

/// Warns of what the user should know about the poses, from whatever source.
fn warn(sink: &mut dyn ProgressSink, poses: &Poses, views: &[CaptureView]) {
    let Poses { registered, total, .. } = poses;
    warn_of_large_coordinates(sink, poses);
    if poses.low_confidence {
        let observations: u32 = poses.points.iter().map(|point| point.track).sum();
        let message = format!(
            "the poses met no acceptance rule ({registered} of {total} views, {} points, {:.0} \
             observations per view, a mean track of {:.2}); check the result before you rely on it",
            poses.points.len(),
            f64::from(observations) / *registered as f64,
            poses.mean_track.unwrap_or_default(),
        );
        sink.warn("poses_low_confidence", message);
    }
    let called = |name: &str| {
        let view = views.iter().find(|view| view.name == name);
        view.map_or(name, |view| view.path.as_str()).to_owned()
    };
    let called_all = |part: &Vec<String>| part.iter().map(|name| called(name)).collect();
    let doubtful: Vec<String> = poses
        .verdicts
        .iter()
        .filter(|verdict| verdict.status == PoseStatus::Doubtful)
        .map(|verdict| called(&verdict.name))
        .collect();
    if !doubtful.is_empty() {
        let message = format!(
            "{} of {total} photographs were placed where their strongest matches contradict it and \
             were excluded: {}; photographs between them and the others would help",
            doubtful.len(),
            doubtful.join(", ")
        );
        sink.warn("poses_doubtful", message);
    }
    if !poses.parts.is_empty() {
        let message = format!(
            "the photographs show {}: only the largest is reconstructed. Make a capture of each, \
             or add photographs that connect them",
            in_words(&{ poses.parts.iter() }.map(called_all).collect::<Vec<_>>())
        );
        sink.warn("capture_in_parts", message);
    }
    if registered < total {
        let is_missing =
            |view: &&CaptureView| poses.views.iter().all(|posed| posed.name != view.name);
        let missing = views.iter().filter(is_missing);
        let missing: Vec<&str> = missing.map(|view| view.path.as_str()).collect();
        let message = format!(
            "{registered} of {total} photographs have a pose; excluded: {}",
            missing.join(", ")
        );
        sink.warn("poses_missing", message);
    }
}

/// The first look, and the second where the first found too little and a network can help.
fn find(
    context: &mut Context<'_>,
    capture: &Capture,
    tools: &mut Tools<'_>,
    cache: &Cache<'_>,
) -> Result<Poses, PipelineError> {
    let depends_on = cache.depends_on;
    let options = depends_on.first.options();
    let views: Vec<PoseView> = capture.views.iter().map(pose_view).collect();
    let work = context.workspace.folder().work();
    let earlier = cache.matches(MOST_BYTES);
    let first = ask(context, tools, &views, &work.poses(), &earlier, options.seed);
    let kept = cache.keep_matches(context.workspace, &work.poses().join(KEPT_MATCHES));
    or_logged(kept, "the matches", context.sink);
    let given = capture.poses.is_some() && options.pose_source != PoseSource::Colmap;
    let is_weak = match &first {
        Ok(poses) => poses.low_confidence,
        Err(PosesError::TooFew { .. }) => views.len() > 2,
        Err(_) => false,
    };
    if given || !is_weak {
        return Ok(first?);
    }
    // 0: nothing would be deblurred.
    let has_network = tools.networks().deblur.channels > 0;
    let best = if has_network {
        let message = format!("poses: strategy {STRATEGY}, all once more on deblurred photographs");
        context.sink.log(message);
        let second = deblurred::poses(context, tools, &views, depends_on)?;
        better(first, second, context.sink)?
    } else {
        first?
    };
    // Another network may lead to better ones.
    let network = Some(depends_on.second.fingerprint().to_owned());
    Ok(Poses { network, ..best })
}

/// What is asked about a photograph.
pub fn pose_view(view: &CaptureView) -> PoseView {
    PoseView {
        name: view.name.clone(),
        path: view.path.clone(),
        prepared: view.prepared.clone(),
        original: (view.width, view.height),
        focal_px: view.focal_px,
        mask: view.mask.clone(),
    }
}

/// The second answer where it places more photographs, or as many with more confidence.
fn better(
    first: Result<Poses, PosesError>,
    second: Result<Poses, PosesError>,
    sink: &mut dyn ProgressSink,
) -> Result<Poses, PosesError> {
    match (first, second) {
        (_, Err(PosesError::Cancelled(cancelled))) => Err(cancelled.into()),
        (first, Err(error)) => {
            sink.log(format!("poses: strategy {STRATEGY}: {error}"));
            first
        }
        (Ok(first), Ok(second)) => {
            let rank = |poses: &Poses| (!poses.low_confidence, poses.registered);
            Ok(if rank(&second) > rank(&first) { second } else { first })
        }
        (Err(_), Ok(second)) => Ok(second),
    }
}

#[cfg(test)]
mod tests;
