//! The service: HTTP API, jobs, their store and the dashboard.
//!
//! The API never computes: jobs, renders and the validation of uploads run in child processes, so
//! that the API survives a crash of a driver, a tool or a decoder.

mod app;
mod config;
pub mod error;
mod failpoint;
mod files;
mod http;
mod janitor;
mod memory;
mod process;
mod rate;
mod redaction;
pub mod render;
mod sample;
mod serve;
mod sharing;
pub mod store;
mod telemetry;
pub mod token;
mod transfer;
mod validation;
pub mod validator;
mod webhooks;
mod worker;

pub use config::{Limits, ServeConfig};
pub use error::{Result, ServerError};
pub use failpoint::{Failpoint, Watcher};
pub use http::document as openapi_document;
#[doc(hidden)]
pub use http::read_tus_headers;
pub use janitor::{Collected, GcOptions, Gone, gc};
pub use process::die_with_parent;
pub use serve::{Server, serve, work};
pub use store::Retention;
pub use transfer::{Backup, Migrated, backup, migrate};
