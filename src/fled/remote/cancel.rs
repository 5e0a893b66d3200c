//! `fled cancel`: stops a job of a service.

use super::Remote;
use crate::failure::Failure;

/// Arguments of `fled cancel`.
#[derive(clap::Args)]
pub struct Args {
    /// ID of the job, as printed by `fled submit`.
    job: String,
    #[command(flatten)]
    remote: super::Args,
}

/// Requests the cancellation of the job.
///
/// # Errors
/// [`Failure`] with the service's own message, including for a job that is over.
pub fn main(args: &Args) -> Result<(), Failure> {
    let remote = Remote::new(&args.remote)?;
    let state = remote.order(&args.job, "cancel", None)?;
    eprintln!("the job is {state}");
    Ok(())
}
