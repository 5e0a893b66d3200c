//! What is measured, per round: method.md section 7.

pub mod report;

pub use report::{Brightness, ImageKind, Record, Reference, Report, RoundMetrics};
