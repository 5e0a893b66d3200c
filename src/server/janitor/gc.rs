//! The rules, followed by hand, with a report.
//!
//! Beside a server only what it does not hold in its memory is touched, and nothing that has
//! changed within the hour.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::{Janitor, PERIOD};
use crate::data::DataDir;
use crate::error::{Result, ServerError};
use crate::store::Store;

/// What is to be done.
#[derive(Clone, Copy, Debug)]
pub struct GcOptions {
    /// Only report.
    pub dry_run: bool,
    /// How long what was moved aside is kept.
    pub unnamed: Duration,
    /// How long poses and novel views are kept that can be made again.
    pub caches: Duration,
}

/// Something that goes, or would go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gone {
    /// Where it lies, below the data directory.
    pub path: PathBuf,
    /// Bytes that are free then; none of what is moved aside.
    pub bytes: u64,
    /// Why, in words.
    pub why: &'static str,
}

/// What came of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Collected {
    /// Whether a server worked there: what it alone knows about stays.
    pub beside_server: bool,
    /// Bytes that the database gave back, or would.
    pub database: u64,
}

/// Frees what nobody wants in the data directory `root` and reports each thing.
///
/// # Errors
/// When there is no database in it, or one of another version; after all that can go has gone, also
/// when the database or the disk refused.
pub async fn gc(
    root: &Path,
    options: &GcOptions,
    report: &mut dyn FnMut(&Gone),
) -> Result<Collected> {
    let database = root.join("fled.db");
    // Without one all would be nameless.
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
        // Where no server works nothing is being made.
        made: if data.is_ours() {
            Duration::ZERO
        } else {
            PERIOD
        },
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
    Ok(Collected {
        beside_server: !data.is_ours(),
        database: given_back,
    })
}

/// The database with its log.
fn database_bytes(data: &DataDir) -> u64 {
    let database = data.database();
    let log = database.with_extension("db-wal");
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |about| about.len());
    bytes(&database) + bytes(&log)
}
