//! `/v1/jobs/{id}/log`.

use std::sync::Arc;

use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::extract::Query;
use super::lookup::find;
use super::page::within;
use super::problem::Problem;
use crate::app::App;
use crate::error::ServerError;
use crate::worker::log::read_page;

/// Maximum lines of a page.
const LARGEST_PAGE: usize = 5000;

/// Which part of the log.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct LogQuery {
    /// `next_offset` of the previous page.
    offset: Option<u64>,
    /// Maximum number of lines; 1000 by default.
    #[param(minimum = 1, maximum = 5000)]
    limit: Option<usize>,
}

/// A page of a job's log.
#[derive(Debug, Serialize, ToSchema)]
pub struct LogPage {
    /// Lines, oldest first.
    lines: Vec<String>,
    /// `offset` of the next page.
    next_offset: u64,
    /// Whether there are no more lines for now.
    end: bool,
}

/// Shows a page of the job's log.
///
/// The log holds the output of the job's process and its tools over all attempts.
#[utoipa::path(get, path = "/v1/jobs/{id}/log", operation_id = "show_log",
    tag = "results", params(("id" = String, Path), LogQuery),
    responses(
        (status = 200, description = "One page of results", body = LogPage),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid page parameters", body = Problem, content_type = "application/problem+json")))]
pub async fn show(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Query(query): Query<LogQuery>,
) -> Result<axum::Json<LogPage>, Problem> {
    find(&app, &id).await?;
    let path = app.data.log(&id);
    let (offset, limit) = (query.offset.unwrap_or(0), query.limit.unwrap_or(1000));
    within(limit, LARGEST_PAGE)?;
    if offset > i64::MAX as u64 {
        // No log is that long, and not every client can represent such a number exactly.
        return Err(Problem::unprocessable("bad_input", "`offset` is too large for any log.")
            .pointer("/offset"));
    }
    let read = {
        let path = path.clone();
        tokio::task::spawn_blocking(move || read_page(&path, offset, limit)).await
    };
    let page = read.map_err(|_| Problem::internal())?.map_err(ServerError::io(&path))?;
    Ok(axum::Json(LogPage { lines: page.lines, next_offset: page.next_offset, end: page.end }))
}
