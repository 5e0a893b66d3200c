//! The decisions of a run that depend on its machine, made first: the detail, and the size and
//! numbers of Gaussians and steps that time and memory allow.

use super::config::Options;
use super::context::Context;
use super::detail::{Chosen, choose};
use super::error::PipelineError;
use super::memory::{Fit, fit};
use super::minutes::TimeLimit;
use super::plan::Forecast;
use super::workspace::Workspace;
use crate::capture::Capture;
use crate::device::Device;
use crate::event::Event;
use crate::metrics::ChosenDetail;

/// The options of a run on its machine.
pub struct Decision<'a> {
    /// Those asked for.
    pub asked: &'a Options,
    /// Those of the run.
    pub options: Options,
    /// The detail, if it was left to the device.
    pub detail: Option<ChosenDetail>,
    /// The time limit, if there is one.
    pub time: Option<TimeLimit>,
    /// The memory that the run needs, in words.
    need: String,
    warnings: Vec<String>,
}

/// Makes the decisions that the options leave to the machine.
///
/// # Errors
/// Those of [`choose`] and [`TimeLimit::choose`].
pub fn decide<'a>(
    capture: &Capture,
    asked: &'a Options,
    device: &Device,
    forecast: &Forecast,
    workspace: &Workspace,
) -> Result<Decision<'a>, PipelineError> {
    let Chosen { options, detail } = choose(asked, &device.facts())?;
    let time = TimeLimit::choose(&options, capture, device, forecast, workspace)?;
    let options = time.as_ref().map_or_else(|| options.clone(), |time| time.options(&options));
    let room = device.memory_room();
    let Fit { options, need, warnings } = fit(&options, forecast.sizes(), &room);
    Ok(Decision { asked, options, detail, time, need: need.in_words(), warnings })
}

impl Decision<'_> {
    /// Reports the decision to the user.
    pub fn report(&self, context: &mut Context<'_>) {
        if let Some(detail) = &self.detail {
            context.sink.event(&Event::DetailChosen { detail: detail.clone() });
        }
        if let Some(time) = &self.time {
            time.report(context);
        }
        context.sink.log(self.need.clone());
        for warning in &self.warnings {
            context.sink.warn("memory", warning.clone());
        }
    }
}
