//! Windows: what a [`Group`](super::super::Group) starts is in a job object that the system kills
//! with the process that started it.

use std::ffi::OsStr;
use std::io;
use std::process::{Command, exit};

/// The job has done it.
pub fn die_with(_: &OsStr) -> io::Result<()> {
    Ok(())
}

/// Stands for the program, which is in the same job, and ends as it does. Returns only on failure.
pub fn become_program(_: &OsStr, command: &mut Command) -> io::Error {
    match command.status() {
        Ok(status) => exit(status.code().unwrap_or(1)),
        Err(error) => error,
    }
}
