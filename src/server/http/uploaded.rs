//! Captures and jobs from resumable uploads.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Deserialize;
use serde_json::{Map, Number, Value};
use utoipa::ToSchema;

use super::access::Visitor;
use super::order::Order;
use super::priority::Priority;
use super::problem::Problem;
use super::room::check_room;
use super::upload::{Placed, Upload, check_space, gather, to_its_end};
use crate::app::App;
use crate::store::{Creation, Request, UsedUp};

/// A capture of finished uploads.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CaptureOfUploads {
    /// IDs of finished uploads: photographs, poses, one ZIP file, or one video. They are used up.
    #[schema(min_items = 1)]
    uploads: Vec<String>,
    /// ID of a capture whose photographs are used, too; it stays as it is. Its poses, masks and
    /// ground truth are not used. A ZIP file or a video cannot be added.
    add_to: Option<String>,
    /// Name of the capture.
    #[schema(max_length = 200)]
    name: Option<String>,
    /// Number of photographs to take from a video; 40 by default.
    #[schema(minimum = 3, maximum = 500)]
    frames: Option<u32>,
}

impl CaptureOfUploads {
    /// Gathers the files.
    ///
    /// # Errors
    /// Those of [`gather`].
    pub(super) async fn bring(self, app: &Arc<App>, visitor: &Visitor) -> Result<Upload, Problem> {
        check_space(app)?;
        let fields = fields(self.name.as_ref(), self.frames);
        gather(app, &self.uploads, self.add_to.as_deref(), fields, visitor).await
    }
}

fn fields(name: Option<&String>, frames: Option<u32>) -> BTreeMap<String, String> {
    let frames = frames.map(|frames| ("frames".to_owned(), frames.to_string()));
    let name = name.map(|name| ("name".to_owned(), name.clone()));
    name.into_iter().chain(frames).collect()
}

/// A capture of finished uploads, and a job of it.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobOfUploads {
    /// IDs of finished uploads: photographs, poses, one ZIP file, or one video. They are used up.
    #[schema(min_items = 1)]
    uploads: Vec<String>,
    /// ID of a capture whose photographs are used, too; it stays as it is. Its poses, masks and
    /// ground truth are not used. A ZIP file or a video cannot be added.
    add_to: Option<String>,
    /// `auto` (default), `preview`, `standard`, `high` or `paper`.
    preset: Option<String>,
    /// Options that override the preset's; see `/v1/options`.
    #[serde(default)]
    #[schema(value_type = Object)]
    options: Map<String, Value>,
    /// Name of the capture and the job.
    #[schema(max_length = 200)]
    name: Option<String>,
    /// Number of photographs to take from a video; 40 by default.
    #[schema(minimum = 3, maximum = 500)]
    frames: Option<u32>,
    /// From -100 to 100, 0 by default: waiting jobs with a higher priority start first. Above 0
    /// requires `admin` if the server has tokens.
    #[schema(value_type = Option<i32>, minimum = -100, maximum = 100)]
    priority: Option<Number>,
}

impl JobOfUploads {
    /// Identifies the request without the files, because the uploads may already be used up.
    fn fingerprint(&self, priority: Priority) -> String {
        let uploads = self.uploads.join("\n");
        let options = priority.beside(&self.options);
        let frames = self.frames.map(|frames| frames.to_string());
        let frames = frames.unwrap_or_default();
        let mut parts = vec![
            "uploads",
            &uploads,
            self.preset.as_deref().unwrap_or_default(),
            &options,
            self.name.as_deref().unwrap_or_default(),
            &frames,
        ];
        // Only if given: keys stored before it existed must still match.
        parts.extend(self.add_to.as_deref());
        blake3::hash(parts.join("\n\n").as_bytes()).to_hex().to_string()
    }
}

/// Creates a capture and a job from it; with a key, at most once.
///
/// # Errors
/// Those of [`gather`], of the capture and of the job. On an error the uploads are unchanged.
pub(super) async fn create_job(
    app: &Arc<App>,
    body: JobOfUploads,
    key: Option<&str>,
    visitor: Visitor,
) -> Result<Creation, Problem> {
    let priority = Priority::asked(body.priority.as_ref(), &visitor)?;
    let fingerprint = body.fingerprint(priority);
    let request = Request { key, fingerprint: &fingerprint };
    // A repeated request already has its job, and its uploads are used up.
    if let Some(seen) = app.store.answered(&request).await? {
        return Ok(seen);
    }
    match make(app, body, priority, &request, visitor).await {
        // The first request may have used them up meanwhile.
        Err(problem) => app.store.answered(&request).await?.ok_or(problem),
        made => made,
    }
}

async fn make(
    app: &Arc<App>,
    body: JobOfUploads,
    priority: Priority,
    request: &Request<'_>,
    visitor: Visitor,
) -> Result<Creation, Problem> {
    check_space(app)?;
    check_room(app, &visitor).await?;
    let preset = body.preset.as_deref().filter(|preset| !preset.is_empty());
    let order = Order::new(app, preset, &body.options, priority).await?;
    let fields = fields(body.name.as_ref(), body.frames);
    let add_to = body.add_to.as_deref();
    let upload = gather(app, &body.uploads, add_to, fields, &visitor).await?;
    let report = upload.examine(app).await?;
    order.check_views(&report)?;
    let (app, key) = (app.clone(), request.key.map(str::to_owned));
    let fingerprint = request.fingerprint.to_owned();
    to_its_end(async move {
        let request = Request { key: key.as_deref(), fingerprint: &fingerprint };
        let placed = upload.place(&app, &report, &visitor).await?;
        let creation = store(&app, &placed, &order, &request, &visitor).await;
        // Without a job the uploads still exist.
        if matches!(creation, Ok(Creation::Created(_))) {
            placed.finish(&app).await;
        } else {
            placed.give_up().await;
        }
        creation
    })
    .await
}

async fn store(
    app: &App,
    placed: &Placed<'_>,
    order: &Order,
    request: &Request<'_>,
    visitor: &Visitor,
) -> Result<Creation, Problem> {
    let job = order.job(app, &placed.row.id, &placed.row.name)?;
    let used = UsedUp { capture: &placed.row, files: &placed.kept, uploads: &placed.uploads };
    let room = visitor.room(app.limits.queue);
    let creation = app.store.create_job_of(used, &job, request, room).await?;
    creation.ok_or_else(|| Problem::not_found("upload").pointer("/uploads"))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_request_that_adds_to_no_capture_keeps_the_fingerprint_that_it_always_had() {
        let of = |body: Value| {
            let body: JobOfUploads = serde_json::from_value(body).expect("a request");
            body.fingerprint(Priority::default())
        };
        let plain = of(json!({ "uploads": ["a", "b"] }));
        let added = |id: &str| of(json!({ "uploads": ["a", "b"], "add_to": id }));
        let text = "uploads\n\na\nb\n\n\n\n{}\n\n\n\n";
        assert_eq!(plain, blake3::hash(text.as_bytes()).to_hex().to_string());
        assert_ne!(added("c"), added("d"));
    }
}
