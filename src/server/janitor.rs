//! The janitor, which removes expired and unneeded files and rows. A server applies its rules at
//! the start and then every hour; `fled gc` applies them by hand.
//!
//! Files and rows cannot change together: a server that dies between the two leaves files without a
//! row, never a row without files. A database restored from an older backup also names fewer files
//! than exist. So orphans, which are captures, jobs and uploads without a row, are moved aside for
//! a while before they are deleted.

mod blobs;
mod cache;
mod files;
mod gc;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::app::App;
use crate::error::{Result, ServerError};
use crate::files::data::DataDir;
use crate::store::{Engine, Store};

pub use blobs::claim;
pub use gc::{Collected, GcOptions, Gone, gc};

/// Time between two rounds. Files changed within it stay: a new file may not have a row yet.
const PERIOD: Duration = Duration::from_secs(3600);
const DAY: Duration = Duration::from_secs(24 * 3600);
/// How long past webhook deliveries are kept, in milliseconds.
const DELIVERIES_KEPT_MS: i64 = 30 * 24 * 3600 * 1000;

#[derive(Clone, Copy, Debug)]
enum Name {
    Expired,
    ExpiredUploads,
    LostUploads,
    SpareUploads,
    OldOrphans,
    Orphans,
    Unfinished,
    Caches,
    Deliveries,
    Copies,
    Blobs,
}

struct Rule {
    name: Name,
    /// The reason for the removal.
    what: &'static str,
    /// Whether the rule applies.
    when: fn(&Janitor<'_>) -> bool,
}

/// The rules in the order of their application.
static RULES: [Rule; 11] = [
    Rule {
        name: Name::Expired,
        what: "past the time that the server keeps it",
        when: |at| at.serves,
    },
    Rule {
        name: Name::ExpiredUploads,
        what: "an upload that did not continue",
        // Only this directory's server knows which uploads are in progress.
        when: |at| at.data.is_ours(),
    },
    Rule {
        name: Name::LostUploads,
        what: "an upload whose file is missing",
        // The files of other machines' uploads lie elsewhere; rows of lost uploads expire.
        when: |at| at.app.is_some() && at.store.engine() == Engine::Sqlite,
    },
    Rule {
        name: Name::SpareUploads,
        what: "an upload that is empty or has become a capture",
        when: |_| true,
    },
    Rule { name: Name::OldOrphans, what: "moved aside long ago", when: |_| true },
    Rule {
        name: Name::Orphans,
        what: "moved to unnamed/: the database does not know it",
        when: |_| true,
    },
    Rule { name: Name::Unfinished, what: "unfinished", when: |_| true },
    Rule { name: Name::Caches, what: "cached long ago", when: |_| true },
    Rule {
        name: Name::Deliveries,
        what: "a webhook delivery from long ago",
        when: |at| at.serves && !at.dry_run,
    },
    Rule {
        name: Name::Copies,
        what: "a copy that was not used for a week",
        when: |at| at.store.engine() == Engine::Postgres,
    },
    Rule {
        name: Name::Blobs,
        what: "a blob that no file uses",
        // The rule lists the whole blob store, which would delay a start.
        when: |at| at.serves && !at.made.is_zero(),
    },
];

/// One round of the janitor.
struct Janitor<'a> {
    data: &'a DataDir,
    store: &'a Store,
    /// The server; `None` for `fled gc`.
    app: Option<&'a App>,
    /// Whether it removes shared files and rows: a worker does not know what to keep.
    serves: bool,
    /// Whether to report only.
    dry_run: bool,
    /// Files changed within this time stay under every rule.
    made: Duration,
    /// How long orphans are kept.
    orphans: Duration,
    /// How long caches are kept, whose files can be recreated.
    caches: Duration,
    report: &'a mut dyn FnMut(&Gone),
    /// Paths reported so far. In a dry run they still exist.
    reported: Vec<PathBuf>,
    /// The first error.
    failed: Option<ServerError>,
}

/// Applies the rules every hour until the server stops.
pub async fn keep_clean(app: Arc<App>, serves: bool) {
    loop {
        tokio::select! {
            () = tokio::time::sleep(PERIOD) => clean(app.clone(), serves, PERIOD).await,
            () = app.shutdown.cancelled() => return,
        }
    }
}

