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
    /// Where captures, jobs and the database are kept.
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    #[command(flatten)]
    shared: Shared,
    /// Address to listen on. Others than this machine's own need a token (`fled token create`).
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Listens to other machines although there is no token: whoever reaches it may use it.
    #[arg(long)]
    open: bool,
    /// A name by which the server may be called, besides localhost and addresses: what browsers
    /// and proxies send as Host. May be repeated.
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// Jobs run at once. With 0 others work, by `fled worker`.
    #[arg(long, value_name = "N", default_value_t = 1)]
    workers: usize,
    /// Deletes jobs that ended so many days ago, and captures so old that have no job. A week
    /// before it says so; pinned jobs stay. All is kept when absent.
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..))]
    keep_days: Option<u32>,
    /// Deletes jobs that ended, but the newest so many of each owner. A week before it says so.
    #[arg(long, value_name = "N")]
    keep_jobs: Option<u32>,
    /// Requests that read which one client may make a second, in the long run; one that writes
    /// counts as ten. 0 limits nobody.
    #[arg(long, value_name = "N", default_value_t = fled_server::Limits::default().rate)]
    rate: u32,
    /// Tells webhooks of addresses of inner networks, too: whoever may make one can then have the
    /// server knock at whatever it reaches.
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
    runtime
        .block_on(fled_server::serve(config))
        .map_err(|e| Failure::new(ErrorKind::Io, e))
}
