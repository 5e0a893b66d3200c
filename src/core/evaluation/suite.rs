//! Suites: captures x configurations x seeds, every run judged by sharp photographs, and what can
//! be said of the differences.
//!
//! `file` is what a suite asks for, `laboratory` knows all that decides a run, `records` is what
//! is done already, `carry_out` does the rest in order; `statistics` and `table` say what came of
//! it. Nothing here starts a process: whoever carries a suite out hands in who does.

pub mod carry_out;
pub mod content;
pub mod error;
pub mod file;
pub mod laboratory;
pub mod outcome;
pub mod records;
pub mod statistics;
pub mod summary;
pub mod table;
#[cfg(test)]
mod tests;
