//! `fled worker`: works on the jobs of a service whose database and files many machines share, or
//! of one that is reached by HTTP alone.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use fled_core::pipeline::error::ErrorKind;
use fled_gpu::{DeviceType, Gpu};
use fled_server::store::About;
use fled_server::token::Secret;
use fled_server::{ServeConfig, Service};

use crate::failure::{Failure, io};
use crate::remote::token;
use crate::shared::{Shared, commands, log};
use crate::tools;

/// Arguments of `fled worker`.
#[derive(clap::Args)]
pub struct Args {
    /// This machine's copies of captures and results; they are fetched again where they are gone.
    #[arg(long, value_name = "DIR", default_value = "worker")]
    data: PathBuf,
    #[command(flatten)]
    shared: Shared,
    /// The service, where its database cannot be reached from here: https://HOST, or
    /// http://ADDRESS:PORT in a network that nobody else listens to. Files go the same way.
    #[arg(
        long,
        value_name = "URL",
        env = "FLED_API",
        conflicts_with_all = ["database", "files"]
    )]
    api: Option<String>,
    /// A file that holds a token of the scope worker for --api; without it the variable FLED_TOKEN
    /// does, where one is needed.
    #[arg(long, value_name = "FILE", requires = "api")]
    token_file: Option<PathBuf>,
    /// Jobs run at once.
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// Part of an adapter's name, or auto: what this machine says that it trains on.
    #[arg(long, default_value = "auto")]
    adapter: String,
    #[command(flatten)]
    ffmpeg: tools::Ffmpeg,
    #[command(flatten)]
    models: tools::ModelFolder,
}

/// Works until SIGINT or SIGTERM; what runs then goes back to the queue with what is done of it.
///
/// # Errors
/// [`Failure`] when the data directory, the database or the store cannot be used.
pub fn main(args: &Args) -> Result<(), Failure> {
    log();
    if args.shared.database.is_none() && args.api.is_none() {
        return Err(Failure::usage(
            "a worker needs the service's database and files, --db postgres://.. and --store, or \
             the service itself: --api https://..",
        ));
    }
    let nowhere = std::net::SocketAddr::from(([127, 0, 0, 1], 0));
    let mut config =
        ServeConfig::new(args.data.clone(), nowhere, args.jobs).map_err(io(&args.data))?;
    args.shared.tell(&mut config);
    if let Some(url) = &args.api {
        config.service = Some(Service {
            url: url.clone(),
            token: token(args.token_file.as_deref())?.map(|token| Secret::shown(&token)),
        });
    }
    config.about = Some(about(&args.adapter, args.jobs, &args.ffmpeg.program));
    commands(&mut config, &args.ffmpeg, &args.models);
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    runtime
        .block_on(fled_server::work(config))
        .map_err(|e| Failure::new(ErrorKind::Io, e))
}

/// What this machine has.
pub fn about(adapter: &str, jobs: usize, ffmpeg: &Path) -> About {
    let found = Gpu::new(adapter);
    let found = found.as_ref().map(Gpu::describe).ok();
    let renders = found.is_some();
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    About {
        host: host.trim().to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        adapter: found.map(ToString::to_string),
        has_gpu: found.is_some_and(|adapter| {
            !matches!(adapter.device_type, DeviceType::Cpu | DeviceType::Other)
        }),
        cores: std::thread::available_parallelism().map_or(1, |cores| cores.get() as u32),
        memory: memory().unwrap_or(0),
        jobs: jobs as u32,
        renders,
        films: renders && answers(ffmpeg),
    }
}

/// Whether there is such a program.
fn answers(program: &Path) -> bool {
    let mut command = Command::new(program);
    command.arg("-version").stdin(Stdio::null());
    let silent = command.stdout(Stdio::null()).stderr(Stdio::null());
    silent.status().is_ok_and(|status| status.success())
}

/// Bytes of this machine's memory, where it says so.
fn memory() -> Option<u64> {
    let told = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = told
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}
