//! `fled migrate`: moves the service to PostgreSQL, and its files to a shared blob store.

use std::path::PathBuf;

use fled_core::pipeline::error::ErrorKind;
use fled_server::ServerError;

use crate::failure::Failure;
use crate::shared::log;

/// Arguments of `fled migrate`.
#[derive(clap::Args)]
pub struct Args {
    /// Data directory of the service. No server may be using it.
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// New, empty database: postgres://USER:PASSWORD@HOST/NAME.
    #[arg(long = "db", value_name = "URL", env = "FLED_DB", hide_env_values = true)]
    database: String,
    /// New, empty file store that machines share: a directory, or s3://BUCKET/PREFIX with
    /// credentials in the usual AWS_ variables.
    #[arg(long = "store", value_name = "PLACE", env = "FLED_STORE")]
    files: String,
}

/// Copies rows and files.
///
/// # Errors
/// [`Failure`] if a server uses the data directory, the database or the blob store is not empty, or
/// something cannot be read or written; the database then has no rows.
pub fn main(args: &Args) -> Result<(), Failure> {
    log();
    if !args.data.join("fled.db").is_file() {
        let detail =
            format!("{} has no fled.db, so it is not a data directory", args.data.display());
        return Err(Failure::usage(detail));
    }
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    let done = runtime
        .block_on(fled_server::migrate(&args.data, &args.database, &args.files))
        .map_err(|error| failed(&error))?;
    eprintln!(
        "{} rows copied to the database, and {} files, {:.1} MB, to the store",
        done.rows,
        done.files,
        done.bytes as f64 / 1e6
    );
    if done.uploads > 0 {
        eprintln!("{} unfinished uploads were not moved", done.uploads);
    }
    Ok(())
}

fn failed(error: &ServerError) -> Failure {
    let mut failure = Failure::new(ErrorKind::Io, error);
    if matches!(error, ServerError::NotMoved(_) | ServerError::DataInUse(_)) {
        failure.kind = ErrorKind::BadInput;
        failure.hint = String::new();
    }
    failure
}
