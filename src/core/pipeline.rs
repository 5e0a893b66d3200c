//! The job: Algorithm 1, its options, its workspace and its errors.
//!
//! [`run`] is a function: what it reads, what it may use, where it may write, whom to tell and
//! when to stop are its arguments. Each stage leaves its result in the [`Workspace`] with a
//! fingerprint of what it was made from, so the same call after a crash goes on from the last
//! finished stage, and inside a round from the last checkpoint.

mod brighten;
pub mod config;
pub mod error;
mod evaluate;
mod find_poses;
mod guide;
mod job;
mod judge;
mod plan;
mod result;
mod score;
mod stages;
mod tone;
mod training;
mod views;
pub mod workspace;

use std::path::PathBuf;

use crate::cancel::CancelToken;
use crate::capture::Capture;
use crate::deblur::Deblurrer;
use crate::event::ProgressSink;
use crate::metrics::Report;
use crate::poses::Sfm;

use config::Options;
use error::PipelineError;
use fled_gpu::Gpu;
use job::Job;
use training::Material;
use workspace::Workspace;

/// What a run may use.
pub struct Tools<'a> {
    /// The device that trains and renders.
    pub gpu: &'a Gpu,
    /// Who finds the poses.
    pub sfm: &'a dyn Sfm,
    /// The deblurring network, with the wrapping that the option `guide` asks for.
    pub deblurrer: &'a mut dyn Deblurrer,
    /// The network that brightens in place of the tone curve: a baseline.
    pub enhancer: Option<&'a mut dyn Deblurrer>,
    /// What was already used in place of what was asked for, one sentence each.
    pub fallbacks: Vec<String>,
    /// Folder in which poses are kept from run to run. COLMAP draws from the system's entropy,
    /// so its answer differs from run to run; a kept answer makes equal runs equal.
    pub pose_cache: Option<PathBuf>,
}

/// A finished run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What stands in `metrics.json`.
    pub report: Report,
}

/// Algorithm 1: brighten one step, deblur, train, render; let the clean renders guide the next
/// round. Symbols as in the paper: L dark views, P anchors, H enhanced, D deblurred, V scene,
/// R renders, HR guides.
///
/// # Errors
/// [`PipelineError`]; what was finished stays in the workspace and is not done again.
pub fn run(
    capture: &Capture,
    options: &Options,
    tools: &mut Tools<'_>,
    workspace: &Workspace,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<Outcome, PipelineError> {
    let mut job = Job::new(capture, options, tools, workspace, sink, cancel)?;
    let poses = job.poses()?;
    if let Some(outcome) = job.delivered() {
        return Ok(outcome);
    }
    let mut views = job.views(&poses)?; // L
    let anchors = job.anchors(&views)?; // P_1..P_N
    let target = job.enhanced(&views, anchors[anchors.len() - 1]); // H_N
    let mut guides = None; // HR
    let mut previous = None; // V_{i-1} with its curve to this round's brightness
    for (i, &anchor) in (1..).zip(&anchors) {
        let enhanced = job.enhance(i, &views, anchor)?; // H_i = E(L; P_i)
        let deblurred = job.deblur(i, &views, &enhanced, guides.as_deref())?; // D_i
        let response = job.response(&views, anchor); // f: light -> values of H_i
        let images = if options.trains_on_enhanced() {
            &enhanced
        } else {
            &deblurred
        };
        let material = Material {
            round: i,
            views: &views,
            images,
            response,
        };
        let scene = job.reconstruct(&material, &poses, previous.take())?; // V_i
        job.place(&mut views, &scene)?;
        let renders = job.render(i, &views, &scene)?; // R_i
        let next = job.match_next(i, &renders, &views, &anchors, &target)?; // P_R
        job.evaluate(
            i,
            &views,
            [&enhanced, &deblurred, &renders, &target],
            &next,
            &scene,
        )?;
        guides = Some(next.guides); // H_i+1 with the detail of HR = E(R_i; P_R)
        previous = Some((scene, next.to_next));
    }
    job.deliver()
}
