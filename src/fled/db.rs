//! `fled db`: moves the service to another database, and its files to a store that machines share.

use std::path::PathBuf;

use fled_core::pipeline::error::ErrorKind;
use fled_server::{Import, ServerError};

use crate::failure::Failure;
use crate::shared::log;

/// Arguments of `fled db`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Writes all rows of the database to a file. No server may work meanwhile.
    Export(Export),
    /// Brings such a file into an empty database, and the files of the data directory that it was
    /// made of into a store of files. All of it, or nothing: it may be done again.
    Import(ImportArgs),
    /// Says that a store of files belongs to this database, after another was found to use it, or
    /// the database was restored from a backup. What this one does not name is deleted there.
    Own(Own),
}

#[derive(clap::Args)]
struct Here {
    /// The service's data directory.
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// The service's database where it is not in --data.
    #[arg(
        long = "db",
        value_name = "URL",
        env = "FLED_DB",
        hide_env_values = true
    )]
    database: Option<String>,
}

#[derive(clap::Args)]
struct Export {
    #[command(flatten)]
    here: Here,
    /// A new file. It has the secrets of webhooks in it.
    #[arg(long, value_name = "FILE")]
    to: PathBuf,
}

#[derive(clap::Args)]
struct ImportArgs {
    /// The data directory that was exported, where files lie in it and in no store yet. Nothing of
    /// it is changed.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// The new database, empty: postgres://USER:PASSWORD@HOST/NAME, or sqlite:FILE.
    #[arg(
        long = "db",
        value_name = "URL",
        env = "FLED_DB",
        hide_env_values = true
    )]
    database: String,
    /// Where files are kept that machines share: a directory, or s3://BUCKET/PREFIX with
    /// credentials by the usual AWS_ variables.
    #[arg(long = "store", value_name = "PLACE", env = "FLED_STORE")]
    files: String,
    /// What `fled db export` wrote.
    file: PathBuf,
}

#[derive(clap::Args)]
struct Own {
    #[command(flatten)]
    here: Here,
    /// The store: a directory, or s3://BUCKET/PREFIX with credentials by the usual AWS_ variables.
    #[arg(long = "store", value_name = "PLACE", env = "FLED_STORE")]
    files: String,
}

/// Writes or reads the file, or marks a store.
///
/// # Errors
/// [`Failure`] when a server works there, a database is not empty, the file is damaged, or
/// something cannot be read or written.
pub fn main(args: &Args) -> Result<(), Failure> {
    log();
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    match &args.command {
        Command::Export(args) => runtime.block_on(export(args)),
        Command::Import(args) => runtime.block_on(import(args)),
        Command::Own(args) => runtime.block_on(own(args)),
    }
}

impl Here {
    /// The database that is named; where none is, one must be in the data directory: none is made.
    fn database(&self) -> Result<Option<&str>, Failure> {
        let database = self.database.as_deref();
        if database.is_none() && !self.data.join("fled.db").is_file() {
            return Err(Failure::usage(format!(
                "{} holds no fled.db: it is no data directory",
                self.data.display()
            )));
        }
        Ok(database)
    }
}

async fn own(args: &Own) -> Result<(), Failure> {
    let database = args.here.database()?;
    let place = fled_server::own(&args.here.data, database, &args.files).await;
    let place = place.map_err(|error| failed(&error))?;
    eprintln!("{place} belongs to this database");
    Ok(())
}

async fn export(args: &Export) -> Result<(), Failure> {
    let database = args.here.database()?;
    let done = fled_server::export(&args.here.data, database, &args.to).await;
    let done = done.map_err(|error| failed(&error))?;
    eprintln!("{} rows are in {}", done.rows, args.to.display());
    if done.uploads > 0 {
        eprintln!(
            "{} uploads of which no capture is made yet are not in it",
            done.uploads
        );
    }
    Ok(())
}

async fn import(args: &ImportArgs) -> Result<(), Failure> {
    let import = Import {
        file: args.file.clone(),
        data: args.data.clone(),
        database: args.database.clone(),
        files: args.files.clone(),
    };
    let done = fled_server::import(&import).await;
    let done = done.map_err(|error| failed(&error))?;
    eprintln!(
        "{} rows are in the database, {} files, {:.1} MB, in the store",
        done.rows,
        done.files,
        done.bytes as f64 / 1e6
    );
    if done.released > 0 {
        eprintln!("{} jobs that ran wait now", done.released);
    }
    if done.videos > 0 {
        eprintln!(
            "{} unfinished videos have to be asked for again",
            done.videos
        );
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
