//! Who renders a view.

use std::net::IpAddr;

use super::asking::{Asked, ask};
use crate::app::App;
use crate::coordinator::Task;
use crate::copies::below;
use crate::error::ServerError;
use crate::render::{RenderError, RenderRequest};

/// Lets a worker render it, or renders it here; who did.
///
/// # Errors
/// [`RenderError`].
pub async fn render(
    app: &App,
    job: &str,
    client: IpAddr,
    request: &RenderRequest,
) -> Result<&'static str, RenderError> {
    match tokio::time::timeout(app.limits.render, by_worker(app, job, client, request)).await {
        Ok(Ok(true)) => return Ok("worker"),
        Ok(Ok(false)) => {}
        Ok(Err(ByWorker::Render(error))) => return Err(error),
        Ok(Err(ByWorker::Server(error))) => {
            tracing::warn!(%error, "no worker rendered a view: rendered here");
        }
        Err(_) => tracing::warn!("the workers take too long over a view: rendered here"),
    }
    app.renderers.render(client, request).await?;
    Ok("server")
}

/// Why no worker rendered it.
enum ByWorker {
    /// It is to be told.
    Render(RenderError),
    /// Another way may do.
    Server(ServerError),
}

impl<E: Into<ServerError>> From<E> for ByWorker {
    fn from(error: E) -> Self {
        Self::Server(error.into())
    }
}

/// `false` where no worker does such things.
async fn by_worker(
    app: &App,
    job: &str,
    client: IpAddr,
    request: &RenderRequest,
) -> Result<bool, ByWorker> {
    let Some(blobs) = app.mirror.blobs() else {
        return Ok(false);
    };
    let turn = app.asking.take(client).await;
    let _turn = turn.ok_or(ByWorker::Render(RenderError::Busy))?;
    let scene = below(&app.data.job(job), &request.scene);
    let task = Task::View {
        scene: scene.clone(),
        camera: Box::new(request.camera.clone()),
        shown: request.shown,
        format: request.format,
    };
    match ask(app, job, &[scene], &task, |_, _| ()).await? {
        Asked::Made(blob) => blobs.fetch(&blob, &request.out).await?,
        Asked::Refused { detail, .. } => {
            return Err(ByWorker::Render(RenderError::Refused(detail)));
        }
        Asked::Nobody => return Ok(false),
    }
    Ok(true)
}
