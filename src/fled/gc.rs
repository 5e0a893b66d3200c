//! `fled gc`: removes what is no longer needed from the service's data directory, and lists it.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use fled_core::pipeline::error::ErrorKind;
use fled_server::GcOptions;

use crate::failure::Failure;

const DAY: Duration = Duration::from_secs(24 * 3600);

/// Arguments of `fled gc`.
#[derive(clap::Args)]
pub struct Args {
    /// Data directory of the service. It may be in use.
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// Only reports what would be removed.
    #[arg(long)]
    dry_run: bool,
    /// Days to keep captures, jobs and uploads in `unnamed/`.
    #[arg(long, value_name = "DAYS", default_value_t = 30)]
    unnamed_days: u32,
    /// Days to keep cached poses and rendered views, which can be made again.
    #[arg(long, value_name = "DAYS", default_value_t = 30)]
    cache_days: u32,
}

/// Removes what is no longer needed.
///
/// # Errors
/// [`Failure`] if there is no data directory of this version, or something cannot be removed.
pub fn main(args: &Args) -> Result<(), Failure> {
    if !args.data.join("fled.db").is_file() {
        let detail =
            format!("{} has no fled.db, so it is not a data directory", args.data.display());
        return Err(Failure::usage(detail));
    }
    let options = GcOptions {
        dry_run: args.dry_run,
        unnamed: DAY * args.unnamed_days,
        caches: DAY * args.cache_days,
    };
    let (mut count, mut bytes) = (0, 0);
    let mut out = std::io::stdout();
    let mut printed = Ok(());
    let mut report = |gone: &fled_server::Gone| {
        count += 1;
        bytes += gone.bytes;
        let size = megabytes(gone.bytes);
        let line = writeln!(out, "{size:>12}  {}  {}", gone.path.display(), gone.why);
        printed = line.and(std::mem::replace(&mut printed, Ok(())));
    };
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    let done = runtime
        .block_on(fled_server::gc(&args.data, &options, &mut report))
        .map_err(|error| Failure::new(ErrorKind::Io, error))?;
    printed.map_err(|error| Failure::new(ErrorKind::Io, error))?;
    let verb = if args.dry_run { "would free" } else { "freed" };
    eprintln!(
        "{count} items: {verb} {}, and {} in the database",
        megabytes(bytes),
        megabytes(done.database)
    );
    if done.beside_server {
        eprintln!(
            "A server is using this directory: what changed within the last hour, unfinished \
             uploads and free space in the database are left to it."
        );
    }
    Ok(())
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}
