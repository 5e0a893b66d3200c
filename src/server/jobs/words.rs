//! What of an attempt stands in its log, and what of it is heard by others.

use fled_core::event::{Event, Stage};

use crate::store::Settlement;

/// Whether an event is for who watches a training: in the log there would be too many of them.
pub(super) fn is_seen(event: &Event) -> bool {
    matches!(
        event,
        Event::TrainingSeen { .. } | Event::HeldOutSeen { .. } | Event::ViewSeen { .. }
    )
}

/// Whether others may ask for files once they have heard of this.
pub(super) fn is_milestone(event: &Event) -> bool {
    matches!(
        event,
        Event::StageFinished { .. } | Event::RoundFinished { .. }
    )
}

pub(super) fn readable(event: &Event) -> String {
    match event {
        Event::Planned { rounds, views } => format!("planned {rounds} rounds of {views} views"),
        Event::StageStarted { stage, round } => format!("{} begins", place(*stage, *round)),
        Event::StageFinished {
            stage,
            round,
            seconds,
            skipped,
        } => {
            let how = if *skipped { "found done" } else { "done" };
            format!("{} {how}, {seconds:.1} s", place(*stage, *round))
        }
        Event::RoundFinished { metrics } => {
            format!(
                "round {} done, {:.1} s, {} Gaussians",
                metrics.round, metrics.seconds, metrics.gaussians
            )
        }
        Event::Warning { code, message } => format!("warning {code}: {message}"),
        other => format!("{other:?}"),
    }
}

/// A stage in the log; the poses belong to no round.
fn place(stage: Stage, round: u32) -> String {
    if round == 0 {
        stage.name().to_owned()
    } else {
        format!("round {round}: {}", stage.name())
    }
}

pub(super) fn closing_line(settlement: &Settlement) -> String {
    match settlement {
        Settlement::Finished { best_round } => format!("finished; round {best_round} is delivered"),
        Settlement::Stopped => "cancelled".to_owned(),
        Settlement::Released => {
            "interrupted: the server stops; the job goes on after its restart".to_owned()
        }
        Settlement::Failed {
            error,
            retry_in_ms: Some(wait),
            ..
        } => {
            format!(
                "failed ({}): {}; again in {wait} ms",
                error.code, error.detail
            )
        }
        // The advice stands in the job's error, and the process has mostly said it, too.
        Settlement::Failed { error, .. } => {
            format!("failed ({}): {}", error.code, error.detail)
        }
    }
}
