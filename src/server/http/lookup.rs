//! Lookup of a job by the id in a path, and of its finished results.

use fled_core::camera::NamedCamera;
use fled_core::run_folder::RunFolder;

use super::problem::Problem;
use crate::app::App;
use crate::error::ServerError;
use crate::store::JobRow;
use crate::store::state::JobState;

/// Returns the job, or 404.
pub(super) async fn find(app: &App, id: &str) -> Result<JobRow, Problem> {
    app.store.job(id).await?.ok_or_else(|| Problem::not_found("job"))
}

/// Returns the requested round if it is finished, or `None` for the result of a finished job.
pub(super) async fn finished(
    app: &App,
    id: &str,
    asked: Option<u32>,
) -> Result<Option<u32>, Problem> {
    let job = find(app, id).await?;
    let is_there = app.data.output(id).scene_of(asked).is_file();
    match asked {
        Some(_) if is_there => Ok(asked),
        Some(_) => Err(Problem::not_found("finished round")),
        None if job.state == JobState::Succeeded && is_there => Ok(None),
        None => Err(not_finished(job.state)),
    }
}

fn not_finished(state: JobState) -> Problem {
    let hint = if state.is_terminal() {
        "Retry it with `POST /v1/jobs/ID/retry`, or name a round that has finished."
    } else {
        "Try again once it has succeeded, or name a round that has finished."
    };
    let detail = format!("The job is {} and has no result yet.", state.name());
    Problem::conflict("not_finished", detail).hint(hint)
}

/// Returns the cameras of a finished job, or 409 if their file has been removed.
pub(super) async fn cameras_of(output: &RunFolder) -> Result<Vec<NamedCamera>, Problem> {
    let path = output.cameras();
    let text = tokio::fs::read(&path).await.map_err(|source| {
        if source.kind() == std::io::ErrorKind::NotFound {
            return Problem::conflict("no_cameras", "The cameras of this job are missing.")
                .hint("Run the capture in a new job.");
        }
        ServerError::io(&path)(source).into()
    })?;
    let cameras = serde_json::from_slice(&text)
        .map_err(|error| ServerError::Damaged { what: "cameras.json", detail: error.to_string() });
    Ok(cameras?)
}
