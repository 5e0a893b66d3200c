//! The whole product through its binary: captures made here, real stages, real processes.

mod command_line;
mod job;
mod models;
mod service;
mod support;
mod unchanged;
