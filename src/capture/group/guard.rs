//! The guard against a parent's death: a process ends when its parent ends, for whatever reason.

use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::process::CommandExt;
use std::path::{Path, absolute};
use std::process::{Command, ExitCode};

use rustix::process::{Signal, getppid, set_parent_process_death_signal};

/// The subcommand that turns this program into another one: see [`become_guarded`].
pub const GUARD: &str = "guard";

/// Exit codes that shells use if a program is not found or cannot be started.
const NOT_FOUND: u8 = 127;
const NOT_STARTED: u8 = 126;

/// Asks the kernel to end this process when its parent, the process with the id `parent`, ends for
/// whatever reason.
///
/// # Errors
/// If the parent has already gone, or the kernel refuses.
pub fn die_with(parent: &OsStr) -> io::Result<()> {
    set_parent_process_death_signal(Some(Signal::KILL))?;
    // It may have ended before the request.
    let now = getppid().map(|pid| pid.as_raw_nonzero().get().to_string());
    if now.is_some_and(|now| *parent == *now) {
        return Ok(());
    }
    Err(io::Error::other("what started this process is gone"))
}

/// Returns a command that starts `program`, with the arguments that follow, in a process that ends
/// with this one. Start it from a thread that lives as long as that process may live: the kernel
/// watches the thread.
///
/// # Errors
/// When the path of the running program is unknown.
pub fn guarded(program: &Path) -> io::Result<Vec<OsString>> {
    let own = std::env::current_exe()?;
    // A bare name is looked up in `PATH`; a path must be valid from any directory.
    let program = match program.components().count() {
        0 | 1 => program.to_owned(),
        _ => absolute(program)?,
    };
    let parent = std::process::id().to_string();
    Ok(vec![own.into(), GUARD.into(), parent.into(), program.into()])
}

/// Becomes the program named by [`guarded`], whose `arguments` follow [`GUARD`]. Returns only on
/// failure, with the exit code of a shell.
pub fn become_guarded(arguments: &[OsString]) -> ExitCode {
    let [parent, program, arguments @ ..] = arguments else {
        eprintln!("give a process to end with, a program and its arguments");
        return ExitCode::FAILURE;
    };
    // The death signal survives `exec`.
    let error = match die_with(parent) {
        Ok(()) => Command::new(program).args(arguments).exec(),
        Err(error) => error,
    };
    eprintln!("{error}");
    ExitCode::from(match error.kind() {
        io::ErrorKind::NotFound => NOT_FOUND,
        _ => NOT_STARTED,
    })
}
