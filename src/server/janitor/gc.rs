//! The janitor's rules, applied manually, with a report.
//!
//! Beside a running server, it leaves alone all that only the server knows in memory, and all that
//! has changed within the last hour.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::{Janitor, PERIOD};
use crate::error::{Result, ServerError};
use crate::files::data::DataDir;
use crate::store::Store;

/// Options of [`gc`].
#[derive(Clone, Copy, Debug)]
pub struct GcOptions {
    /// Whether to report only.
    pub dry_run: bool,
    /// How long orphans are kept.
    pub unnamed: Duration,
    /// How long cached poses and novel views are kept.
    pub caches: Duration,
}

/// An item that was or would be removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gone {
    /// Its path below the data directory.
    pub path: PathBuf,
    /// Bytes freed; 0 for an item that is moved aside.
    pub bytes: u64,
    /// The reason.
    pub why: &'static str,
}

/// The outcome of [`gc`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Collected {
    /// Whether a server was running: items that only it knows about stay.
    pub beside_server: bool,
    /// Bytes freed, or to be freed, by compacting the database.
    pub database: u64,
}

/// Removes what is no longer needed in the data directory `root`, and reports each item.
///
/// # Errors
/// When `root` has no database or one of another schema version. A failed removal or query is
/// returned after everything else has been removed.
pub async fn gc(
    root: &Path,
    options: &GcOptions,
    report: &mut dyn FnMut(&Gone),
) -> Result<Collected> {
    let database = root.join("fled.db");
    // Without a database everything would be an orphan.
    fs::metadata(&database).map_err(ServerError::io(&database))?;
    let data = DataDir::beside(root)?;
    let store = Store::as_it_is(&data.database()).await?;
    store.check_version().await?;
    let mut janitor = Janitor {
        data: &data,
        store: &store,
        app: None,
        serves: true,
        dry_run: options.dry_run,
        // Without a server, nothing is being created.
        made: if data.is_ours() { Duration::ZERO } else { PERIOD },
        orphans: options.unnamed,
        caches: options.caches,
        report,
        reported: Vec::new(),
        failed: None,
    };
    janitor.follow_all().await;
    if let Some(failed) = janitor.failed {
        return Err(failed);
    }
    let given_back = match (data.is_ours(), options.dry_run) {
        (false, _) => 0,
        (true, true) => store.unused_bytes().await?,
        (true, false) => {
            let before = database_bytes(&data);
            store.compact().await?;
            before.saturating_sub(database_bytes(&data))
        }
    };
    store.close().await;
    Ok(Collected { beside_server: !data.is_ours(), database: given_back })
}

/// Bytes of the database including its log.
fn database_bytes(data: &DataDir) -> u64 {
    let database = data.database();
    let log = database.with_extension("db-wal");
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |about| about.len());
    bytes(&database) + bytes(&log)
}
