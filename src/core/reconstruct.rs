//! Training the splats of one round.

pub mod densify;
pub mod schedule;
