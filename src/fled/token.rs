//! `fled token`: access to the service.

use std::io::Write;
use std::path::PathBuf;

use fled_core::pipeline::error::ErrorKind;
use fled_server::ServerError;
use fled_server::store::{NewToken, Quotas, Store, TokenRow, now_ms};
use fled_server::token::{Scopes, Secret, TokenError, expiry, new_id, shown, size};

use crate::failure::{Failure, io};

/// Arguments of `fled token`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Creates a token and prints it once. From the first token on, the service requires one.
    Create(Create),
    /// Lists tokens with name, scopes, creation, last use and expiry.
    List {
        #[command(flatten)]
        data: Data,
    },
    /// Revokes a token immediately.
    Revoke {
        #[command(flatten)]
        data: Data,
        /// ID from the first column of `fled token list`.
        id: String,
    },
}

#[derive(clap::Args)]
struct Create {
    #[command(flatten)]
    data: Data,
    /// Scopes, separated by commas: jobs:read, jobs:write, renders, admin (everything).
    #[arg(long, value_name = "SCOPES")]
    scope: String,
    /// Validity, such as 90d or 12h [default: unlimited].
    #[arg(long, value_name = "TIME")]
    expires: Option<String>,
    /// Name of the owner: tokens of the same name see the same captures and jobs.
    #[arg(long, default_value = "")]
    name: String,
    /// Disk space for the owner's captures and results, such as 20G [default: unlimited].
    #[arg(long, value_name = "SIZE")]
    quota_bytes: Option<String>,
    /// Number of the owner's jobs that may wait or run at a time [default: unlimited].
    #[arg(long, value_name = "N")]
    quota_jobs: Option<u32>,
}

#[derive(clap::Args)]
struct Data {
    /// Data directory of the service. It may be in use.
    #[arg(long = "data", value_name = "DIR", default_value = "data")]
    dir: PathBuf,
    /// Database of the service if it is not in --data: postgres://USER:PASSWORD@HOST/NAME.
    #[arg(long = "db", value_name = "URL", env = "FLED_DB", hide_env_values = true)]
    database: Option<String>,
}

/// Creates, lists or revokes tokens.
///
/// # Errors
/// [`Failure`] for an invalid scope or duration, an unknown token, or a database that cannot be
/// used.
pub fn main(args: &Args) -> Result<(), Failure> {
    let runtime =
        tokio::runtime::Runtime::new().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    runtime.block_on(async {
        match &args.command {
            Command::Create(args) => create(args).await,
            Command::List { data } => list(data).await,
            Command::Revoke { data, id } => revoke(data, id).await,
        }
    })
}

async fn create(args: &Create) -> Result<(), Failure> {
    let scopes: Scopes = args.scope.parse().map_err(wrong)?;
    let expires_at = args.expires.as_deref().map(expiry);
    let expires_at = expires_at.transpose().map_err(wrong)?;
    let bytes = args.quota_bytes.as_deref().map(size);
    let quotas = Quotas { bytes: bytes.transpose().map_err(wrong)?, jobs: args.quota_jobs };
    let secret = Secret::new().map_err(wrong)?;
    let id = new_id().map_err(wrong)?;
    let store = open(&args.data).await?;
    let token = NewToken {
        id,
        name: args.name.clone(),
        digest: secret.digest(),
        scopes,
        expires_at,
        quotas,
    };
    store.insert_token(&token).await.map_err(failed)?;
    store.close().await;
    eprintln!("Token {} has the scopes {}. It is shown only this once:", token.id, token.scopes);
    say(secret.reveal())
}

async fn list(data: &Data) -> Result<(), Failure> {
    let store = existing(data).await?;
    let tokens = store.tokens().await.map_err(failed)?;
    store.close().await;
    if tokens.is_empty() {
        eprintln!("There are no tokens. Create one with `fled token create`.");
    }
    let now = now_ms();
    tokens.iter().try_for_each(|token| say(&line(token, now)))
}

fn line(token: &TokenRow, now: i64) -> String {
    let end = match (token.revoked_at, token.expires_at) {
        (Some(at), _) => format!("revoked {}", shown(at)),
        (None, Some(at)) if at <= now => format!("expired {}", shown(at)),
        (None, Some(at)) => format!("expires {}", shown(at)),
        (None, None) => "never expires".to_owned(),
    };
    let used =
        token.last_used_at.map_or("never used".to_owned(), |at| format!("last used {}", shown(at)));
    let bytes = token.quotas.bytes.map(|bytes| format!(", {} MB", bytes / 1_000_000));
    let jobs = token.quotas.jobs.map(|jobs| format!(", {jobs} jobs"));
    format!(
        "{}  {}  created {}, {used}, {end}{}{}  {}",
        token.id,
        token.scopes,
        shown(token.created_at),
        bytes.unwrap_or_default(),
        jobs.unwrap_or_default(),
        token.name
    )
}

async fn revoke(data: &Data, id: &str) -> Result<(), Failure> {
    let store = existing(data).await?;
    let ended = store.revoke_token(id).await.map_err(failed)?;
    store.close().await;
    if !ended {
        return Err(Failure::usage(format!(
            "no valid token has the ID {id}; `fled token list` lists the tokens"
        )));
    }
    eprintln!("token {id} is revoked");
    Ok(())
}

/// Opens the store of a directory that a server or `fled token create` has used.
async fn existing(data: &Data) -> Result<Store, Failure> {
    let dir = &data.dir;
    if data.database.is_none() && !dir.join("fled.db").is_file() {
        let detail = format!("{} has no fled.db, so it is not a data directory", dir.display());
        return Err(Failure::usage(detail));
    }
    open(data).await
}

async fn open(data: &Data) -> Result<Store, Failure> {
    let store = match &data.database {
        Some(url) => Store::at(url).await,
        None => {
            std::fs::create_dir_all(&data.dir).map_err(io(&data.dir))?;
            Store::open(&data.dir.join("fled.db")).await
        }
    };
    store.map_err(failed)
}

fn wrong(error: TokenError) -> Failure {
    match error {
        TokenError::NoRandomness(_) => Failure::new(ErrorKind::Environment, error),
        TokenError::UnknownScope(_) | TokenError::BadExpiry(_) | TokenError::BadSize(_) => {
            Failure::usage(error)
        }
    }
}

fn failed(error: ServerError) -> Failure {
    Failure::new(ErrorKind::Io, error)
}

fn say(text: &str) -> Result<(), Failure> {
    writeln!(std::io::stdout(), "{text}").map_err(|error| Failure::new(ErrorKind::Io, error))
}
