//! Suites: captures x configurations x seeds, every run judged by sharp photographs, and what can
//! be said of the differences.
//!
//! `file` is what a suite asks for, `setup` knows all that decides a run, `records` is what
//! is done already, `runner` does the rest in order; `statistics` and `table` say what came of
//! it. Nothing here starts a process: whoever carries a suite out hands in who does.

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
