//! `/v1/jobs/{id}/exports`: a finished result in the formats of other programs, created while it is
//! sent.

use std::ffi::OsString;
use std::io::{self, Write};
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use fled_core::export::{Export, ExportError, MOST_SH_DEGREE, Prepared, Trim};
use fled_core::gaussians::crop::Crop;
use fled_core::mesh::Detail;
use fled_core::run_folder::RunFolder;
use futures::stream::{self, StreamExt, poll_fn};
use serde::{Deserialize, Serialize};
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use utoipa::{IntoParams, ToSchema};

use super::extract::Query;
use super::lookup::finished;
use super::meshes;
use super::problem::Problem;
use crate::app::App;
use crate::redaction::without_paths;

/// Bytes per chunk.
const PIECE: usize = 1 << 16;

/// Chunks buffered for a slow client.
const WAITING: usize = 4;

/// Seconds after which a slot may be free.
const RETRY: u32 = 10;

/// Of what.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ExportQuery {
    /// Round to use; by default the delivered one.
    round: Option<u32>,
}

/// Of what, and how much of it.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct DownloadQuery {
    /// Round to use; by default the delivered one.
    round: Option<u32>,
    /// Keeps only the Gaussians whose centres lie in a shape around X, Y, Z:
    /// `box:X,Y,Z,WIDTH,HEIGHT,DEPTH` or `sphere:X,Y,Z,RADIUS`, in the world of the poses.
    #[param(example = "sphere:0,0,2,3")]
    crop: Option<String>,
    /// Degree of a scene's harmonics: they are cut, or padded with zeros.
    #[param(minimum = 0, maximum = 3)]
    sh_degree: Option<u32>,
    /// Multiplies all lengths, for example by the metres of a unit of the poses' world: in the node
    /// of `scene.glb`, `scene.usda` and `mesh.glb`, elsewhere in the coordinates themselves.
    scale: Option<f64>,
    /// Most triangles of a mesh: its voxels grow until it has no more; 200,000 by default, or any
    /// number with `voxel`.
    triangles: Option<usize>,
    /// Side of a mesh's voxels, in units of the poses' world; by default three pixels of the views
    /// at the scene's median depth.
    voxel: Option<f64>,
}

impl DownloadQuery {
    fn trim(&self) -> Result<Trim, Problem> {
        let crop = crop_of(self.crop.as_deref())?;
        if let Some(degree) = self.sh_degree
            && degree > MOST_SH_DEGREE
        {
            let fault = format!("`sh_degree` must be from 0 to {MOST_SH_DEGREE}");
            return Err(unusable("sh_degree", &fault));
        }
        let scale = self.scale.map(Trim::scale).transpose();
        let scale = scale.map_err(|fault| unusable("scale", &format!("`scale` {fault}")))?;
        let triangles = self.triangles.map(Detail::triangles).transpose();
        let triangles =
            triangles.map_err(|fault| unusable("triangles", &format!("`triangles` {fault}")))?;
        let voxel = self.voxel.map(Detail::voxel).transpose();
        let voxel = voxel.map_err(|fault| unusable("voxel", &format!("`voxel` {fault}")))?;
        Ok(Trim { crop, sh_degree: self.sh_degree, scale, mesh: Detail { triangles, voxel } })
    }

    /// The arguments of `fled export`.
    fn arguments(&self, run: &RunFolder, export: Export) -> Vec<OsString> {
        let mut arguments = vec![run.root().into(), export.name().into()];
        let mut add = |name: &str, value: Option<String>| {
            arguments.extend(value.map(|value| format!("--{name}={value}").into()));
        };
        add("round", self.round.map(|round| round.to_string()));
        add("crop", self.crop.clone());
        add("scale", self.scale.map(|scale| scale.to_string()));
        add("triangles", self.triangles.map(|triangles| triangles.to_string()));
        add("voxel", self.voxel.map(|voxel| voxel.to_string()));
        arguments
    }
}

