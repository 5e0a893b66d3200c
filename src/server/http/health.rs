//! `/livez` and `/readyz`.

use std::sync::Arc;

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use crate::app::App;
use crate::readiness::{Check, checks};

/// Whether the server can take jobs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Readiness {
    /// Whether every check is in order.
    ready: bool,
    /// Database, disk, adapter, COLMAP, ONNX Runtime, models: each with what to do.
    checks: Vec<Check>,
}

/// Says that the server lives.
#[utoipa::path(get, path = "/livez", operation_id = "live",
    tag = "health", responses((status = 200, description = "It does", body = String)))]
pub async fn live() -> &'static str {
    "ok\n"
}

/// Says whether the server can take jobs, and what is missing.
#[utoipa::path(get, path = "/readyz", operation_id = "ready", tag = "health",
    responses(
        (status = 200, description = "Everything is in order", body = Readiness),
        (status = 503, description = "Something is missing", body = Readiness)))]
pub async fn ready(State(app): State<Arc<App>>) -> Response {
    let checks = checks(&app).await;
    let ready = checks.iter().all(|check| check.ok);
    let status = if ready {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    (status, axum::Json(Readiness { ready, checks })).into_response()
}
