//! The state machine of a job. [`JobState::after`] alone decides the next state; SQL only checks
//! the current one.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The state of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waiting for a worker, for the first time or again.
    Queued,
    /// A worker holds its lease.
    Running,
    /// Done.
    Succeeded,
    /// Given up; the error says why.
    Failed,
    /// Stopped on request.
    Cancelled,
}

/// An event that may change a job's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transition {
    /// A worker claimed it, or took it over after its lease had expired.
    Claimed,
    /// Its worker released it unfinished: the server stopped or was restarted.
    Released,
    /// Its process succeeded.
    Finished,
    /// Its process failed; `retry` if another attempt may help.
    Failed {
        /// Whether it is queued again.
        retry: bool,
    },
    /// Cancellation was requested.
    CancelRequested,
    /// Its process was stopped on request.
    Stopped,
    /// A retry was requested.
    Retried,
    /// A retry with other options was requested.
    Changed,
}

impl JobState {
    /// Every state.
    pub const ALL: [Self; 5] =
        [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// The state after `transition`; `None` if the transition is not allowed in this state.
    pub fn after(self, transition: Transition) -> Option<Self> {
        use Transition::{
            CancelRequested, Changed, Claimed, Failed, Finished, Released, Retried, Stopped,
        };
        match (self, transition) {
            (Self::Queued | Self::Running, Claimed) => Some(Self::Running),
            (Self::Running, Released | Failed { retry: true }) => Some(Self::Queued),
            (Self::Running, Finished) => Some(Self::Succeeded),
            (Self::Running, Failed { retry: false }) => Some(Self::Failed),
            (Self::Queued, CancelRequested) | (Self::Running, Stopped) => Some(Self::Cancelled),
            // The process has to be stopped first; the worker then reports `Stopped`.
            (Self::Running, CancelRequested) => Some(Self::Running),
            (Self::Failed | Self::Cancelled, Retried)
            | (Self::Succeeded | Self::Failed | Self::Cancelled, Changed) => Some(Self::Queued),
            _ => None,
        }
    }

    /// Returns whether the state is final unless a retry is requested.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }

    /// The name used in JSON and SQL.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Returns the state with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }
}

/// Any transition, for property tests.
#[cfg(test)]
pub(crate) fn any_transition() -> impl proptest::strategy::Strategy<Value = Transition> {
    use proptest::prelude::*;
    prop_oneof![
        Just(Transition::Claimed),
        Just(Transition::Released),
        Just(Transition::Finished),
        any::<bool>().prop_map(|retry| Transition::Failed { retry }),
        Just(Transition::CancelRequested),
        Just(Transition::Stopped),
        Just(Transition::Retried),
        Just(Transition::Changed),
    ]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn only_a_retry_leaves_a_terminal_state(
            transitions in proptest::collection::vec(any_transition(), 0..40),
        ) {
            let mut state = JobState::Queued;
            for transition in transitions {
                let next = state.after(transition);
                if state.is_terminal() {
                    let retried = transition == Transition::Changed
                        || transition == Transition::Retried && state != JobState::Succeeded;
                    prop_assert_eq!(next, retried.then_some(JobState::Queued));
                }
                if next.is_some_and(JobState::is_terminal) {
                    let cancels = transition == Transition::CancelRequested;
                    prop_assert!(state == JobState::Running || cancels);
                }
                state = next.unwrap_or(state);
            }
        }

        #[test]
        fn any_unfinished_job_can_still_be_cancelled_or_finished(
            transitions in proptest::collection::vec(any_transition(), 0..40),
        ) {
            let step = |state: JobState, by| state.after(by).unwrap_or(state);
            let state = transitions.into_iter().fold(JobState::Queued, step);
            if !state.is_terminal() {
                let running = state.after(Transition::Claimed).expect("unfinished jobs can be claimed");
                prop_assert_eq!(running.after(Transition::Stopped), Some(JobState::Cancelled));
                prop_assert_eq!(running.after(Transition::Finished), Some(JobState::Succeeded));
            }
        }
    }

    #[test]
    fn names_round_trip() {
        for state in JobState::ALL {
            assert_eq!(JobState::from_name(state.name()), Some(state));
            assert_eq!(serde_json::to_value(state).expect("plain"), state.name());
        }
        assert_eq!(JobState::from_name("done"), None);
    }
}
