//! The job: Algorithm 1, its options, its workspace and its errors.

pub mod config;
pub mod error;
