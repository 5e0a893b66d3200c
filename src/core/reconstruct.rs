//! Training the splats of one round.

pub mod checkpoint;
pub mod densify;
pub mod initialise;
pub mod optimizer;
pub mod schedule;
