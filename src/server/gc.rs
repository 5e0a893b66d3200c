//! What the sweeper does by the hour, done now, and told.
//!
//! Beside a server only what it does not hold in its memory is touched, and nothing that has
//! changed within the hour.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::data::{DataDir, bytes_below};
use crate::error::{Result, ServerError};
use crate::store::{Store, now_ms};
use crate::sweep::{Ages, DELIVERIES_KEPT_MS, Named, PERIOD, Why, rules};

/// What is to be done.
#[derive(Clone, Copy, Debug)]
pub struct GcOptions {
    /// Tell only.
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

/// Frees what nobody wants in the data directory `root` and tells of each thing.
///
/// # Errors
/// When there is no database in it, or one of another version; when the database or the disk
/// refuses, after what was told.
pub async fn gc(
    root: &Path,
    options: &GcOptions,
    tell: &mut (dyn FnMut(&Gone) + Send),
) -> Result<Collected> {
    let database = root.join("fled.db");
    // Without one all would be nameless.
    fs::metadata(&database).map_err(ServerError::io(&database))?;
    let data = DataDir::beside(root)?;
    let store = Store::as_it_is(&data.database()).await?;
    store.check_version().await?;
    let mut work = Work {
        data: &data,
        store: &store,
        options,
        seen: Vec::new(),
        tell,
    };
    work.expired().await?;
    if data.is_ours() {
        work.expired_uploads().await?;
    }
    let named = Named::in_store(&store).await?;
    work.leftovers(&named)?;
    if !options.dry_run {
        store
            .forget_deliveries(now_ms() - DELIVERIES_KEPT_MS)
            .await?;
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

struct Work<'a> {
    data: &'a DataDir,
    store: &'a Store,
    options: &'a GcOptions,
    /// What was told already: in a dry run it is still there.
    seen: Vec<PathBuf>,
    tell: &'a mut (dyn FnMut(&Gone) + Send),
}

impl Work<'_> {
    /// Jobs and captures that the server had marked, and whose time has come.
    async fn expired(&mut self) -> Result<()> {
        let now = now_ms();
        let expired = if self.options.dry_run {
            self.store.expired(now).await?
        } else {
            self.store.delete_expired(now).await?
        };
        let jobs = expired.jobs.iter().map(|id| self.data.job(id));
        let captures = expired.captures.iter().map(|id| self.data.capture(id));
        let gone: Vec<PathBuf> = jobs.chain(captures).collect();
        for path in gone {
            self.remove(&path, "kept as long as the server was told to")?;
        }
        Ok(())
    }

    async fn expired_uploads(&mut self) -> Result<()> {
        let now = now_ms();
        for id in self.store.expired_uploads(now).await? {
            if self.options.dry_run || self.store.forget_upload(&id, Some(now)).await? {
                self.remove(
                    &self.data.upload(&id),
                    "an upload of which nothing more came",
                )?;
            }
        }
        Ok(())
    }

    fn leftovers(&mut self, named: &Named) -> Result<()> {
        let ages = Ages {
            // Where no server works nothing is being made.
            made: if self.data.is_ours() {
                Duration::ZERO
            } else {
                PERIOD
            },
            unnamed: self.options.unnamed,
            poses: self.options.caches,
            renders: Some(self.options.caches),
        };
        let nobody = |_: &Path| false;
        let uses = self
            .data
            .is_ours()
            .then_some(&nobody as &dyn Fn(&Path) -> bool);
        for rule in rules(self.data, named, ages, uses) {
            for path in rule.find()? {
                let bytes = match rule.why {
                    Why::Unnamed => 0,
                    _ => bytes_of(&path)?,
                };
                let is_told = self.seen.iter().any(|seen| path.starts_with(seen));
                if is_told || !self.options.dry_run && !rule.follow(&path)? {
                    continue;
                }
                self.tell(path, bytes, words(rule.why));
            }
        }
        Ok(())
    }

    fn remove(&mut self, path: &Path, why: &'static str) -> Result<()> {
        let bytes = bytes_of(path)?;
        if !self.options.dry_run {
            let removed = if path.is_dir() {
                fs::remove_dir_all(path)
            } else {
                fs::remove_file(path)
            };
            match removed {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(ServerError::io(path)(error));
                }
                _ => {}
            }
        }
        self.tell(path.to_owned(), bytes, why);
        Ok(())
    }

    fn tell(&mut self, path: PathBuf, bytes: u64, why: &'static str) {
        let below = path.strip_prefix(self.data.root()).unwrap_or(&path);
        (self.tell)(&Gone {
            path: below.to_owned(),
            bytes,
            why,
        });
        self.seen.push(path);
    }
}

fn words(why: Why) -> &'static str {
    match why {
        Why::Unnamed => "moved to unnamed/: the database does not name it",
        Why::Aside => "moved aside long ago",
        Why::Unfinished => "unfinished",
        Why::Spare => "an upload that is empty or has become a capture",
        Why::Poses => "poses that were found long ago",
        Why::Render => "a view that was rendered long ago",
    }
}

/// What is free once this is gone: nothing of a file that has another name, or is gone.
fn bytes_of(path: &Path) -> Result<u64> {
    use std::os::unix::fs::MetadataExt;
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(0),
        Ok(about) if about.is_dir() => bytes_below(path).map_err(ServerError::io(path)),
        Ok(about) => Ok(if about.nlink() > 1 { 0 } else { about.len() }),
        Err(error) => Err(ServerError::io(path)(error)),
    }
}

/// The database with its log.
fn database_bytes(data: &DataDir) -> u64 {
    let database = data.database();
    let log = database.with_extension("db-wal");
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |about| about.len());
    bytes(&database) + bytes(&log)
}