/// Applies the rules once. Files changed within `made` stay. `made` is zero before workers and
/// requests start: a file that has no row by then never gets one. Errors are logged and do not keep
/// a server from starting.
pub async fn clean(app: Arc<App>, serves: bool, made: Duration) {
    let runtime = tokio::runtime::Handle::current();
    let round = move || {
        let mut janitor = Janitor {
            data: &app.data,
            store: &app.store,
            app: Some(&app),
            serves,
            dry_run: false,
            made,
            orphans: 30 * DAY,
            caches: 30 * DAY,
            report: &mut |_| {},
            reported: Vec::new(),
            failed: None,
        };
        runtime.block_on(async {
            tokio::select! {
                () = janitor.follow_all() => {}
                () = app.shutdown.cancelled() => {}
            }
        });
    };
    // A round blocks on the disk.
    if let Err(error) = tokio::task::spawn_blocking(round).await {
        tracing::error!(%error, "the janitor was interrupted");
    }
}

impl Janitor<'_> {
    async fn follow_all(&mut self) {
        for rule in &RULES {
            if (rule.when)(self) {
                match self.follow(rule).await {
                    Err(error) => self.fail(rule, error),
                    Ok(0) => {}
                    Ok(removed) => tracing::info!(rule = ?rule.name, removed, "{}", rule.what),
                }
            }
        }
    }

    /// Returns the number of removed items.
    async fn follow(&mut self, rule: &Rule) -> Result<usize> {
        let now = self.store.now().await?;
        let found = match (rule.name, self.app) {
            (Name::Expired, app) => self.expired(rule, app, now).await?,
            (Name::ExpiredUploads, app) => self.expired_uploads(app, now).await?,
            (Name::LostUploads, _) => return self.forget_lost_uploads().await,
            (Name::Deliveries, _) => {
                let before = now - DELIVERIES_KEPT_MS;
                return self.store.forget_deliveries(before).await.map(|()| 0);
            }
            (Name::Copies, Some(app)) => return cache::remove_unused(app, 7 * DAY).await,
            (Name::Blobs, Some(app)) => return blobs::follow(app).await,
            (of_files, _) => self.find(of_files).await?,
        };
        let gone = found.into_iter().map(|path| self.remove(rule, path));
        Ok(gone.filter(|gone| *gone).count())
    }

    /// A server first marks the rows, so that nothing is deleted without notice.
    async fn expired(&mut self, rule: &Rule, app: Option<&App>, now: i64) -> Result<Vec<PathBuf>> {
        if let Some(app) = app {
            let retention = &app.config.retention;
            // Deletion helps even if the disk is too full to mark rows.
            if let Err(error) = self.store.mark_expiring(retention, now).await {
                self.fail(rule, error);
            }
            // With retention off, rows marked earlier stay as well.
            if retention.is_off() {
                return Ok(Vec::new());
            }
        }
        let expired = self.store.delete_expired(now, self.dry_run).await?;
        if let Some(app) = app {
            expired.jobs.iter().for_each(|id| app.running.stop(id));
        }
        let jobs = expired.jobs.iter().map(|id| self.data.job(id));
        let captures = expired.captures.iter().map(|id| self.data.capture(id));
        Ok(jobs.chain(captures).collect())
    }

    async fn expired_uploads(&self, app: Option<&App>, now: i64) -> Result<Vec<PathBuf>> {
        let mut found = Vec::new();
        for id in self.store.expired_uploads(now).await? {
            // An upload in use stays, even if a piece takes longer than that.
            let is_in_use = app.is_some_and(|app| app.upload_locks.contains(&id));
            if !is_in_use && (self.dry_run || self.store.forget_upload(&id, Some(now)).await?) {
                found.push(self.data.upload(&id));
            }
        }
        Ok(found)
    }

    /// Removes the rows of uploads whose files are missing: the file of an upload is created before
    /// its row and deleted after it.
    async fn forget_lost_uploads(&self) -> Result<usize> {
        let mut lost = 0;
        for id in self.store.ids("uploads").await? {
            let path = self.data.upload(&id);
            let is_there = path.try_exists().map_err(ServerError::io(&path))?;
            if !is_there && self.store.forget_upload(&id, None).await? {
                tracing::warn!(upload = id, "upload forgotten: its file is missing");
                lost += 1;
            }
        }
        Ok(lost)
    }

    fn fail(&mut self, rule: &Rule, error: ServerError) {
        tracing::warn!(rule = ?rule.name, %error, "cannot remove what is no longer needed");
        self.failed.get_or_insert(error);
    }
}
