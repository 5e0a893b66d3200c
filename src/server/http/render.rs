//! `/v1/jobs/{id}/render`: novel views, also while the job trains.

use std::path::Path as FilePath;
use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use fled_core::camera::{Intrinsics, NamedCamera, Split};
use fled_core::gaussians::crop::Crop;
use fled_core::pipeline::workspace::fingerprint;
use fled_core::run_folder::{PictureSize, RunFolder, Viewpoint, ViewpointError};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::client::ClientAddress;
use super::exports::crop_of;
use super::extract::{Json, Query};
use super::lookup::{cameras_of, find};
use super::problem::Problem;
use super::sent::is_known;
use super::tus::Bytes;
use crate::app::App;
use crate::error::ServerError;
use crate::redaction::without_paths;
use crate::render::{Format, RenderError, RenderRequest, Shown};
use crate::store::state::JobState;

/// Longest side of a render, px.
const LONGEST_SIDE: usize = 2048;

/// Seconds after which a render may succeed.
const RENDER_RETRY: u32 = 5;
/// Maximum absolute value in a camera: px, or world units such as UTM in millimetres.
const LARGEST_NUMBER: f64 = 1e12;
/// Maximum exposure change of a view, in stops.
const MOST_STOPS: f64 = 16.0;
/// Minimum focal length, relative to the image side: a field of view of almost 180 degrees.
const SHORTEST_FOCAL: f64 = 1e-3;

/// What to see: a photograph's view, or a place on the orbit around the scene.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct RenderQuery {
    /// Name of a view or of its photograph.
    view: Option<String>,
    /// Degrees to the right of the middle of the photographs; 0 by default.
    #[param(minimum = -360, maximum = 360)]
    azimuth: Option<f64>,
    /// Degrees above the photographs; 0 by default.
    #[param(minimum = -360, maximum = 360)]
    elevation: Option<f64>,
    /// Distance from the centre as a multiple of the median distance of the photographs; 1 by
    /// default.
    #[param(minimum = 0.01, maximum = 100)]
    distance: Option<f64>,
    /// Width, px; by default the view's, or in proportion to `height`.
    width: Option<usize>,
    /// Height, px; by default the view's, or in proportion to `width`.
    height: Option<usize>,
    /// Round to use; by default the delivered one, or else the last finished one.
    round: Option<u32>,
    /// `jpeg` (default), `png` or `webp` (lossless).
    format: Option<Format>,
    /// `colour` (default) or `depth`: greyscale, near is white, far is dark, empty is black.
    show: Option<Shown>,
    /// Stops by which to brighten the linear light, from -16 to 16; 0 by default.
    ev: Option<f64>,
    /// Shows only the Gaussians whose centres lie in a shape around X, Y, Z:
    /// `box:X,Y,Z,WIDTH,HEIGHT,DEPTH` or `sphere:X,Y,Z,RADIUS`, in the world of the poses.
    crop: Option<String>,
}

/// A camera to render from.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderBody {
    /// Rigid transform, row-major, 4x4; OpenCV axes: x right, y down, z forward.
    #[schema(value_type = Vec<MatrixRow>, min_items = 4, max_items = 4)]
    world_to_camera: [[f64; 4]; 4],
    /// Pinhole camera, pixels.
    intrinsics: Pinhole,
    /// Round to use; by default the delivered one, or else the last finished one.
    round: Option<u32>,
    /// `jpeg` (default), `png` or `webp` (lossless).
    format: Option<Format>,
    /// `colour` (default) or `depth`: greyscale, near is white, far is dark, empty is black.
    show: Option<Shown>,
    /// Stops by which to brighten the linear light, from -16 to 16; 0 by default.
    ev: Option<f64>,
    /// Shows only the Gaussians whose centres lie in a shape around X, Y, Z:
    /// `box:X,Y,Z,WIDTH,HEIGHT,DEPTH` or `sphere:X,Y,Z,RADIUS`, in the world of the poses.
    crop: Option<String>,
}

/// A row of a matrix.
#[derive(ToSchema)]
#[schema(value_type = Vec<f64>, min_items = 4, max_items = 4)]
#[expect(dead_code, reason = "it describes what is read as an array")]
pub struct MatrixRow([f64; 4]);

/// Intrinsics in pixels.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Pinhole {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
}

