//! `/v1/captures/sample`: a finished job for users without photographs.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::extract::{Extension, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use fled_core::pipeline::config::Preset;

use super::access::Visitor;
use super::order::Order;
use super::priority::Priority;
use super::problem::Problem;
use super::quota::bytes_left;
use super::shapes::Capture;
use super::upload::{Upload, check_space, put, to_its_end};
use crate::app::App;
use crate::error::ServerError;
use crate::files::data::{bytes_below, log_in, output_in};
use crate::files::incoming::Incoming;
use crate::files::remove;
use crate::sample;
use crate::store::Ended;

/// Creates a capture of a made-up dark room, with poses and ground truth, and its finished job.
///
/// It shows what the service does before one has taken photographs. The result was recorded and
/// ships with the server; a warning on the job says so. Webhooks report it like that of a run.
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
    let recorded = sample::recording().map_err(|error| {
        tracing::error!(%error, "the sample");
        Problem::internal()
    })?;
    let (result, bytes) = write_result(&app, recorded.best_round).await?;
    let fields = BTreeMap::from([("name".to_owned(), sample::NAME.to_owned())]);
    let upload = Upload::made(&app, most, bytes, fields, sample::write_capture).await?;
    let report = upload.examine(&app).await?;
    let preset = Some(Preset::Auto.name());
    let order = Order::new(&app, preset, &recorded.options, Priority::default()).await?;
    let row = to_its_end(async move {
        let placed = upload.place(&app, &report, &visitor).await?;
        let job = order.job(&app, &placed.row.id, sample::NAME)?;
        let folder = app.data.job(&job.id);
        let stored = async {
            let files = put(&app, &result, &folder).await?;
            let (events, best_round) = (&recorded.events[..], recorded.best_round);
            let ended = Ended { job: &job, files: &files, events, best_round };
            Ok(app.store.insert_ended(&placed.row, &placed.kept, ended).await?)
        };
        if let Err(problem) = stored.await {
            remove(&folder).await;
            placed.give_up().await;
            return Err(problem);
        }
        Ok(placed.finish(&app).await)
    })
    .await?;
    let location = format!("/v1/captures/{}", row.id);
    let body = axum::Json(Capture::from_row(row));
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], body).into_response())
}

/// Writes the folder of the job, and returns it with its size in bytes.
async fn write_result(app: &App, delivered: u32) -> Result<(Arc<Incoming>, u64), Problem> {
    let incoming = app.data.incoming();
    let folder = app.uploads.begin(&incoming).map_err(ServerError::io(&incoming))?;
    let written = tokio::task::spawn_blocking({
        let folder = folder.clone();
        move || {
            let run = output_in(folder.path());
            sample::write_result(&run, delivered)?;
            std::fs::copy(run.log(), log_in(folder.path()))?;
            bytes_below(folder.path())
        }
    });
    let bytes = written.await.map_err(|_| Problem::internal())?;
    Ok((folder.clone(), bytes.map_err(ServerError::io(folder.path()))?))
}
