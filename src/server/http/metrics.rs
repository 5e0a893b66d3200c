//! `/metrics`, the request counter, and the access log.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::allowance::is_reading;
use super::problem::Problem;
use crate::app::App;
use crate::telemetry::{Answered, Now};

/// OpenMetrics 1.0.
const MEDIA_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
/// Identifies an answer in the log and to the client.
const REQUEST_ID: &str = "x-request-id";

/// Returns metrics of the server: requests and their durations, jobs by state, free space.
#[utoipa::path(get, path = "/metrics", operation_id = "show_metrics", tag = "health",
    responses((status = 200, description = "Metrics in the OpenMetrics format", body = String, content_type = "application/openmetrics-text")))]
pub async fn show(State(app): State<Arc<App>>) -> Result<Response, Problem> {
    let jobs = app.store.jobs_by_state().await?;
    let jobs: Vec<_> = jobs.iter().map(|(state, count)| (state.name(), *count)).collect();
    let waits = app.store.waits(app.limits.lease).await?;
    let workers = app.store.workers().await?;
    let lost_before = app.store.now().await? - waits.lease_ms;
    let lost = workers.iter().filter(|w| w.seen_at < lost_before).count();
    let count = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
    let text = app.telemetry.text(&Now {
        jobs,
        free_bytes: app.data.free_bytes().ok(),
        lease_age: waits.lease_age,
        waiting: waits.waiting,
        workers: vec![("works", count(workers.len() - lost)), ("lost", count(lost))],
        steps: workers
            .into_iter()
            .map(|worker| {
                let speed = worker.running.iter().filter_map(|(_, speed)| *speed).sum();
                (worker.id, worker.about.host, speed)
            })
            .collect(),
    });
    Ok(([(header::CONTENT_TYPE, MEDIA_TYPE)], text).into_response())
}

/// Counts an answer and logs it: changes and failures at `info`, the rest at `debug`. Paths are
/// logged without their query, tokens never.
pub(super) async fn count(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let began = Instant::now();
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let route = request.extensions().get::<MatchedPath>();
    let route = route.map_or("none", MatchedPath::as_str).to_owned();
    let id = request.headers().get(REQUEST_ID).cloned();
    let answer = next.run(request).await;
    let took = began.elapsed();
    let status = answer.status();
    let id = id.as_ref().and_then(|id| id.to_str().ok());
    let (code, ms) = (status.as_u16(), took.as_secs_f64() * 1000.0);
    let failed = status.is_client_error() || status.is_server_error();
    if is_reading(&method) && !failed {
        tracing::debug!(%method, path, code, ms, id, "answered");
    } else {
        tracing::info!(%method, path, code, ms, id, "answered");
    }
    let answered = Answered {
        // Clients may send invented methods.
        method: known(&method).to_owned(),
        route,
        status: code,
    };
    app.telemetry.answered(&answered, took);
    answer
}

/// The name of a method; clients may invent others.
fn known(method: &Method) -> &'static str {
    const KNOWN: [&str; 7] = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"];
    let known = KNOWN.iter().find(|known| method == **known);
    known.copied().unwrap_or("other")
}