/// Reads the crop of a request.
///
/// # Errors
/// 422 if it is not a crop.
pub(super) fn crop_of(text: Option<&str>) -> Result<Option<Crop>, Problem> {
    text.map(str::parse).transpose().map_err(|fault: String| unusable("crop", &fault))
}

fn unusable(key: &str, fault: &str) -> Problem {
    Problem::unprocessable("bad_input", format!("{fault}.")).pointer(format!("/{key}"))
}

/// A format in which the result can be exported.
#[derive(Debug, Serialize, ToSchema)]
pub struct ExportForm {
    /// Last part of its address.
    name: &'static str,
    /// What the format is, and for whom.
    about: &'static str,
    /// Approximate size, bytes.
    bytes: u64,
    /// Whether it holds the scene or a mesh of it, so that `crop` and `scale` apply.
    has_scene: bool,
}

/// The formats in which the result can be exported.
#[derive(Debug, Serialize, ToSchema)]
pub struct Exports {
    /// The available formats.
    exports: Vec<ExportForm>,
}

/// Lists the formats in which the result can be exported.
#[utoipa::path(get, path = "/v1/jobs/{id}/exports", operation_id = "list_exports",
    tag = "results", params(("id" = String, Path), ExportQuery),
    responses(
        (status = 200, description = "The formats", body = Exports),
        (status = 404, description = "Job or round not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job is not finished", body = Problem, content_type = "application/problem+json")))]
pub async fn list(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Query(query): Query<ExportQuery>,
) -> Result<axum::Json<Exports>, Problem> {
    let round = finished(&app, &id, query.round).await?;
    let output = app.data.output(&id);
    let exports = tokio::task::spawn_blocking(move || {
        let form = |export: Export| match export.prepare(&output, round, Trim::default()) {
            Ok(prepared) => Some(ExportForm {
                name: export.name(),
                about: export.about(),
                bytes: prepared.bytes(),
                has_scene: export.has_scene(),
            }),
            Err(error) => {
                tracing::info!(%error, export = export.name(), "an export is not available");
                None
            }
        };
        Export::ALL.into_iter().filter_map(form).collect()
    });
    let exports = exports.await.map_err(|_| Problem::internal())?;
    Ok(axum::Json(Exports { exports }))
}

/// Exports the result in one format.
///
/// The file is made while it is sent, so its length is unknown and ranges are not supported. A mesh
/// is sent once it is made; one is made at a time.
#[utoipa::path(get, path = "/v1/jobs/{id}/exports/{name}", operation_id = "download_export",
    tag = "results",
    params(("id" = String, Path), ("name" = String, Path, description = "Name as listed"), DownloadQuery),
    responses(
        (status = 200, description = "The file", body = serde_json::Value, content_type = "*/*"),
        (status = 404, description = "Job, format or round not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job is not finished, or lacks files that the export needs", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "`crop`, `sh_degree`, `scale`, `triangles` or `voxel` cannot be used, this export has no scene, or a mesh takes too much time or memory (`too_large`)", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "Too many files are being made", body = Problem, content_type = "application/problem+json")))]
pub async fn download(
    State(app): State<Arc<App>>,
    Path((id, name)): Path<(String, String)>,
    Query(query): Query<DownloadQuery>,
) -> Result<Response, Problem> {
    let export: Export = name
        .parse()
        .map_err(|known: String| Problem::not_found("export").hint(format!("{known}.")))?;
    let trim = query.trim()?;
    let round = finished(&app, &id, query.round).await?;
    // Compression holds a whole scene in memory.
    let turn = turn(&app)?;
    let output = app.data.output(&id);
    // The slot goes with the work, which goes on if the client leaves.
    let prepare = move || export.prepare(&output, round, trim).map(|prepared| (prepared, turn));
    let prepared = tokio::task::spawn_blocking(prepare);
    let prepared = prepared.await.map_err(|_| Problem::internal())?;
    let (prepared, turn) = prepared.map_err(|error| refused(&error))?;
    let headers = [
        (header::CONTENT_TYPE, media_type(export).to_owned()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{}\"", export.name())),
    ];
    if export.is_mesh() {
        // Other exports need not wait for it.
        drop((prepared, turn));
        let arguments = query.arguments(&app.data.output(&id), export);
        let made = meshes::make(&app, arguments).await?;
        return Ok((headers, made).into_response());
    }
    let (sender, mut pieces) = mpsc::channel(WAITING);
    let work = tokio::task::spawn_blocking(move || {
        let made = make(&prepared, &sender, &id);
        drop(turn);
        made
    });
    // A failure before the first byte is still answered with its reason.
    let first = pieces.recv().await;
    if let Some(Err(_)) = first {
        work.await.map_err(|_| Problem::internal())?.map_err(|error| refused(&error))?;
    }
    let rest = poll_fn(move |context| pieces.poll_recv(context));
    Ok((headers, Body::from_stream(stream::iter(first).chain(rest))).into_response())
}

