//! `fled backup`: a copy of the service's data directory.

use std::path::PathBuf;

use fled_core::pipeline::error::ErrorKind;

use crate::failure::Failure;

/// Arguments of `fled backup`.
#[derive(clap::Args)]
pub struct Args {
    /// Data directory of the service. It may be in use.
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// New folder for the copy. Restore it with `fled serve --data`.
    to: PathBuf,
}

/// Copies the data directory.
///
/// # Errors
/// [`Failure`] when something cannot be read or written; the copy is then incomplete.
pub fn main(args: &Args) -> Result<(), Failure> {
    if !args.data.join("fled.db").is_file() {
        let detail =
            format!("{} has no fled.db, so it is not a data directory", args.data.display());
        return Err(Failure::usage(detail));
    }
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    let done = runtime.block_on(fled_server::backup(&args.data, &args.to)).map_err(|error| {
        let mut failure = Failure::new(ErrorKind::Io, error);
        failure.hint = format!("Remove {} and try again.", args.to.display());
        failure
    })?;
    eprintln!(
        "{} captures and {} jobs, {:.1} MB, copied to {}",
        done.captures,
        done.jobs,
        done.bytes as f64 / 1e6,
        args.to.display()
    );
    if done.anew > 0 {
        eprintln!("{} waiting or running jobs start again there", done.anew);
    }
    Ok(())
}