/// Renders a photograph's view, or a view from an orbit around the scene.
#[utoipa::path(get, path = "/v1/jobs/{id}/render", operation_id = "render_view",
    tag = "results", params(("id" = String, Path), RenderQuery),
    responses(
        (status = 200, description = "The picture", body = Bytes, content_type = "image/*"),
        (status = 304, description = "Not modified"),
        (status = 404, description = "Job, view or round not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "No round has finished yet", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid size, viewpoint, `ev` or `crop`", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "Too many renders are waiting, or the render process failed", body = Problem, content_type = "application/problem+json")))]
pub async fn get(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Query(query): Query<RenderQuery>,
    Extension(client): Extension<ClientAddress>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let round = round(&app, &id, query.round).await?;
    let camera = camera(&app.data.output(&id), &query).await?;
    let wanted = Wanted {
        round,
        camera,
        format: query.format.unwrap_or(Format::Jpeg),
        shown: query.show.unwrap_or_default(),
        ev: check_stops(query.ev)?,
        crop: crop_of(query.crop.as_deref())?,
    };
    picture(&app, &id, wanted, client, &headers).await
}

/// Renders a view from a given camera.
#[utoipa::path(post, path = "/v1/jobs/{id}/render", operation_id = "render_camera",
    tag = "results", params(("id" = String, Path)),
    request_body = RenderBody,
    responses(
        (status = 200, description = "The picture", body = Bytes, content_type = "image/*"),
        (status = 404, description = "Job or round not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "No round has finished yet", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid camera, `ev` or `crop`", body = Problem, content_type = "application/problem+json")))]
pub async fn post(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Extension(client): Extension<ClientAddress>,
    headers: HeaderMap,
    Json(body): Json<RenderBody>,
) -> Result<Response, Problem> {
    let round = round(&app, &id, body.round).await?;
    let k = body.intrinsics;
    let intrinsics =
        Intrinsics { width: k.width, height: k.height, fx: k.fx, fy: k.fy, cx: k.cx, cy: k.cy };
    let camera = NamedCamera {
        name: String::new(),
        intrinsics,
        world_to_camera: body.world_to_camera,
        split: Split::Train,
    };
    let wanted = Wanted {
        round,
        camera,
        format: body.format.unwrap_or(Format::Jpeg),
        shown: body.show.unwrap_or_default(),
        ev: check_stops(body.ev)?,
        crop: crop_of(body.crop.as_deref())?,
    };
    picture(&app, &id, wanted, client, &headers).await
}

/// The round whose scene is rendered; `None` for the delivered scene of a finished job.
async fn round(app: &App, id: &str, asked: Option<u32>) -> Result<Option<u32>, Problem> {
    let job = find(app, id).await?;
    let output = app.data.output(id);
    if let Some(round) = asked {
        if output.scene_of(Some(round)).is_file() {
            return Ok(Some(round));
        }
        return Err(Problem::not_found("finished round"));
    }
    if job.state == JobState::Succeeded && output.scene_of(None).is_file() {
        return Ok(None);
    }
    let finished = app.store.rounds(id).await?;
    let rounds =
        finished.iter().rev().filter_map(|metrics| u32::try_from(metrics["round"].as_u64()?).ok());
    rounds.map(Some).find(|&round| output.scene_of(round).is_file()).ok_or_else(|| {
        Problem::conflict("no_scene_yet", "No round of this job has finished yet.")
            .hint("Try again after the first `round_finished` event.")
    })
}

/// The requested camera.
async fn camera(output: &RunFolder, query: &RenderQuery) -> Result<NamedCamera, Problem> {
    let viewpoint = query.viewpoint()?;
    for side in [query.width, query.height].into_iter().flatten() {
        check_size((side, side))?;
    }
    let cameras = cameras_of(output).await.map_err(|problem| {
        problem.hint("Send your own camera with POST, or run the capture in a new job.")
    })?;
    let size = PictureSize { width: query.width, height: query.height };
    let camera = viewpoint.camera(&cameras, size).map_err(|error| no_viewpoint(&error))?;
    Ok(NamedCamera::new("", &camera, Split::Train))
}

