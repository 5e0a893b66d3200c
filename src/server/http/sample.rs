//! `/v1/captures/sample`: a capture for users without photographs.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use axum::extract::{Extension, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use rust_embed::RustEmbed;

use super::access::Visitor;
use super::problem::Problem;
use super::quota::bytes_left;
use super::shapes::Capture;
use super::upload::{Upload, check_space, to_its_end};
use crate::app::App;
use crate::error::ServerError;

/// The files of the sample, drawn by `tools/make_sample.sh`.
#[derive(RustEmbed)]
#[folder = "sample"]
struct Sample;

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
    let upload = Upload::made(&app, most, fields, write).await?;
    let report = upload.examine(&app).await?;
    let row = to_its_end(async move { upload.keep(&app, &report, &visitor).await }).await?;
    let location = format!("/v1/captures/{}", row.id);
    let body = axum::Json(Capture::from_row(row));
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], body).into_response())
}

/// Writes the files and returns their number.
fn write(dir: &Path) -> Result<usize, Problem> {
    let mut files = 0;
    for name in Sample::iter() {
        let Some(file) = Sample::get(&name) else { continue };
        let path = dir.join(&*name);
        let folder = path.parent().unwrap_or(dir);
        std::fs::create_dir_all(folder).map_err(ServerError::io(folder))?;
        std::fs::write(&path, file.data).map_err(ServerError::io(&path))?;
        files += 1;
    }
    Ok(files)
}
