//! Suites: captures x configurations x seeds. Sharp photographs judge every run, and statistics
//! compare the configurations.
//!
//! `file` is the suite's file, `setup` collects all inputs of a run, `records` keeps finished runs,
//! `runner` makes the missing ones in order; `statistics` and `table` report the results. Nothing
//! here starts a process: the caller provides a function for that.

pub mod content;
pub mod error;
pub mod file;
pub mod outcome;
pub mod records;
pub mod runner;
pub mod setup;
pub mod statistics;
pub mod summary;
pub mod table;
#[cfg(test)]
mod tests;
