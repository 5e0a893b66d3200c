//! The job that an address names.

use super::problem::Problem;
use crate::app::App;
use crate::store::JobRow;

/// The job, or 404.
pub(super) async fn find(app: &App, id: &str) -> Result<JobRow, Problem> {
    app.store
        .job(id)
        .await?
        .ok_or_else(|| Problem::not_found("job"))
}
