//! What judges the pipeline: runs against sharp photographs, suites of runs with intervals, and
//! times of training and rendering kernel by kernel.
//!
//! None of it is part of the product: only the command line uses it.

pub mod bench;
pub mod evaluation;
