//! Jobs whose worker died.

use fled_core::pipeline::error::ErrorKind;

use crate::config::Limits;
use crate::store::{JobError, Settlement};

/// Settles a job whose server has died this many times in a row without progress. Running out of
/// memory kills the server along with the job, so such a job must not restart forever.
pub fn after_death(limits: &Limits, deaths: u32) -> Settlement {
    let again = deaths < limits.deaths_without_progress;
    // Immediately after the first death, as after a manual restart.
    let wait = match deaths {
        0 | 1 => 0,
        _ => limits.retry_wait_ms(ErrorKind::Internal, deaths - 1),
    };
    Settlement::Failed {
        error: JobError {
            code: ErrorKind::Internal.name().to_owned(),
            detail: format!("the server died {deaths} times without progress while this job ran"),
            hint: "Memory may have run out. Try a smaller `size` or `cap`, or another machine."
                .to_owned(),
        },
        retry_in_ms: again.then_some(wait),
        failures: deaths,
    }
}
