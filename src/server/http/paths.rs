//! Routes that several parts of the API know.

/// Uploads in pieces.
pub(super) const UPLOADS: &str = "/v1/uploads";
/// One of them.
pub(super) const UPLOAD: &str = "/v1/uploads/{id}";
/// Addresses that are told of jobs.
pub(super) const WEBHOOKS: &str = "/v1/webhooks";
/// One of them.
pub(super) const WEBHOOK: &str = "/v1/webhooks/{id}";
