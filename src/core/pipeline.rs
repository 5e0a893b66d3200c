//! The job: Algorithm 1, its options, its workspace and its errors.
//!
//! [`run`] is a function: what it reads, what it may use, where it may write, whom to tell and
//! when to stop are its arguments. Each stage of the loop is a file and a function of explicit
//! inputs that returns a value. What takes long leaves its result in the [`Workspace`] with a
//! fingerprint of what it was made from, so the same call after a crash goes on from the last
//! finished stage, and inside a round from the last checkpoint.
//!
//! [`Workspace`]: workspace::Workspace

mod context;
mod deblur;
mod deliver;
mod dependencies;
mod enhance;
mod evaluate;
mod explained;
mod guide;
mod late_views;
mod match_brightness;
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
pub mod views;

pub mod config;
pub mod error;
pub mod workspace;

pub use run::{Outcome, find_poses, run};
pub use tools::Tools;
