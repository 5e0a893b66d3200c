//! Structure from motion with COLMAP, run as a subprocess: Debian's 3.8 to 4.x.
//!
//! COLMAP receives private copies of the dark originals, brightened by one gain per photograph
//! ([`copies`]), and is run with fallback [`strategies`] until a model is good enough. It is random
//! even with a seed and on one thread, so two runs differ in the last digits and, on hard captures,
//! in the number of registered photographs.

mod candidate;
mod consistency;
mod copies;
mod exposure;
mod files;
mod groups;
mod learned;
mod options;
mod process;
mod refine;
mod search;
mod strategies;
mod triangulate;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::cancel::CancelToken;
use crate::capture::MIN_VIEWS;
use crate::event::ProgressSink;
use crate::poses::matching::Matching;
use crate::poses::{PoseRequest, PosedView, Poses, PosesError, Sfm, SparsePoint};
pub(crate) use exposure::brightened;
pub use process::Limits;
pub use strategies::Acceptance;

/// COLMAP's command line as an [`Sfm`].
#[derive(Clone)]
pub struct ColmapCli {
    program: PathBuf,
    guarded: Vec<OsString>,
    limits: Limits,
    acceptance: Acceptance,
    matching: Option<Arc<dyn Matching>>,
}

impl Default for ColmapCli {
    fn default() -> Self {
        Self::new("colmap")
    }
}

impl ColmapCli {
    /// Runs `program`: a path, or a name looked up by the system.
    pub fn new(program: impl Into<PathBuf>) -> Self {
        Self {
            program: program.into(),
            guarded: Vec::new(),
            limits: Limits::default(),
            acceptance: Acceptance::default(),
            matching: None,
        }
    }

    /// Sets the command that starts the program in a process that ends with this one.
    #[must_use]
    pub fn guarded_by(self, guarded: Vec<OsString>) -> Self {
        Self { guarded, ..self }
    }

    /// Sets the time limits.
    #[must_use]
    pub fn with_limits(self, limits: Limits) -> Self {
        Self { limits, ..self }
    }

    /// Sets a source of key points and matches that is tried before COLMAP's own.
    #[must_use]
    pub fn with_matching(self, matching: Arc<dyn Matching>) -> Self {
        Self { matching: Some(matching), ..self }
    }

    /// COLMAP's version, such as `3.8`, as shown by `fled doctor`.
    ///
    /// # Errors
    /// [`PosesError::Missing`] if there is no such program, [`PosesError::Tool`] if it is not
    /// COLMAP.
    pub fn version(&self) -> Result<String, PosesError> {
        let limits = Limits { wall: Duration::from_secs(30), ..self.limits };
        let runner = process::Runner::new(&self.program, &[], limits, None)?;
        version(&runner, &CancelToken::new())
    }

    /// Runs COLMAP for a request, with a log in its folder.
    fn runner(&self, request: &PoseRequest<'_>) -> Result<process::Runner, PosesError> {
        std::fs::create_dir_all(request.work_dir).map_err(PosesError::io(request.work_dir))?;
        let log = request.work_dir.join("colmap.log");
        process::Runner::new(&self.program, &self.guarded, self.limits, Some(&log))
    }

    /// Sparse points for views of the request with known poses.
    ///
    /// # Errors
    /// [`PosesError`]: COLMAP is missing or failed, a photograph cannot be read, or the caller
    /// cancelled.
    pub fn triangulate(
        &self,
        request: &PoseRequest<'_>,
        posed: &[PosedView],
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Vec<SparsePoint>, PosesError> {
        let runner = self.runner(request)?;
        let version = version(&runner, cancel)?;
        let points = search::Search::new(&runner, request, self.acceptance, None)
            .triangulate(posed, cancel)?;
        let (points_found, views) = (points.len(), posed.len());
        sink.log(format!(
            "poses: COLMAP {version} triangulated {points_found} points in {views} given views"
        ));
        Ok(points)
    }

    /// Better poses than the `given` ones, in their world and at their scale, for the views of the
    /// request that have one or can be placed. `None` if the given ones fit the photographs as well
    /// as any that are found, or if there are no networks to check them.
    ///
    /// # Errors
    /// [`PosesError`], as [`Sfm::poses`].
    pub fn refine(
        &self,
        request: &PoseRequest<'_>,
        given: &[PosedView],
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Poses>, PosesError> {
        let start = Instant::now();
        if self.matching.is_none() || request.views.len() < MIN_VIEWS {
            return Ok(None);
        }
        let runner = self.runner(request)?;
        let version = version(&runner, cancel)?;
        let search =
            search::Search::new(&runner, request, self.acceptance, self.matching.as_deref());
        let poses = search.refine(given, sink, cancel)?;
        Ok(poses.map(|poses| Poses {
            source: format!("given, refined by colmap {version}"),
            seconds: start.elapsed().as_secs_f64(),
            ..poses
        }))
    }
}

impl Sfm for ColmapCli {
    fn poses(
        &self,
        request: &PoseRequest<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError> {
        let start = Instant::now();
        let total = request.views.len();
        if total < MIN_VIEWS {
            let advice =
                format!("a scene needs at least {} photographs, preferably 20 to 60", MIN_VIEWS);
            return Err(PosesError::TooFew { registered: 0, total, advice });
        }
        let runner = self.runner(request)?;
        let version = version(&runner, cancel)?;
        sink.log(format!("poses: COLMAP {version} on {total} photographs"));
        let search =
            search::Search::new(&runner, request, self.acceptance, self.matching.as_deref());
        let poses = search.run(sink, cancel)?;
        Ok(Poses {
            source: format!("colmap {version}"),
            seconds: start.elapsed().as_secs_f64(),
            ..poses
        })
    }

    fn describe(&self) -> String {
        let by = self
            .matching
            .as_ref()
            .map_or_else(String::new, |matching| format!(", {}", matching.describe()));
        format!("colmap {}{by}", Path::new(&self.program).display())
    }
}

/// The version from the first line of `colmap help`, which every release prints.
fn version(runner: &process::Runner, cancel: &CancelToken) -> Result<String, PosesError> {
    let finished = runner.run("help", &[], cancel)?;
    let text = finished.text();
    text.split_once("COLMAP ")
        .and_then(|(_, rest)| rest.split_ascii_whitespace().next())
        .map(str::to_owned)
        .ok_or_else(|| finished.failure("help"))
}

#[cfg(test)]
mod tests;
