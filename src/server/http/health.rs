//! `/livez` and `/readyz`.

use std::sync::Arc;

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use crate::app::App;
use crate::app::readiness::{Check, checks};

/// Name of the check of workers.
const WORKERS: &str = "workers";

/// Whether the server can take jobs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Readiness {
    /// Whether every check but `workers` passed: without a worker, jobs are accepted and wait.
    ready: bool,
    /// Checks of the database, disk, workers, adapter, COLMAP, ONNX Runtime and models.
    checks: Vec<Check>,
    /// Whether this machine has a GPU; absent if that is unknown, or if jobs also run elsewhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    has_gpu: Option<bool>,
}

/// Reports that the server is alive.
#[utoipa::path(get, path = "/livez", operation_id = "live",
    tag = "health", responses((status = 200, description = "The server is alive", body = String)))]
pub async fn live() -> &'static str {
    "ok\n"
}

/// Reports whether the server can take jobs, and what is missing.
#[utoipa::path(get, path = "/readyz", operation_id = "ready", tag = "health",
    responses(
        (status = 200, description = "Every check but `workers` passed", body = Readiness),
        (status = 503, description = "Another check failed", body = Readiness)))]
pub async fn ready(State(app): State<Arc<App>>) -> Response {
    let (checks, has_gpu) = checks(&app).await;
    let ready = checks.iter().all(|check| check.ok || check.name == WORKERS);
    let status = if ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (status, axum::Json(Readiness { ready, checks, has_gpu })).into_response()
}
