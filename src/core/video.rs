//! Videos of a finished scene: a camera path through it, and its pictures as H.264.

mod encode;
mod flight;
mod plan;
mod spline;

pub use encode::{EncodeError, Target, write};
pub use plan::{Key, Kind, MOST_FPS, MOST_POSES, MOST_SECONDS, MOST_SIDE, Plan, PlanError};

#[cfg(test)]
mod tests;