/// A slot for a streamed file, which occupies a thread as long as the client reads.
pub(super) fn turn(app: &App) -> Result<OwnedSemaphorePermit, Problem> {
    app.exporting.clone().try_acquire_owned().map_err(|_| busy())
}

/// A response body that `make` generates while it is sent.
pub(super) fn body_of(make: impl FnOnce(&Pieces) + Send + 'static) -> Body {
    let (sender, mut pieces) = mpsc::channel(WAITING);
    tokio::task::spawn_blocking(move || make(&sender));
    Body::from_stream(poll_fn(move |context| pieces.poll_recv(context)))
}

/// Writes the export into the response. An error aborts the response, so that the client does not
/// take it for complete.
fn make(prepared: &Prepared, pieces: &Pieces, job: &str) -> Result<(), ExportError> {
    let pipe = io::BufWriter::with_capacity(PIECE, Pipe(pieces));
    let made = prepared.write(pipe);
    match &made {
        // The client has disconnected.
        Err(ExportError::Write(_)) if pieces.is_closed() => {}
        Err(error) => {
            if !error.is_of_wish() {
                tracing::error!(%error, job, "an export was interrupted");
            }
            // If the client has also disconnected, there is no receiver for the error.
            let _ = pieces.blocking_send(Err(io::Error::other("the export was interrupted")));
        }
        Ok(()) => {}
    }
    made
}

/// Sends the chunks of a response.
pub(super) type Pieces = mpsc::Sender<io::Result<Bytes>>;

/// Writes into a response.
pub(super) struct Pipe<'a>(pub &'a Pieces);

impl Write for Pipe<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let piece = Bytes::copy_from_slice(&bytes[..bytes.len().min(PIECE)]);
        let length = piece.len();
        let gone = |_| io::Error::from(io::ErrorKind::BrokenPipe);
        self.0.blocking_send(Ok(piece)).map_err(gone)?;
        Ok(length)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn media_type(export: Export) -> &'static str {
    match export {
        Export::Restored | Export::Linear | Export::Colmap | Export::Sog => "application/zip",
        Export::Ply
        | Export::CompressedScene
        | Export::SpzVersion3
        | Export::Spz
        | Export::MeshPly => "application/octet-stream",
        Export::Gltf | Export::MeshGltf => "model/gltf-binary",
        Export::Usd => "model/vnd.usda",
        Export::Transforms | Export::InriaCameras => "application/json",
    }
}

pub(super) fn busy() -> Problem {
    let detail = "Too many files are being made.";
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", detail)
        .hint("Try again in a moment.")
        .retry_after(RETRY)
}

fn refused(error: &ExportError) -> Problem {
    if error.is_missing() {
        let detail = "This job lacks files that this export needs.";
        return Problem::conflict("no_export", detail)
            .hint("Run the capture in a new job. `artifacts` lists the available files.");
    }
    if matches!(error, ExportError::EightBits(_)) {
        return Problem::conflict("no_export", format!("{error}."));
    }
    if error.is_of_wish() {
        return Problem::unprocessable("bad_input", format!("{error}."));
    }
    tracing::error!(%error, "an export failed");
    let detail = without_paths(&format!("The result cannot be read: {error}."));
    Problem::conflict("no_export", detail).hint("Run the capture in a new job.")
}
