//! `fled cancel`: stops a job of a service.

use serde::Deserialize;

use super::Remote;
use crate::failure::Failure;

/// Arguments of `fled cancel`.
#[derive(clap::Args)]
pub struct Args {
    /// The job's id, as `fled submit` printed it.
    job: String,
    #[command(flatten)]
    remote: super::Args,
}

#[derive(Deserialize)]
struct Job {
    state: String,
}

/// Asks for the job to be stopped.
///
/// # Errors
/// [`Failure`] in the service's own words, also where the job is over.
pub fn main(args: &Args) -> Result<(), Failure> {
    let remote = Remote::new(&args.remote)?;
    let job: Job = remote.post(&format!("/v1/jobs/{}/cancel", args.job), None)?;
    eprintln!("the job is {}", job.state);
    Ok(())
}
