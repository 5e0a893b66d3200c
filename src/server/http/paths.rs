//! Paths used by several parts of the API.

/// Resumable uploads.
pub(super) const UPLOADS: &str = "/v1/uploads";
/// One upload.
pub(super) const UPLOAD: &str = "/v1/uploads/{id}";
/// One webhook.
pub(super) const WEBHOOK: &str = "/v1/webhooks/{id}";
/// The export formats of a job's result.
pub(super) const EXPORTS: &str = "/v1/jobs/{id}/exports";
/// One export.
pub(super) const EXPORT: &str = "/v1/jobs/{id}/exports/{name}";
/// The videos of a job's result.
pub(super) const VIDEOS: &str = "/v1/jobs/{id}/videos";
/// One video.
pub(super) const VIDEO: &str = "/v1/jobs/{id}/videos/{video}";
/// Its file.
pub(super) const VIDEO_FILE: &str = "/v1/jobs/{id}/videos/{video}/file";
/// Worker machines.
pub(super) const WORKERS: &str = "/v1/workers";
