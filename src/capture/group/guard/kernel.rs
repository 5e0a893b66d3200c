//! Linux: the kernel kills a process whose parent ends.

use std::ffi::OsStr;
use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;

use rustix::process::{Signal, set_parent_process_death_signal};

use super::parent::{is_parent, orphaned};

pub fn die_with(parent: &OsStr) -> io::Result<()> {
    set_parent_process_death_signal(Some(Signal::KILL))?;
    // It may have ended before the request.
    if is_parent(parent) { Ok(()) } else { Err(orphaned()) }
}

/// Becomes the program, which ends with `parent`. Returns only on failure.
pub fn become_program(parent: &OsStr, command: &mut Command) -> io::Error {
    // The death signal survives `exec`.
    die_with(parent).map_or_else(|error| error, |()| command.exec())
}
