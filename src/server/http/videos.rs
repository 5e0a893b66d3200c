//! `/v1/jobs/{id}/videos`: videos of a result, rendered one at a time in the background.

use std::sync::Arc;

use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use fled_core::gaussians::crop::Crop;
use fled_core::video::{Key, Kind, Plan, PlanError};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

use super::access::Visitor;
use super::exports::crop_of;
use super::extract::Json;
use super::lookup::{cameras_of, find, finished};
use super::problem::Problem;
use super::quota::bytes_left;
use super::render::MatrixRow;
use super::sent::Sent;
use super::shapes::time;
use super::tus::Bytes;
use super::upload;
use crate::app::App;
use crate::error::ServerError;
use crate::files::remove;
use crate::store::state::JobState;
use crate::store::{VideoCreation, VideoRoom, VideoRow};
use crate::worker::is_installed;

/// Seconds after which a queued video may be finished.
const RETRY: u32 = 60;

/// The path of the camera.
#[derive(ToSchema)]
#[serde(rename_all = "snake_case")]
#[expect(dead_code, reason = "it describes what is read as the core's")]
pub enum VideoKind {
    /// Around the middle of the scene.
    Orbit,
    /// Through the cameras of the photographs, in their order.
    Cameras,
    /// Through given poses.
    Path,
}

/// A pose on a path.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VideoPose {
    /// Rigid transform, row-major, 4x4; OpenCV axes: x right, y down, z forward.
    #[schema(value_type = Vec<MatrixRow>, min_items = 4, max_items = 4)]
    world_to_camera: [[f64; 4]; 4],
    /// Time from the previous pose to this one, at least 0.05 s; ignored for the first.
    #[serde(default)]
    seconds: f64,
}

/// A video to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CreateVideo {
    /// Path of the camera.
    #[schema(value_type = VideoKind)]
    kind: Kind,
    /// Duration, seconds; 8 by default. The poses of a path have durations of their own.
    #[schema(minimum = 1, maximum = 60)]
    seconds: Option<f64>,
    /// Frames per second; 24 by default.
    #[schema(minimum = 1, maximum = 30)]
    fps: Option<u32>,
    /// Width, px, rounded down to an even number; by default that of the views, or in proportion to
    /// `height`.
    #[schema(minimum = 64, maximum = 1920)]
    width: Option<usize>,
    /// Height, px, rounded down to an even number; by default that of the views, or in proportion
    /// to `width`.
    #[schema(minimum = 64, maximum = 1920)]
    height: Option<usize>,
    /// Round to use; by default the delivered one.
    round: Option<u32>,
    /// Shows only the Gaussians whose centres lie in a shape around X, Y, Z:
    /// `box:X,Y,Z,WIDTH,HEIGHT,DEPTH` or `sphere:X,Y,Z,RADIUS`, in the world of the poses.
    crop: Option<String>,
    /// For an orbit, the total angle in degrees. 360 goes once around, less swings to both sides
    /// and back. By default the orbit reaches as far as the photographs.
    #[schema(minimum = 1, maximum = 360)]
    degrees: Option<f64>,
    /// For an orbit, degrees above the photographs; 0 by default.
    #[schema(minimum = -60, maximum = 60)]
    elevation: Option<f64>,
    /// For an orbit, the distance from the centre as a multiple of the median distance of the
    /// photographs; 1 by default.
    #[schema(minimum = 0.1, maximum = 10)]
    distance: Option<f64>,
    /// For a path, 2 to 100 poses.
    #[schema(min_items = 2, max_items = 100)]
    poses: Option<Vec<VideoPose>>,
}

impl CreateVideo {
    fn plan(self) -> Result<Plan, Problem> {
        let key =
            |pose: VideoPose| Key { world_to_camera: pose.world_to_camera, seconds: pose.seconds };
        Ok(Plan {
            kind: self.kind,
            seconds: self.seconds,
            fps: self.fps,
            width: self.width,
            height: self.height,
            round: self.round,
            crop: crop_of(self.crop.as_deref())?,
            degrees: self.degrees,
            elevation: self.elevation,
            distance: self.distance,
            poses: self.poses.map(|poses| poses.into_iter().map(key).collect()),
        })
    }
}

/// State of a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VideoState {
    /// Waiting for its turn.
    Queued,
    /// Being rendered.
    Running,
    /// Ready for download.
    Succeeded,
    /// Failed.
    Failed,
}

impl From<JobState> for VideoState {
    fn from(state: JobState) -> Self {
        match state {
            JobState::Queued => Self::Queued,
            JobState::Running => Self::Running,
            JobState::Succeeded => Self::Succeeded,
            // An unwanted video is deleted, not cancelled.
            JobState::Failed | JobState::Cancelled => Self::Failed,
        }
    }
}

