//! The process that renders novel views: a single one, kept alive and replaced when it dies.
//!
//! Rendering needs the GPU's driver. In a separate process, a driver fault costs one picture, not
//! the service.

mod turns;

use std::ffi::OsString;
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use fled_core::camera::NamedCamera;
use fled_core::gaussians::crop::Crop;
use serde::{Deserialize, Serialize};
use tokio::io::AsyncWriteExt;
use tokio::sync::{Mutex, oneshot};

use self::turns::Turns;
use crate::process::{Group, Line};

/// Maximum requests at a time, including the one in progress; more are refused.
const QUEUE: usize = 32;

/// The file format of a render.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Small, lossy.
    Jpeg,
    /// Lossless.
    Png,
    /// Lossless, smaller than PNG.
    Webp,
}

impl Format {
    /// The file name's extension.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Jpeg => "jpg",
            Self::Png => "png",
            Self::Webp => "webp",
        }
    }

    /// The media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Jpeg => "image/jpeg",
            Self::Png => "image/png",
            Self::Webp => "image/webp",
        }
    }
}

/// What a render shows of a scene.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Shown {
    /// What it looks like.
    #[default]
    Colour,
    /// How far away it is: near is white, far is dark.
    Depth,
}

/// A line to the render process.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RenderRequest {
    /// The scene's PLY file.
    pub scene: PathBuf,
    /// Pose, intrinsics and size; the name and the split are ignored.
    pub camera: NamedCamera,
    /// What the picture shows.
    #[serde(default)]
    pub shown: Shown,
    /// Stops by which the linear light is brightened; no effect on depth.
    #[serde(default)]
    pub ev: f64,
    /// The part of the scene to show; all of it without one.
    #[serde(default)]
    pub crop: Option<Crop>,
    /// Format of the picture.
    pub format: Format,
    /// Path of the picture to write.
    pub out: PathBuf,
}

/// A line from the render process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RenderReply {
    /// The picture has been written.
    Ok(bool),
    /// Why it has not.
    Error(String),
    /// Nothing is inside the crop, and where the scene is.
    Empty(String),
}

/// Why a render failed.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// Too many requests wait.
    #[error("too many renders are waiting")]
    Busy,
    /// The process refused the request.
    #[error("{0}")]
    Refused(String),
    /// Nothing is inside the crop.
    #[error("{0}")]
    Empty(String),
    /// The process died, could not be started, or did not answer.
    #[error("the render process {0}")]
    Process(String),
}

/// The render process and its queue.
#[derive(Debug)]
pub struct Renderers {
    command: Vec<OsString>,
    timeout: Duration,
    grace: Duration,
    process: Arc<Mutex<Option<Group>>>,
    turns: Turns,
}

impl Renderers {
    /// No process starts before the first request.
    pub fn new(command: Vec<OsString>, timeout: Duration, grace: Duration) -> Self {
        Self { command, timeout, grace, process: Arc::default(), turns: Turns::new(QUEUE) }
    }

    /// Renders one picture to `request.out`. Clients take turns; the requests of one client are
    /// served in order.
    ///
    /// # Errors
    /// [`RenderError`]; if the process was lost, the next request starts a new one.
    pub async fn render(&self, client: IpAddr, request: &RenderRequest) -> Result<(), RenderError> {
        let line = serde_json::to_string(request)
            .map_err(|error| RenderError::Refused(error.to_string()))?;
        // A client that disconnects while waiting here leaves the queue.
        let turn = self.turns.take(client).await.ok_or(RenderError::Busy)?;
        let mut slot = self.process.clone().lock_owned().await;
        let (command, timeout, grace) = (self.command.clone(), self.timeout, self.grace);
        let out = request.out.clone();
        let (sender, answer) = oneshot::channel();
        // In a separate task: if a client disconnected in mid-exchange, the next request would take
        // the pending answer for its own.
        tokio::spawn(async move {
            let outcome = exchange(&mut slot, &command, &line, (timeout, grace)).await;
            drop((slot, turn));
            if sender.send(outcome).is_err() {
                // No one receives the picture; if there is none, there is nothing to remove.
                drop(tokio::fs::remove_file(&out).await);
            }
        });
        answer.await.unwrap_or_else(|error| Err(RenderError::Process(error.to_string())))
    }

    /// Ends the process.
    pub async fn stop(&self) {
        if let Some(mut group) = self.process.lock().await.take() {
            group.stop(self.grace).await;
        }
    }
}

async fn exchange(
    slot: &mut Option<Group>,
    command: &[OsString],
    line: &str,
    (timeout, grace): (Duration, Duration),
) -> Result<(), RenderError> {
    // A process that ran before may have died meanwhile: then one new process is tried.
    let mut fresh = slot.is_none();
    loop {
        let group = match slot {
            Some(group) => group,
            None => slot.insert(start(command)?),
        };
        match tokio::time::timeout(timeout, ask(group, line)).await {
            Ok(Some(RenderReply::Ok(_))) => return Ok(()),
            Ok(Some(RenderReply::Error(why))) => return Err(RenderError::Refused(why)),
            Ok(Some(RenderReply::Empty(why))) => return Err(RenderError::Empty(why)),
            Ok(None) => *slot = None,
            Err(_) => {
                group.stop(grace).await;
                *slot = None;
                return Err(RenderError::Process(format!(
                    "did not respond within {} s",
                    timeout.as_secs()
                )));
            }
        }
        if fresh {
            return Err(RenderError::Process("crashed on this picture".to_owned()));
        }
        fresh = true;
    }
}

fn start(command: &[OsString]) -> Result<Group, RenderError> {
    Group::spawn(command, &[], &[])
        .map_err(|error| RenderError::Process(format!("could not be started: {error}")))
}

/// Sends a request and waits for the answer; `None` if the process has gone.
async fn ask(group: &mut Group, line: &str) -> Option<RenderReply> {
    let stdin = group.stdin.as_mut()?;
    stdin.write_all(line.as_bytes()).await.ok()?;
    stdin.write_all(b"\n").await.ok()?;
    stdin.flush().await.ok()?;
    loop {
        match group.next_line().await? {
            Line::Output(text) => match serde_json::from_str(&text) {
                Ok(reply) => return Some(reply),
                Err(_) => tracing::info!(text, "render process"),
            },
            Line::Error(text) => tracing::info!(text, "render process"),
        }
    }
}
