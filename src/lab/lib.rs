//! Evaluation of the pipeline: runs against sharp photographs, suites of runs with intervals, and
//! times of training and rendering kernel by kernel.
//!
//! It is not part of the product: only the command line uses it.

pub mod bench;
pub mod evaluation;
