//! The service: HTTP API, jobs, their store and the dashboard.
//!
//! The API never computes: a job runs in a child process of its own, renders come from another
//! child, so that a crash of a driver or of a tool leaves the API standing.

mod app;
mod backup;
mod config;
pub mod data;
pub mod error;
mod expiry;
mod holders;
mod http;
mod incoming;
mod intake;
pub mod jobs;
mod rate;
mod readiness;
mod removal;
pub mod render;
mod running;
mod serve;
pub mod store;
mod sweep;
mod telemetry;
pub mod token;
mod uploads;
pub mod videos;
mod webhooks;
mod wording;

pub use backup::{Backup, backup};
pub use config::{Limits, Retention, ServeConfig};
pub use error::{Result, ServerError};
pub use http::document as openapi_document;
pub use jobs::process::die_with_parent;
pub use serve::{Server, serve};
