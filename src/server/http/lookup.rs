//! The job that an address names, and what of it is finished.

use super::problem::Problem;
use crate::app::App;
use crate::jobs::state::JobState;
use crate::store::JobRow;

/// The job, or 404.
pub(super) async fn find(app: &App, id: &str) -> Result<JobRow, Problem> {
    app.store
        .job(id)
        .await?
        .ok_or_else(|| Problem::not_found("job"))
}

/// The round that is asked for, if it is finished, or `None`, if the job is.
pub(super) async fn finished(
    app: &App,
    id: &str,
    asked: Option<u32>,
) -> Result<Option<u32>, Problem> {
    let job = find(app, id).await?;
    let is_there = app.data.output(id).scene_of(asked).is_file();
    match asked {
        Some(_) if is_there => Ok(asked),
        Some(_) => Err(Problem::not_found("round, or it is not finished")),
        None if job.state == JobState::Succeeded && is_there => Ok(None),
        None => Err(not_finished(job.state)),
    }
}

fn not_finished(state: JobState) -> Problem {
    let hint = if state.is_terminal() {
        "Let it go on with `POST /v1/jobs/ID/retry`, or name a round that it has finished."
    } else {
        "Ask again when it has succeeded, or name a round that it has finished."
    };
    let detail = format!("The job is {} and has no result yet.", state.name());
    Problem::conflict("not_finished", detail).hint(hint)
}