impl RenderQuery {
    fn viewpoint(&self) -> Result<Viewpoint, Problem> {
        let orbit = [self.azimuth, self.elevation, self.distance];
        match &self.view {
            Some(_) if orbit.iter().any(Option::is_some) => Err(Problem::unprocessable(
                "bad_input",
                "Give either a view or a position on the orbit, not both.",
            )),
            Some(name) => Ok(Viewpoint::View(name.clone())),
            None => Ok(Viewpoint::Orbit {
                azimuth: self.azimuth.unwrap_or(0.0),
                elevation: self.elevation.unwrap_or(0.0),
                distance: self.distance.unwrap_or(1.0),
            }),
        }
    }
}

fn no_viewpoint(error: &ViewpointError) -> Problem {
    match error {
        ViewpointError::UnknownView { .. } => Problem::not_found("view"),
        ViewpointError::NoOrbit => {
            Problem::unprocessable("bad_input", "The cameras of this job do not span an orbit.")
        }
        ViewpointError::Angle(_) | ViewpointError::Distance => {
            Problem::unprocessable("bad_input", format!("{error}."))
        }
    }
}

fn check_size((width, height): (usize, usize)) -> Result<(), Problem> {
    let allowed = 16..=LONGEST_SIDE;
    if allowed.contains(&width) && allowed.contains(&height) {
        return Ok(());
    }
    Err(Problem::unprocessable(
        "bad_input",
        format!(
            "{width}x{height} is out of range: each side must be from 16 to {LONGEST_SIDE} px."
        ),
    ))
}

/// Checks the requested exposure change in stops.
fn check_stops(ev: Option<f64>) -> Result<f64, Problem> {
    let ev = ev.unwrap_or(0.0);
    if ev.abs() <= MOST_STOPS {
        return Ok(ev);
    }
    Err(Problem::unprocessable(
        "bad_input",
        format!("{ev} is out of range: `ev` must be from -{MOST_STOPS} to {MOST_STOPS}."),
    ))
}

/// Checks a camera: finite numbers, positive focal lengths, a valid rotation.
fn check_camera(camera: &NamedCamera) -> Result<(), Problem> {
    let k = &camera.intrinsics;
    check_size((k.width, k.height))?;
    let rows = &camera.world_to_camera;
    // The renderer uses f32, where larger values give NaN or an empty image.
    let finite = rows
        .iter()
        .flatten()
        .chain([&k.fx, &k.fy, &k.cx, &k.cy])
        .all(|value| value.abs() <= LARGEST_NUMBER);
    let sees = |f: f64, side: usize| f >= SHORTEST_FOCAL * side as f64;
    let rotation = camera.camera().rotation();
    let deviation = (rotation * rotation.transpose() - glam::DMat3::IDENTITY).to_cols_array();
    let is_rigid = deviation.iter().all(|d| d.abs() < 1e-3)
        && rotation.determinant() > 0.0
        && rows[3] == [0.0, 0.0, 0.0, 1.0];
    if finite && sees(k.fx, k.width) && sees(k.fy, k.height) && is_rigid {
        return Ok(());
    }
    Err(Problem::unprocessable("bad_camera", "This is not a pinhole camera with a rigid pose.")
        .hint(
            "`world_to_camera` is 4x4 and row-major: a rotation, a translation, and 0 0 0 1 below.",
        ))
}

/// A requested image.
struct Wanted {
    /// The round; `None` for the delivered scene.
    round: Option<u32>,
    camera: NamedCamera,
    format: Format,
    shown: Shown,
    ev: f64,
    crop: Option<Crop>,
}

async fn picture(
    app: &App,
    id: &str,
    wanted: Wanted,
    client: ClientAddress,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    check_camera(&wanted.camera)?;
    let scene = app.data.output(id).scene_of(wanted.round);
    let key = key(&scene, &wanted).map_err(ServerError::io(&scene))?;
    let format = wanted.format;
    let etag = format!("\"{key}\"");
    let common =
        [(header::ETAG, etag.clone()), (header::CONTENT_TYPE, format.media_type().to_owned())];
    if is_known(headers, &etag) {
        return Ok((StatusCode::NOT_MODIFIED, common).into_response());
    }
    let cache = app.data.renders(id);
    let cached = cache.join(format!("{key}.{}", format.extension()));
    if let Ok(bytes) = tokio::fs::read(&cached).await {
        return Ok((common, Body::from(bytes)).into_response());
    }
    tokio::fs::create_dir_all(&cache).await.map_err(ServerError::io(&cache))?;
    let out = cache.join(format!("{}.tmp", Uuid::now_v7()));
    let request = RenderRequest {
        scene,
        camera: wanted.camera,
        shown: wanted.shown,
        ev: wanted.ev,
        crop: wanted.crop,
        format,
        out: out.clone(),
    };
    if let Err(error) = app.renderers.render(client.0, &request).await {
        drop(tokio::fs::remove_file(&out).await);
        return Err(failed(&error));
    }
    let bytes = tokio::fs::read(&out).await.map_err(ServerError::io(&out))?;
    tokio::fs::rename(&out, &cached).await.map_err(ServerError::io(&cached))?;
    let kept = app.limits.kept_renders;
    drop(tokio::task::spawn_blocking(move || trim(&cache, kept)));
    Ok((common, Body::from(bytes)).into_response())
}