/// Why a video failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct VideoFault {
    /// What went wrong.
    pub detail: String,
    /// What to do about it.
    pub hint: String,
}

/// A video.
#[derive(Debug, Serialize, ToSchema)]
pub struct Video {
    /// UUID v7. The file is at the address of the video followed by `/file`.
    id: String,
    /// State.
    state: VideoState,
    /// Path of the camera.
    #[schema(value_type = VideoKind)]
    kind: Kind,
    /// Round; `null` is the delivered one.
    round: Option<u32>,
    /// The part of the scene that it shows; `null` is all of it.
    #[schema(value_type = Option<String>)]
    crop: Option<Crop>,
    /// Duration, seconds.
    seconds: f64,
    /// Frames per second.
    fps: u32,
    /// Width, px.
    width: usize,
    /// Height, px.
    height: usize,
    /// Finished share, 0 to 1.
    progress: f64,
    /// Number of videos ahead of a waiting one.
    ahead: Option<usize>,
    /// Time of the request, RFC 3339.
    created_at: String,
    /// Time at which it ended, RFC 3339.
    finished_at: Option<String>,
    /// Size, bytes.
    bytes: Option<u64>,
    /// Why the video failed.
    error: Option<VideoFault>,
}

/// The videos of a job.
#[derive(Debug, Serialize, ToSchema)]
pub struct Videos {
    /// The videos, newest first.
    videos: Vec<Video>,
}

impl Video {
    fn from_row(row: VideoRow) -> Result<Self, ServerError> {
        let job = row.job;
        let plan: Plan = serde_json::from_value(job.options).map_err(|error| damaged(&error))?;
        let state = VideoState::from(job.state);
        Ok(Self {
            id: job.id,
            state,
            kind: plan.kind,
            round: plan.round,
            crop: plan.crop,
            seconds: plan.seconds(),
            fps: plan.fps(),
            width: plan.width.unwrap_or(0),
            height: plan.height.unwrap_or(0),
            progress: match state {
                VideoState::Succeeded | VideoState::Running => job.progress,
                VideoState::Queued | VideoState::Failed => 0.0,
            },
            ahead: row.ahead.map(|ahead| ahead as usize),
            created_at: time(job.created_at),
            finished_at: job.finished_at.map(time),
            bytes: row.bytes,
            error: job
                .error
                .filter(|_| state == VideoState::Failed)
                .map(|error| VideoFault { detail: error.detail, hint: error.hint }),
        })
    }
}

fn damaged(error: &serde_json::Error) -> ServerError {
    ServerError::Damaged { what: "video", detail: error.to_string() }
}

