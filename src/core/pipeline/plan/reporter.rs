//! Adds progress and time left to the events of a run.

use std::time::Instant;

use super::Plan;
use crate::event::{Event, ProgressSink};
use crate::pipeline::workspace::Workspace;

/// A sink that follows the events that it passes on.
pub struct ProgressReporter<'a> {
    sink: &'a mut dyn ProgressSink,
    workspace: &'a Workspace,
    plan: Plan,
    started: Instant,
}

impl<'a> ProgressReporter<'a> {
    /// Follows a run that begins now.
    pub fn new(sink: &'a mut dyn ProgressSink, workspace: &'a Workspace, plan: Plan) -> Self {
        Self { sink, workspace, plan, started: Instant::now() }
    }
}

impl ProgressSink for ProgressReporter<'_> {
    fn event(&mut self, event: &Event) {
        let has_changed = self.plan.take(self.started.elapsed().as_secs_f64(), event);
        let is_last = matches!(event, Event::Finished { .. });
        if !is_last {
            self.sink.event(event);
        }
        if has_changed {
            self.sink.event(&self.plan.event());
        }
        if is_last {
            if let Err(error) = self.plan.history().write(self.workspace) {
                self.sink.warn("costs", error.to_string());
            }
            self.sink.event(event);
        }
    }
}
