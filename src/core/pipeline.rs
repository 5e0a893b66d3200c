//! The pipeline: Algorithm 1, its options, its workspace and its errors.
//!
//! [`run`] is a function of its arguments alone: the capture, the options, the tools, the
//! workspace, the event sink and the cancellation token. Each stage of the loop is a file and a
//! function of explicit inputs that returns a value. Long stages leave their result in the
//! [`Workspace`] with a fingerprint of its inputs, so the same call after a crash resumes after the
//! last finished stage, and inside a round from the last checkpoint.
//!
//! [`Workspace`]: workspace::Workspace

mod context;
mod deblur;
mod decide;
mod deliver;
mod dependencies;
mod detail;
mod effective;
mod enhance;
mod evaluate;
mod exposures;
mod guide;
mod late_views;
mod match_brightness;
mod memory;
mod minutes;
mod pictures;
mod plan;
pub mod poses;
mod reconstruct;
mod render;
mod report;
mod restore;
mod round;
mod run;
mod shaken;
mod tone;
mod tools;
mod training_images;
pub mod views;

pub mod config;
pub mod error;
pub mod workspace;

pub use detail::check_detail;
pub use minutes::check_minutes;
pub use run::{Outcome, find_poses, run};
pub use tools::Tools;
