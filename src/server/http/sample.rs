//! `/v1/captures/sample`: a capture for users without photographs.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use axum::extract::{Extension, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use fled_core::synthetic::{SynthError, SynthOptions, generate};
use tokio::sync::Mutex;

use super::access::Visitor;
use super::problem::Problem;
use super::quota::bytes_left;
use super::shapes::Capture;
use super::upload::{Upload, check_space, to_its_end};
use crate::app::App;
use crate::error::ServerError;

/// Photographs of the sample.
const VIEWS: usize = 20;
/// Drawing a sample takes several seconds of a core, so only one runs at a time.
static TURN: Mutex<()> = Mutex::const_new(());

/// Creates a capture of a made-up dark room, with poses and ground truth.
///
/// It shows what the service does without photographs of one's own.
#[utoipa::path(post, path = "/v1/captures/sample", operation_id = "create_sample",
    tag = "captures",
    responses(
        (status = 201, description = "Stored on disk", body = Capture, headers(("Location" = String))),
        (status = 507, description = "The disk is full", body = Problem, content_type = "application/problem+json")))]
pub async fn create(
    State(app): State<Arc<App>>,
    Extension(visitor): Extension<Visitor>,
) -> Result<Response, Problem> {
    check_space(&app)?;
    let most = bytes_left(&app, &visitor).await?;
    let fields = BTreeMap::from([("name".to_owned(), "Sample: a dark room".to_owned())]);
    let upload = {
        let _turn = TURN.lock().await;
        Upload::made(&app, most, fields, draw).await?
    };
    let report = upload.examine(&app).await?;
    let row = to_its_end(async move { upload.keep(&app, &report, &visitor).await }).await?;
    let location = format!("/v1/captures/{}", row.id);
    let body = axum::Json(Capture::from_row(row));
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], body).into_response())
}

/// Writes the photographs.
fn draw(dir: &Path) -> Result<usize, Problem> {
    let options = SynthOptions { views: VIEWS, ..SynthOptions::default() };
    match generate(&options, dir) {
        Ok(summary) => Ok(summary.cameras.len()),
        Err(SynthError::Io { path, source }) => Err(ServerError::io(&path)(source).into()),
        Err(error) => {
            tracing::error!(%error, "cannot draw the sample");
            Err(Problem::internal())
        }
    }
}
