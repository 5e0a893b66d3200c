//! Routes that several parts of the API know.

/// Uploads in pieces.
pub(super) const UPLOADS: &str = "/v1/uploads";
/// One of them.
pub(super) const UPLOAD: &str = "/v1/uploads/{id}";
/// Addresses that are told of jobs.
pub(super) const WEBHOOKS: &str = "/v1/webhooks";
/// One of them.
pub(super) const WEBHOOK: &str = "/v1/webhooks/{id}";
/// The forms in which a job's result can be had.
pub(super) const EXPORTS: &str = "/v1/jobs/{id}/exports";
/// One of them.
pub(super) const EXPORT: &str = "/v1/jobs/{id}/exports/{name}";
/// The videos of a job's result.
pub(super) const VIDEOS: &str = "/v1/jobs/{id}/videos";
/// One of them.
pub(super) const VIDEO: &str = "/v1/jobs/{id}/videos/{video}";
/// Its file.
pub(super) const VIDEO_FILE: &str = "/v1/jobs/{id}/videos/{video}/file";
/// The machines that work.
pub(super) const WORKERS: &str = "/v1/workers";
