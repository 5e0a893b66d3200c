//! The results at the top of the run folder.

use std::fs;

use super::config::Deliver;
use super::context::Context;
use super::dependencies::Dependencies;
use super::error::PipelineError;
use super::report;
use crate::event::Event;
use crate::metrics::Report;

/// The stamp of the whole run.
const RUN: &str = "run";

/// The report of an earlier delivery with equal dependencies whose files are all there. Without
/// one, removes the stamp of any earlier delivery, because its files are about to be overwritten.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn delivered(
    context: &mut Context<'_>,
    depends_on: &Dependencies,
) -> Result<Option<Report>, PipelineError> {
    let workspace = context.workspace;
    let folder = workspace.folder();
    let finished = workspace.finished(RUN, depends_on.fingerprint());
    let report: Option<Report> = workspace.read_json(&folder.metrics());
    let report = report.filter(|_| folder.scene().is_file() && folder.cameras().is_file());
    let (Some(seconds), Some(report)) = (finished, report) else {
        workspace.unstamp(RUN)?;
        return Ok(None);
    };
    let message = "this capture was already finished with these options; its result stands";
    context.sink.log(message.to_owned());
    tell_finished(context, &report, seconds);
    Ok(Some(report))
}

/// Copies the delivered round's scene and cameras to the top of the folder.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn deliver(
    context: &mut Context<'_>,
    report: &mut Report,
    depends_on: &Dependencies,
) -> Result<(), PipelineError> {
    report::write(context, report)?;
    let (last, delivered) = (report.rounds.len() as u32, report.best_round);
    let best = report::delivered_round(&report.rounds, Deliver::Best);
    if delivered != last {
        let message =
            format!("round {last} scored worse than round {delivered}, which is delivered instead");
        context.sink.warn("round_worse", message);
    } else if best != last {
        let message = format!(
            "round {last} is delivered, as `deliver=last` asks; round {best} scored better"
        );
        context.sink.log(message);
    }
    let workspace = context.workspace;
    let delivered = workspace.folder().round(report.best_round);
    let at_target = delivered.scene_at_target();
    let scene = if at_target.exists() { at_target } else { delivered.scene() };
    // The cameras are those of that round, too: a later round has moved them a little, and may have
    // other views.
    for (from, to) in
        [(scene, workspace.folder().scene()), (delivered.cameras(), workspace.folder().cameras())]
    {
        let bytes = fs::read(&from).map_err(|e| PipelineError::io(&from, e))?;
        workspace.write(&to, &bytes)?;
    }
    let seconds = context.clock.elapsed();
    workspace.stamp(RUN, depends_on.fingerprint(), seconds)?;
    tell_finished(context, report, seconds);
    Ok(())
}

fn tell_finished(context: &mut Context<'_>, report: &Report, seconds: f64) {
    context.sink.event(&Event::Finished { best_round: report.best_round, seconds });
}
