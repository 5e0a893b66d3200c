//! The decisions of a run that depend on its machine, made first: the detail, and the size and
//! number of Gaussians that fit into memory.

use super::config::{Options, OptionsError};
use super::detail::{Chosen, choose};
use super::memory::{Fit, fit};
use crate::capture::Capture;
use crate::device::Device;
use crate::event::{Event, ProgressSink};
use crate::metrics::ChosenDetail;

/// The options of a run on its machine.
pub struct Decision<'a> {
    /// Those asked for.
    pub asked: &'a Options,
    /// Those of the run.
    pub options: Options,
    /// The detail, if it was left to the device.
    pub detail: Option<ChosenDetail>,
    /// The memory that the run needs, in words.
    need: String,
    warnings: Vec<String>,
}

/// Makes the decisions that the options leave to the machine.
///
/// # Errors
/// [`OptionsError`] as of [`choose`].
pub fn decide<'a>(
    capture: &Capture,
    asked: &'a Options,
    device: &Device,
) -> Result<Decision<'a>, OptionsError> {
    let Chosen { options, detail } = choose(asked, &device.facts())?;
    let photographs: Vec<_> = capture.views.iter().map(|view| [view.width, view.height]).collect();
    let Fit { options, need, warnings } = fit(&options, &photographs, &device.memory_room());
    Ok(Decision { asked, options, detail, need: need.in_words(), warnings })
}

impl Decision<'_> {
    /// Reports the decision to the user.
    pub fn report(&self, sink: &mut dyn ProgressSink) {
        if let Some(detail) = &self.detail {
            sink.event(&Event::DetailChosen { detail: detail.clone() });
        }
        sink.log(self.need.clone());
        for warning in &self.warnings {
            sink.warn("memory", warning.clone());
        }
    }
}