fn failed(error: &RenderError) -> Problem {
    let code = match error {
        RenderError::Empty(why) => {
            return Problem::unprocessable("bad_input", format!("{why}.")).pointer("/crop");
        }
        RenderError::Busy => "busy",
        RenderError::Refused(_) | RenderError::Process(_) => "render_failed",
    };
    tracing::error!(%error, "a render failed");
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, code, without_paths(&error.to_string()))
        .hint("Try again. /readyz shows whether the adapter works.")
        .retry_after(RENDER_RETRY)
}

/// A hash of all that an image depends on: the build, this exact scene file, the camera, the size,
/// the format, the content shown and the crop.
fn key(scene: &FilePath, wanted: &Wanted) -> std::io::Result<String> {
    let metadata = std::fs::metadata(scene)?;
    let (camera, format, shown, ev) = (&wanted.camera, wanted.format, wanted.shown, wanted.ev);
    let file = format!("{scene:?} {:?} {}", metadata.modified()?, metadata.len());
    let view = format!("{:?} {:?}", camera.intrinsics, camera.world_to_camera);
    let crop = wanted.crop.map(String::from).unwrap_or_default();
    let key = fingerprint(&[&file, &view, &format!("{format:?} {shown:?} {ev:?}"), &crop]);
    Ok(key[..32].to_owned())
}

/// Removes the oldest images beyond `kept`.
fn trim(cache: &FilePath, kept: usize) {
    let Ok(entries) = std::fs::read_dir(cache) else {
        return;
    };
    let mut files: Vec<_> = entries
        .flatten()
        .filter_map(|entry| Some((entry.metadata().ok()?.modified().ok()?, entry.path())))
        .collect();
    if files.len() <= kept {
        return;
    }
    files.sort();
    for (_, path) in &files[..files.len() - kept] {
        // Another request may have removed it.
        let _ = std::fs::remove_file(path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_an_earlier_build_cached_is_not_served() {
        let scene = tempfile::NamedTempFile::new().expect("temporary file");
        let scene = scene.path();
        let (width, height) = (64, 48);
        let intrinsics = Intrinsics { width, height, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        let world_to_camera = glam::DMat4::IDENTITY.transpose().to_cols_array_2d();
        let camera =
            NamedCamera { name: String::new(), intrinsics, world_to_camera, split: Split::Train };
        let wanted = Wanted {
            round: None,
            camera,
            format: Format::Png,
            shown: Shown::Colour,
            ev: 0.0,
            crop: None,
        };
        // The key used by builds before CODE_VERSION 5.
        let about = std::fs::metadata(scene).expect("there");
        let mut hasher = blake3::Hasher::new();
        hasher.update(scene.as_os_str().as_encoded_bytes());
        hasher.update(format!("{:?}{}", about.modified().expect("known"), about.len()).as_bytes());
        let camera = format!("{:?}{:?}", wanted.camera.intrinsics, wanted.camera.world_to_camera);
        hasher.update(format!("{camera}{:?}{:?}{:?}", Format::Png, Shown::Colour, 0.0).as_bytes());
        let earlier = hasher.finalize().to_hex();
        let key = key(scene, &wanted).expect("a key");
        assert_ne!(key, earlier[..32]);
        let brighter = Wanted { ev: 1.0, ..wanted };
        let brighter_key = super::key(scene, &brighter).expect("a key");
        assert_ne!(brighter_key, key);
        let part = Wanted { crop: "sphere:0,0,0,1".parse().ok(), ..brighter };
        assert_ne!(super::key(scene, &part).expect("a key"), brighter_key);
    }
}