/// Makes a video of a finished result.
///
/// Videos are made in the background, one at a time; jobs come first.
#[utoipa::path(post, path = "/v1/jobs/{id}/videos", operation_id = "create_video",
    tag = "results", params(("id" = String, Path)),
    request_body = CreateVideo,
    responses(
        (status = 202, description = "Accepted and stored on disk", body = Video, headers(("Location" = String))),
        (status = 404, description = "Job or round not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job is not finished, or its limit of videos is reached", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid video", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "ffmpeg is missing, or too many videos are waiting", body = Problem, content_type = "application/problem+json")))]
pub async fn create(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
    Extension(visitor): Extension<Visitor>,
    Json(body): Json<CreateVideo>,
) -> Result<Response, Problem> {
    let mut plan = body.plan()?;
    plan.check().map_err(|error| bad_plan(&error))?;
    finished(&app, &job, plan.round).await?;
    let views = cameras_of(&app.data.output(&job)).await?;
    let cameras = plan.cameras(&views).map_err(|error| bad_plan(&error))?;
    let size = cameras.first().map(|camera| camera.intrinsics);
    let size = size.ok_or_else(Problem::internal)?;
    // The size of the views now, whenever it is rendered.
    (plan.width, plan.height) = (Some(size.width), Some(size.height));
    upload::check_space(&app)?;
    bytes_left(&app, &visitor).await?;
    check_ffmpeg(&app)?;
    let id = Uuid::now_v7().to_string();
    let plan = serde_json::to_value(plan).map_err(|error| damaged(&error))?;
    let room = VideoRoom { of_job: app.limits.videos_of_job, unfinished: app.limits.videos };
    match app.store.create_video(&id, &job, &plan, room).await? {
        VideoCreation::Created => {}
        VideoCreation::JobFull(count) => return Err(too_many(count)),
        VideoCreation::QueueFull => return Err(busy()),
        VideoCreation::Gone => return Err(Problem::not_found("job")),
    }
    let row = known(&app, &job, &id).await?;
    let headers = [(header::LOCATION, format!("/v1/jobs/{job}/videos/{id}"))];
    let video = Video::from_row(row)?;
    Ok((StatusCode::ACCEPTED, headers, axum::Json(video)).into_response())
}

/// Lists the videos of a job.
#[utoipa::path(get, path = "/v1/jobs/{id}/videos", operation_id = "list_videos",
    tag = "results", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The videos", body = Videos),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn list(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
) -> Result<axum::Json<Videos>, Problem> {
    find(&app, &job).await?;
    let rows = app.store.videos(&job).await?.into_iter();
    let videos = rows.map(Video::from_row).collect::<Result<_, _>>()?;
    Ok(axum::Json(Videos { videos }))
}

/// Shows a video with its state and progress.
#[utoipa::path(get, path = "/v1/jobs/{id}/videos/{video}", operation_id = "show_video",
    tag = "results", params(("id" = String, Path), ("video" = String, Path)),
    responses(
        (status = 200, description = "The video's state", body = Video),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn show(
    State(app): State<Arc<App>>,
    Path((job, video)): Path<(String, String)>,
) -> Result<axum::Json<Video>, Problem> {
    let row = known(&app, &job, &video).await?;
    Ok(axum::Json(Video::from_row(row)?))
}

/// Downloads a video (H.264 in MP4), whole or by range.
#[utoipa::path(get, path = "/v1/jobs/{id}/videos/{video}/file", operation_id = "download_video",
    tag = "results", params(("id" = String, Path), ("video" = String, Path),
        ("Range" = Option<String>, Header, description = "A single range of bytes")),
    responses(
        (status = 200, description = "The video", body = Bytes, content_type = "video/mp4"),
        (status = 206, description = "The requested range", body = Bytes, content_type = "video/mp4"),
        (status = 304, description = "Not modified"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The video is not ready, or could not be made", body = Problem, content_type = "application/problem+json"),
        (status = 416, description = "The range begins beyond the end", body = Problem, content_type = "application/problem+json")))]
pub async fn download(
    State(app): State<Arc<App>>,
    Path((job, id)): Path<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let row = known(&app, &job, &id).await?;
    let Some(bytes) = row.bytes else {
        let detail = if row.job.state.is_terminal() {
            "This video could not be made."
        } else {
            "This video is not ready yet."
        };
        return Err(Problem::conflict("no_video_yet", detail)
            .hint("The address without `/file` shows its state."));
    };
    let sent = Sent {
        path: app.data.video(&id),
        bytes,
        // A video with an id does not change.
        etag: format!("\"{id}\""),
        media_type: "video/mp4",
    };
    sent.answer(&headers).await
}

/// Deletes a video, and stops it if it is waiting or being made.
#[utoipa::path(delete, path = "/v1/jobs/{id}/videos/{video}", operation_id = "delete_video",
    tag = "results", params(("id" = String, Path), ("video" = String, Path)),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn delete(
    State(app): State<Arc<App>>,
    Path((job, id)): Path<(String, String)>,
) -> Result<StatusCode, Problem> {
    find(&app, &job).await?;
    if !app.store.delete_video(&job, &id).await? {
        return Err(Problem::not_found("video"));
    }
    app.running.stop(&id);
    remove(&app.data.job(&id)).await;
    Ok(StatusCode::NO_CONTENT)
}

/// A video of a job, or 404.
async fn known(app: &App, job: &str, id: &str) -> Result<VideoRow, Problem> {
    find(app, job).await?;
    let row = app.store.video(job, id).await?;
    row.ok_or_else(|| Problem::not_found("video"))
}

/// Refuses a video that would wait forever, because ffmpeg is not installed on the server.
fn check_ffmpeg(app: &App) -> Result<(), Problem> {
    if is_installed(&app.config.ffmpeg) {
        return Ok(());
    }
    let detail = "This server cannot make videos, because ffmpeg is missing.";
    let problem = Problem::new(StatusCode::SERVICE_UNAVAILABLE, "no_ffmpeg", detail);
    Err(problem.hint("Ask the server's administrator to install it: apt-get install ffmpeg."))
}

fn bad_plan(error: &PlanError) -> Problem {
    let pointer = format!("/{}", error.field);
    Problem::unprocessable("bad_input", format!("{}.", error.message)).pointer(pointer)
}

fn busy() -> Problem {
    let detail = "Too many videos are waiting.";
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", detail)
        .hint("Try again when some have been made.")
        .retry_after(RETRY)
}

fn too_many(count: usize) -> Problem {
    let detail = format!("This job already has {count} videos, the most that a job may have.");
    Problem::conflict("too_many_videos", detail).hint("Delete some of them first.")
}
