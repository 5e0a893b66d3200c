//! Who renders a view.

use std::net::IpAddr;

use super::asking::ask;
use crate::app::App;
use crate::coordinator::Task;
use crate::copies::below;
use crate::error::Result;
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
    let turn = app.asking.take(client).await.ok_or(RenderError::Busy)?;
    match tokio::time::timeout(app.limits.render, by_worker(app, job, request)).await {
        Ok(Ok(true)) => return Ok("worker"),
        Ok(Ok(false)) => {}
        Ok(Err(error)) => tracing::warn!(%error, "no worker rendered a view: rendered here"),
        Err(_) => tracing::warn!("the workers take too long over a view: rendered here"),
    }
    drop(turn);
    app.renderers.render(client, request).await?;
    Ok("server")
}

/// `false` where no worker does such things.
async fn by_worker(app: &App, job: &str, request: &RenderRequest) -> Result<bool> {
    let Some(blobs) = app.mirror.blobs() else {
        return Ok(false);
    };
    let scene = below(&app.data.job(job), &request.scene);
    let task = Task::View {
        scene: scene.clone(),
        camera: Box::new(request.camera.clone()),
        shown: request.shown,
        ev: request.ev,
        format: request.format,
    };
    match ask(app, job, &[scene], &task, |_, _| ()).await? {
        Some(blob) => blobs.fetch(&blob, &request.out).await?,
        None => return Ok(false),
    }
    Ok(true)
}
