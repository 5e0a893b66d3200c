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
/// What workers ask that reach the service by HTTP alone.
pub(super) const WORK: &str = "/v1/work/";
/// One of them.
pub(super) const WORK_WORKER: &str = "/v1/work/workers/{worker}";
/// What it ran before it began anew.
pub(super) const WORK_RELEASE: &str = "/v1/work/workers/{worker}/release";
/// It wants a job.
pub(super) const WORK_CLAIM: &str = "/v1/work/workers/{worker}/claim";
/// It wants something else to do.
pub(super) const WORK_ERRAND: &str = "/v1/work/workers/{worker}/errand";
/// It does it.
pub(super) const WORK_ERRANDS: &str = "/v1/work/workers/{worker}/errands/{errand}";
/// It has done it.
pub(super) const WORK_OUTCOME: &str = "/v1/work/workers/{worker}/errands/{errand}/outcome";
/// It lives.
pub(super) const WORK_HEARTBEAT: &str = "/v1/work/jobs/{job}/heartbeat";
/// It tells of its job.
pub(super) const WORK_TOLD: &str = "/v1/work/jobs/{job}/told";
/// An attempt fails.
pub(super) const WORK_FAILURES: &str = "/v1/work/jobs/{job}/failures";
/// An attempt ends.
pub(super) const WORK_SETTLE: &str = "/v1/work/jobs/{job}/settle";
/// The files of its job.
pub(super) const WORK_FILES: &str = "/v1/work/jobs/{job}/files";
/// The files of its job's capture.
pub(super) const WORK_CAPTURE: &str = "/v1/work/jobs/{job}/capture";
/// The bytes of a file.
pub(super) const WORK_BLOB: &str = "/v1/work/blobs/{digest}";
/// The machines that work.
pub(super) const WORKERS: &str = "/v1/workers";
