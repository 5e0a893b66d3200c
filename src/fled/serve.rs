//! `fled serve`: the API, the dashboard and the workers.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use fled_core::pipeline::error::ErrorKind;
use fled_server::ServeConfig;

use crate::failure::{Failure, io};
use crate::shared::{Shared, commands, log};
use crate::tools;
use crate::worker::about;

/// Arguments of `fled serve`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for captures, jobs and the database.
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    #[command(flatten)]
    shared: Shared,
    /// Address to listen on. Any but this machine's own requires a token (`fled token create`).
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Accepts other machines without a token: anyone who can reach the server may use it.
    #[arg(long)]
    open: bool,
    /// Host name that requests may use besides localhost and addresses, as browsers and proxies
    /// send it in Host; may be repeated.
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// Number of jobs to run at a time. 0 leaves all jobs to `fled worker`.
    #[arg(long, value_name = "N", default_value_t = 1)]
    workers: usize,
    /// Deletes jobs this many days after they ended, and captures of that age without jobs. The
    /// dashboard announces it a week before; pinned jobs are kept. By default everything is kept.
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..))]
    keep_days: Option<u32>,
    /// Keeps only this many of the newest ended jobs of each owner. Deletion is announced a week
    /// before.
    #[arg(long, value_name = "N")]
    keep_jobs: Option<u32>,
    /// Read requests that one client may make per second on average; a write counts as ten. 0 means
    /// no limit.
    #[arg(long, value_name = "N", default_value_t = fled_server::Limits::default().rate)]
    rate: u32,
    /// Also allows webhooks to addresses in internal networks: anyone who may create a webhook can
    /// then make the server call whatever it can reach.
    #[arg(long)]
    inner_webhooks: bool,
    #[command(flatten)]
    ffmpeg: tools::Ffmpeg,
    #[command(flatten)]
    models: tools::ModelFolder,
}

/// Serves until SIGINT or SIGTERM; running jobs resume at the next start.
///
/// # Errors
/// [`Failure`] when the data directory or the address cannot be used.
pub fn main(args: &Args) -> Result<(), Failure> {
    log();
    let mut config =
        ServeConfig::new(args.data.clone(), args.listen, args.workers).map_err(io(&args.data))?;
    config.hosts.clone_from(&args.hosts);
    config.open = args.open;
    config.inner_webhooks = args.inner_webhooks;
    config.limits.rate = args.rate;
    let days = args.keep_days.map(u64::from);
    config.retention.age = days.map(|days| Duration::from_secs(days * 24 * 3600));
    config.retention.jobs = args.keep_jobs;
    args.shared.tell(&mut config);
    if args.shared.database.is_some() && args.workers > 0 {
        config.about = Some(about("auto", args.workers));
    }
    commands(&mut config, &args.ffmpeg, &args.models);
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    runtime.block_on(fled_server::serve(config)).map_err(|e| Failure::new(ErrorKind::Io, e))
}
