//! The guard against a parent's death: a process ends when its parent ends, for whatever reason.

#[cfg(windows)]
mod job;
#[cfg(target_os = "linux")]
mod kernel;
#[cfg(unix)]
mod parent;
#[cfg(all(unix, any(test, not(target_os = "linux"))))]
mod watch;

use std::ffi::{OsStr, OsString};
use std::io;
use std::path::{Path, absolute};
use std::process::{Command, ExitCode};
use std::sync::atomic::{AtomicBool, Ordering};

#[cfg(windows)]
use job as system;
#[cfg(target_os = "linux")]
use kernel as system;
#[cfg(all(unix, not(target_os = "linux")))]
use watch as system;

/// The subcommand that turns this program into another one: see [`become_guarded`].
pub const GUARD: &str = "guard";

/// Exit codes that shells use if a program is not found or cannot be started.
const NOT_FOUND: u8 = 127;
const NOT_STARTED: u8 = 126;

/// Makes this process end when its parent, the process with the id `parent`, ends for whatever
/// reason: on Linux by the kernel, on Windows by the job that it is in, elsewhere by a thread that
/// looks for the parent.
///
/// # Errors
/// If the parent has already gone, or the system refuses.
pub fn die_with(parent: &OsStr) -> io::Result<()> {
    system::die_with(parent)
}

/// Returns a command that starts `program`, with the arguments that follow, in a process that ends
/// with this one. Start it from a thread that lives as long as that process may live: Linux watches
/// the thread.
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

/// Whether this program has the subcommand [`GUARD`]; tests have not.
static HAS_GUARD: AtomicBool = AtomicBool::new(false);

/// Declares that this program has the subcommand [`GUARD`].
pub fn declare_guard() {
    HAS_GUARD.store(true, Ordering::Relaxed);
}

/// A command that starts `program`, by [`guarded`] if this program has declared its guard.
///
/// # Errors
/// As [`guarded`].
pub fn ending_with_this(program: &Path) -> io::Result<Command> {
    if !HAS_GUARD.load(Ordering::Relaxed) {
        return Ok(Command::new(program));
    }
    let words = guarded(program)?;
    let mut command = Command::new(&words[0]);
    command.args(&words[1..]);
    Ok(command)
}

/// Becomes the program named by [`guarded`], whose `arguments` follow [`GUARD`]. Returns only on
/// failure, with the exit code of a shell.
pub fn become_guarded(arguments: &[OsString]) -> ExitCode {
    let [parent, program, arguments @ ..] = arguments else {
        eprintln!("give a process to end with, a program and its arguments");
        return ExitCode::FAILURE;
    };
    let error = system::become_program(parent, Command::new(program).args(arguments));
    eprintln!("{error}");
    ExitCode::from(match error.kind() {
        io::ErrorKind::NotFound => NOT_FOUND,
        _ => NOT_STARTED,
    })
}
