//! The text of a job's log, and the events that other parts of the server use.

use fled_core::event::{Event, Stage};

use crate::store::Settlement;

/// Returns whether an event is only for live viewers: there are too many of them for the log.
pub(super) fn is_seen(event: &Event) -> bool {
    matches!(event, Event::TrainingSeen { .. } | Event::HeldOutSeen { .. } | Event::ViewSeen { .. })
}

/// Returns whether clients may request files once they have seen this event.
pub(super) fn is_milestone(event: &Event) -> bool {
    matches!(event, Event::StageFinished { .. } | Event::RoundFinished { .. })
}

pub(super) fn readable(event: &Event) -> String {
    match event {
        Event::Planned { rounds, views, .. } => format!("planned {rounds} rounds of {views} views"),
        Event::DetailChosen { detail } => {
            format!("detail {}: {}", detail.level.name(), detail.because)
        }
        Event::StageStarted { stage, round } => format!("{} begins", place(*stage, *round)),
        Event::StageFinished { stage, round, seconds, skipped } => {
            let how = if *skipped { "already done" } else { "done" };
            format!("{} {how}, {seconds:.1} s", place(*stage, *round))
        }
        Event::RoundFinished { metrics } => {
            format!(
                "round {} done, {:.1} s, {} Gaussians",
                metrics.round, metrics.seconds, metrics.gaussians
            )
        }
        Event::StrategyStarted { strategy, name } => format!("poses: strategy {strategy}, {name}"),
        Event::OverlapFound(overlap) => {
            format!("poses: matches connect the photographs in {}", overlap.in_words())
        }
        Event::Warning { code, message } => format!("warning {code}: {message}"),
        other => format!("{other:?}"),
    }
}

/// The name of a stage in the log; the poses belong to no round.
fn place(stage: Stage, round: u32) -> String {
    if round == 0 { stage.name().to_owned() } else { format!("round {round}: {}", stage.name()) }
}

pub(super) fn closing_line(settlement: &Settlement) -> String {
    match settlement {
        Settlement::Finished { best_round } => format!("finished; round {best_round} is delivered"),
        Settlement::Filmed { bytes } => format!("finished; the video has {bytes} bytes"),
        Settlement::Stopped => "cancelled".to_owned(),
        Settlement::Released => {
            "interrupted: the server is stopping; the job continues after its restart".to_owned()
        }
        Settlement::Failed { error, retry_in_ms: Some(wait), .. } => {
            format!("failed ({}): {}; retrying in {wait} ms", error.code, error.detail)
        }
        // The hint is in the job's error, and the process has usually printed it.
        Settlement::Failed { error, .. } => {
            format!("failed ({}): {}", error.code, error.detail)
        }
    }
}
