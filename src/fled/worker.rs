//! `fled worker`: runs jobs of a service with a shared database and blob store.

use std::path::PathBuf;

use fled_core::device::{Device, host_memory};
use fled_core::pipeline::error::ErrorKind;
use fled_server::ServeConfig;
use fled_server::store::About;

use crate::failure::{Failure, io};
use crate::shared::{Shared, commands, log};
use crate::tools;

/// Arguments of `fled worker`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for this machine's copies of captures and results; missing ones are downloaded again.
    #[arg(long, value_name = "DIR", default_value = "worker")]
    data: PathBuf,
    #[command(flatten)]
    shared: Shared,
    /// Number of jobs to run at a time.
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// The device that this machine reports: auto, cpu, or part of a Vulkan adapter's name.
    #[arg(long, default_value = "auto")]
    adapter: String,
    #[command(flatten)]
    ffmpeg: tools::Ffmpeg,
    #[command(flatten)]
    models: tools::ModelFolder,
}

/// Runs jobs until SIGINT or SIGTERM; running jobs are then queued again with their progress.
///
/// # Errors
/// [`Failure`] if the data directory, the database or the blob store cannot be used.
pub fn main(args: &Args) -> Result<(), Failure> {
    log();
    let database = args.shared.database.as_deref();
    if database.is_none_or(|url| url.starts_with("sqlite:")) {
        return Err(Failure::usage(
            "a worker needs the service's database and files: set --db postgres://.. and --store",
        ));
    }
    let nowhere = std::net::SocketAddr::from(([127, 0, 0, 1], 0));
    let mut config =
        ServeConfig::new(args.data.clone(), nowhere, args.jobs).map_err(io(&args.data))?;
    args.shared.tell(&mut config);
    config.about = Some(about(&args.adapter, args.jobs));
    commands(&mut config, &args.ffmpeg, &args.models);
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    runtime.block_on(fled_server::work(config)).map_err(|e| Failure::new(ErrorKind::Io, e))
}

/// Describes this machine.
pub fn about(adapter: &str, jobs: usize) -> About {
    let found = Device::new(adapter).ok();
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    About {
        host: host.trim().to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        adapter: found.as_ref().map(ToString::to_string),
        has_gpu: found.is_some_and(|device| device.is_gpu()),
        cores: std::thread::available_parallelism().map_or(1, |cores| cores.get() as u32),
        memory: host_memory().unwrap_or(0),
        jobs: jobs as u32,
    }
}
