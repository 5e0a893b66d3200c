//! The service: HTTP API, jobs, their store and the dashboard.
//!
//! The API never computes: jobs, renders and the validation of uploads run in child processes, so
//! that a crash of a driver, a tool or a decoder leaves the API running.

mod adoption;
mod app;
mod backup;
mod blob_cache;
mod config;
mod copies;
pub mod data;
mod egress;
pub mod error;
mod failpoint;
mod http;
mod incoming;
mod janitor;
pub mod jobs;
mod migrate;
mod rate;
mod readiness;
mod redaction;
pub mod render;
mod serve;
pub mod store;
mod telemetry;
pub mod token;
mod upload_locks;
mod validation;
pub mod validator;
mod webhooks;

pub use backup::{Backup, backup};
pub use config::{Limits, Retention, ServeConfig};
pub use error::{Result, ServerError};
pub use failpoint::{Failpoint, Watcher};
pub use http::document as openapi_document;
#[doc(hidden)]
pub use http::read_tus_headers;
pub use janitor::{Collected, GcOptions, Gone, gc};
pub use jobs::parent_death::{GUARD, become_guarded, die_with_parent, guarded};
pub use migrate::{Migrated, migrate};
pub use serve::{Server, serve, work};
