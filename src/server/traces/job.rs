//! An attempt at a job with its stages, in the trace of the request that made the job, on whatever
//! machine it runs.

use fled_core::event::{Event, Stage};
use opentelemetry::trace::{Span, Status, TraceContextExt, Tracer};
use opentelemetry::{Context, KeyValue};
use opentelemetry_sdk::trace::{SdkTracer, Span as SdkSpan};

use super::{Traces, parent};
use crate::store::{JobRow, Settlement};

/// An attempt, where anybody asks for traces. One that is dropped has lost its lease.
#[derive(Debug)]
pub struct AttemptTrace(Option<Under>);

#[derive(Debug)]
struct Under {
    tracer: SdkTracer,
    attempt: Context,
    stage: Option<(Stage, u32, SdkSpan)>,
    outcome: &'static str,
}

impl AttemptTrace {
    /// Begins the span of an attempt.
    pub fn begin(traces: &Traces, job: &JobRow, worker: &str) -> Self {
        let begin = |tracer: &SdkTracer| {
            let parent = parent::of(job.traceparent.as_deref());
            let span = tracer.span_builder("attempt").with_attributes([
                KeyValue::new("fled.job", job.id.clone()),
                KeyValue::new("fled.preset", job.preset.clone()),
                KeyValue::new("fled.attempt", i64::from(job.attempts)),
                KeyValue::new("fled.worker", worker.to_owned()),
            ]);
            let span = span.start_with_context(tracer, &parent);
            Under {
                tracer: tracer.clone(),
                attempt: parent.with_span(span),
                stage: None,
                outcome: "lost",
            }
        };
        Self(traces.tracer().map(begin))
    }

    /// Begins and ends the spans of its stages.
    pub fn told(&mut self, event: &Event) {
        let Some(under) = &mut self.0 else {
            return;
        };
        match event {
            Event::StageStarted { stage, round } => under.begin(*stage, *round),
            Event::StageFinished {
                stage,
                round,
                skipped,
                ..
            } => under.finish(*stage, *round, *skipped),
            _ => {}
        }
    }

    /// Ends it.
    pub fn end(mut self, settlement: &Settlement) {
        let Some(under) = &mut self.0 else {
            return;
        };
        let attempt = under.attempt.span();
        under.outcome = match settlement {
            Settlement::Finished { best_round } => {
                attempt.set_attribute(KeyValue::new("fled.best_round", i64::from(*best_round)));
                "succeeded"
            }
            Settlement::Failed {
                error, retry_in_ms, ..
            } => {
                // Its name; its words may have paths in them.
                attempt.set_attribute(KeyValue::new("error.type", error.code.clone()));
                attempt.set_status(Status::error(error.code.clone()));
                match retry_in_ms {
                    Some(_) => "failed, again",
                    None => "failed",
                }
            }
            Settlement::Stopped => "cancelled",
            Settlement::Released => "released",
        };
    }
}

impl Under {
    fn begin(&mut self, stage: Stage, round: u32) {
        let span = self
            .tracer
            .span_builder(stage.name())
            .with_attributes([KeyValue::new("fled.round", i64::from(round))]);
        let span = span.start_with_context(&self.tracer, &self.attempt);
        // One that is replaced ends here.
        self.stage = Some((stage, round, span));
    }

    fn finish(&mut self, stage: Stage, round: u32, skipped: bool) {
        let runs = self.stage.take();
        if let Some((_, _, mut span)) = runs.filter(|runs| (runs.0, runs.1) == (stage, round)) {
            span.set_attribute(KeyValue::new("fled.skipped", skipped));
            span.end();
        }
    }
}

impl Drop for Under {
    fn drop(&mut self) {
        if let Some((_, _, mut span)) = self.stage.take() {
            span.set_status(Status::error("it did not end"));
            span.end();
        }
        let attempt = self.attempt.span();
        attempt.set_attribute(KeyValue::new("fled.outcome", self.outcome));
        attempt.end();
    }
}
