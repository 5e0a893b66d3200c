//! `/v1/work/workers/{worker}/errand`: views and videos that a replica asks of a worker that
//! reaches the service by HTTP alone.

use std::sync::Arc;
use std::time::Duration;

use axum::Json as Answer;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use tokio::time::Instant;

use super::extract::Json;
use super::problem::Problem;
use super::work::name;
use crate::app::App;
use crate::coordinator::{
    Awaited, Errand, Headway, Outcome, Willing, answer_errand, milliseconds, take_errand,
};
use crate::store::errands_bell;

/// A worker that asks when there is nothing to do is answered after so long: it waits a little
/// longer.
const WAIT: Duration = Duration::from_secs(10);

/// What is asked of a worker; waits some seconds until something is.
#[utoipa::path(post, path = "/v1/work/workers/{worker}/errand", operation_id = "take_errand",
    tag = "work", params(("worker" = String, Path)), request_body = Willing,
    responses(
        (status = 200, description = "This", body = Errand),
        (status = 204, description = "There is nothing")))]
pub async fn next(
    State(app): State<Arc<App>>,
    Path(worker): Path<String>,
    Json(Willing { kind }): Json<Willing>,
) -> Result<Response, Problem> {
    let worker = name(&worker)?;
    let bell = app.bells.of(&errands_bell(&worker, kind.name()));
    let until = Instant::now() + WAIT;
    loop {
        let taken = take_errand(&app.store, &app.limits, &worker, kind).await?;
        if let Some(errand) = taken {
            return Ok(Answer(errand).into_response());
        }
        let now = Instant::now();
        if now >= until || app.shutdown.is_cancelled() {
            return Ok(StatusCode::NO_CONTENT.into_response());
        }
        tokio::select! {
            () = bell.notified() => {}
            () = tokio::time::sleep(app.limits.look.min(until - now)) => {}
            () = app.shutdown.cancelled() => {}
        }
    }
}

/// A worker still does it, and so far it is.
#[utoipa::path(put, path = "/v1/work/workers/{worker}/errands/{errand}",
    operation_id = "extend_errand", tag = "work",
    params(("worker" = String, Path), ("errand" = String, Path)), request_body = Headway,
    responses((status = 200, description = "Whether to go on", body = Awaited)))]
pub async fn extend(
    State(app): State<Arc<App>>,
    Path((worker, errand)): Path<(String, String)>,
    Json(headway): Json<Headway>,
) -> Result<Answer<Awaited>, Problem> {
    let (headway, life) = (
        (headway.done, headway.total),
        milliseconds(app.limits.errand),
    );
    let worker = name(&worker)?;
    let awaited = app.store.extend_errand(&errand, &worker, headway, life);
    let awaited = awaited.await?;
    Ok(Answer(Awaited { awaited }))
}

/// What came of it.
#[utoipa::path(post, path = "/v1/work/workers/{worker}/errands/{errand}/outcome",
    operation_id = "answer_errand", tag = "work",
    params(("worker" = String, Path), ("errand" = String, Path)), request_body = Outcome,
    responses((status = 204, description = "Whoever still waits for it has it")))]
pub async fn answer(
    State(app): State<Arc<App>>,
    Path((worker, errand)): Path<(String, String)>,
    Json(outcome): Json<Outcome>,
) -> Result<StatusCode, Problem> {
    answer_errand(&app.store, &name(&worker)?, &errand, &outcome).await?;
    app.bells.ring(&errand);
    Ok(StatusCode::NO_CONTENT)
}
