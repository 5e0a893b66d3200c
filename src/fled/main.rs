//! `fled`: dark, noisy, shaken photographs of a place to a 3D scene that one can walk around in.

mod assess_worker;
mod backup;
mod bench;
mod doctor;
mod eval;
mod export;
mod failure;
mod gc;
mod migrate;
mod models;
mod prepare;
mod progress;
mod remote;
mod render;
mod render_worker;
mod run;
mod serve;
mod shared;
mod suite;
mod synth;
mod token;
mod tools;
mod video;
mod worker;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use failure::Failure;
use fled_capture::group;
use fled_core::pipeline::error::ErrorKind;

/// Turns dark, noisy, shaken photographs of a place into a bright, sharp 3D scene.
#[derive(Parser)]
#[command(
    version,
    about,
    after_help = "Exit codes: 0 done, 2 wrong use, 3 bad capture, 4 environment, 1 anything else."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Reconstructs a capture. Repeat the command to continue a stopped run.
    Run(run::Args),
    /// Reads photographs once and keeps what a run needs of them: `fled run` takes its folder.
    Prepare(prepare::Args),
    /// Finds the poses of a capture; `fled run` with the same folder continues from them.
    Poses(run::Args),
    /// Renders a view of a finished run.
    Render(render::Args),
    /// Makes a video of a finished run's scene.
    Video(video::Args),
    /// Exports a finished run: restored views, a COLMAP model, or the scene in other formats.
    Export(export::Args),
    /// Makes a synthetic dark, shaken capture with ground truth.
    Synth(synth::Args),
    /// Starts the HTTP service with its dashboard and workers.
    Serve(serve::Args),
    /// Runs jobs of a service whose database and files several machines share.
    Worker(worker::Args),
    /// Submits a capture to a service, follows the job and downloads its result.
    Submit(remote::submit::Args),
    /// Follows a job of a service until it ends.
    Watch(remote::watch::Args),
    /// Downloads the files of a job. Repeat the command to continue a broken download.
    Fetch(remote::fetch::Args),
    /// Queues an ended job of a service again, with changed options if given.
    Retry(remote::retry::Args),
    /// Cancels a job of a service.
    Cancel(remote::cancel::Args),
    /// Copies the service's data directory while it is in use.
    Backup(backup::Args),
    /// Moves the service to PostgreSQL and its files to a shared file store.
    Migrate(migrate::Args),
    /// Removes what is no longer needed from the service's data directory.
    Gc(gc::Args),
    /// Creates, lists and revokes the service's tokens.
    Token(token::Args),
    /// Measures the cost of training and rendering on this machine, kernel by kernel.
    Bench(bench::Args),
    /// Evaluates a finished run against sharp photographs that it was not trained on.
    Eval(Box<eval::Args>),
    /// Lists and checks the deblurring networks.
    Models(models::Args),
    /// Checks what this machine has, what is missing, and how to fix it.
    Doctor(doctor::Args),
    /// Renders what the service asks for on standard input.
    #[command(hide = true)]
    RenderWorker,
    /// Looks at one upload for the service.
    #[command(hide = true)]
    AssessWorker,
    /// Becomes a program that ends with the process that asks for it.
    #[command(hide = true, name = group::GUARD)]
    Guard {
        /// The process that asks, the program and its arguments.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        command: Vec<OsString>,
    },
}

fn main() -> ExitCode {
    return_freed_pictures();
    silence_device_select();
    let cli = Cli::parse();
    if let Command::Guard { command } = &cli.command {
        return group::become_guarded(command);
    }
    group::declare_guard();
    if let Err(error) = fled_server::die_with_parent() {
        return Failure::new(ErrorKind::Internal, error).report();
    }
    let outcome = match cli.command {
        Command::Run(args) => run::main(&args, run::Extent::Whole),
        Command::Prepare(args) => prepare::main(&args),
        Command::Poses(args) => run::main(&args, run::Extent::Poses),
        Command::Render(args) => render::main(&args),
        Command::Video(args) => video::main(&args),
        Command::Export(args) => export::main(&args),
        Command::Synth(args) => synth::main(&args),
        Command::Serve(args) => serve::main(&args),
        Command::Worker(args) => worker::main(&args),
        Command::Submit(args) => remote::submit::main(&args),
        Command::Watch(args) => remote::watch::main(&args),
        Command::Fetch(args) => remote::fetch::main(&args),
        Command::Retry(args) => remote::retry::main(&args),
        Command::Cancel(args) => remote::cancel::main(&args),
        Command::Backup(args) => backup::main(&args),
        Command::Migrate(args) => migrate::main(&args),
        Command::Gc(args) => gc::main(&args),
        Command::Token(args) => token::main(&args),
        Command::Bench(args) => bench::main(&args),
        Command::Eval(args) => eval::main(&args),
        Command::Models(args) => models::main(&args),
        Command::Doctor(args) => doctor::main(&args),
        Command::RenderWorker => render_worker::main(),
        Command::AssessWorker => assess_worker::main(),
        // Handled above: the process that it becomes has another parent.
        Command::Guard { .. } => Ok(()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

/// Makes the allocator return freed pictures to the system at once. By default glibc keeps what has
/// the size of any block freed before: 60 photographs of 560 x 420 px took a third more memory.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code)]
fn return_freed_pictures() {
    const FROM_BYTES: i32 = 1 << 20;
    // SAFETY: called first in `main`, when no other thread exists; it sets a number, no pointer.
    // A refusal, which glibc does not document for this size, costs only memory.
    let _ = unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, FROM_BYTES) };
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn return_freed_pictures() {}

/// Without a desktop session, Mesa's device selection layer prints an error at every start. fled
/// selects its device itself.
#[allow(unsafe_code)]
fn silence_device_select() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: called first in `main`, when no other thread exists that could read the
        // environment.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
}
