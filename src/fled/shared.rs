//! Arguments that `fled serve`, `fled worker` and others share, and their common set-up.

use std::io::IsTerminal;

use fled_server::ServeConfig;
use tracing_subscriber::EnvFilter;

use crate::tools;

/// The database and the store of files.
#[derive(clap::Args, Clone, Debug)]
pub struct Shared {
    /// Database: sqlite:FILE, or postgres://USER:PASSWORD@HOST/NAME, which any number of machines
    /// can share [default: a file in --data].
    #[arg(long = "db", value_name = "URL", env = "FLED_DB", hide_env_values = true)]
    pub database: Option<String>,
    /// File store that machines share: a directory, or s3://BUCKET/PREFIX with credentials in the
    /// usual AWS_ variables. --data is then this machine's copy. Required with PostgreSQL.
    #[arg(long = "store", value_name = "PLACE", env = "FLED_STORE")]
    pub files: Option<String>,
}

impl Shared {
    /// Adds these settings to a server's configuration.
    pub fn tell(&self, config: &mut ServeConfig) {
        config.database.clone_from(&self.database);
        config.files.clone_from(&self.files);
    }
}

/// Logs to standard error, filtered by `RUST_LOG`.
pub fn log() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours)
        .with_writer(std::io::stderr)
        .init();
}

/// Sets the commands of child processes and the folders of networks.
pub fn commands(config: &mut ServeConfig, ffmpeg: &tools::Ffmpeg, models: &tools::ModelFolder) {
    // Deblurred views in full precision are large, and recomputed if other options need them.
    config.job_command.push("--discard-work".into());
    config.ffmpeg.clone_from(&ffmpeg.program);
    config.models = models.folders();
    for folder in &config.models {
        for command in [&mut config.job_command, &mut config.doctor_command] {
            command.extend(["--models".into(), folder.into()]);
        }
    }
}
