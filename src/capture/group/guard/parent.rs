//! The parent of this process.

use std::ffi::OsStr;
use std::io;

use rustix::process::getppid;

/// Whether this process is still a child of the process with the id `parent`: others adopt orphans.
pub fn is_parent(parent: &OsStr) -> bool {
    let now = getppid().map(|pid| pid.as_raw_nonzero().get().to_string());
    now.is_some_and(|now| *parent == *now)
}

pub fn orphaned() -> io::Error {
    io::Error::other("what started this process is gone")
}
