//! Removes what nobody wants any more: one list of rules, which a server follows at its start and
//! every hour, and `fled gc` by hand.
//!
//! Files and rows cannot change together: a server that dies between the two leaves files without
//! a row, never a row without files. A database that was restored from an older copy names less
//! than there is, too. So orphans, which are captures, jobs and uploads without a row, are kept
//! aside for a while before they go.

mod blobs;
mod copies;
mod files;
mod gc;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::app::App;
use crate::data::DataDir;
use crate::error::{Result, ServerError};
use crate::store::{Engine, Store};

pub use blobs::claim;
pub use files::delete;
pub use gc::{Collected, GcOptions, Gone, gc};

/// Between two rounds. What has changed within it stays: what is being made has no row yet.
const PERIOD: Duration = Duration::from_secs(3600);
const DAY: Duration = Duration::from_secs(24 * 3600);
/// What webhooks were told is known for so long, milliseconds.
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
    /// What goes.
    what: &'static str,
    /// When the rule is followed at all.
    when: fn(&Janitor<'_>) -> bool,
}

/// In the order in which they are followed.
static RULES: [Rule; 11] = [
    Rule {
        name: Name::Expired,
        what: "kept as long as the server was told to",
        when: |at| at.serves,
    },
    Rule {
        name: Name::ExpiredUploads,
        what: "an upload of which nothing more came",
        // Only its server knows which of them are under way.
        when: |at| at.data.is_ours(),
    },
    Rule {
        name: Name::LostUploads,
        what: "an upload whose file is not there",
        // Others' lie elsewhere; rows of those that are lost go with their time.
        when: |at| at.app.is_some() && at.store.engine() == Engine::Sqlite,
    },
    Rule {
        name: Name::SpareUploads,
        what: "an upload that is empty or has become a capture",
        when: |_| true,
    },
    Rule {
        name: Name::OldOrphans,
        what: "moved aside long ago",
        when: |_| true,
    },
    Rule {
        name: Name::Orphans,
        what: "moved to unnamed/: the database does not name it",
        when: |_| true,
    },
    Rule {
        name: Name::Unfinished,
        what: "unfinished",
        when: |_| true,
    },
    Rule {
        name: Name::Caches,
        what: "found or rendered long ago",
        when: |_| true,
    },
    Rule {
        name: Name::Deliveries,
        what: "told by webhooks long ago",
        when: |at| at.serves && !at.dry_run,
    },
    Rule {
        name: Name::Copies,
        what: "a copy that was not used for a week",
        when: |at| at.store.engine() == Engine::Postgres,
    },
    Rule {
        name: Name::Blobs,
        what: "a blob that no file has",
        // The whole store is listed for it, which no start waits for.
        when: |at| at.serves && !at.made.is_zero(),
    },
];

/// One round.
struct Janitor<'a> {
    data: &'a DataDir,
    store: &'a Store,
    /// The server that it is of; `None` of `fled gc`.
    app: Option<&'a App>,
    /// Whether it removes what all share: a worker does not know what is to be kept.
    serves: bool,
    /// Only reports.
    dry_run: bool,
    /// Files that have changed within this stay, whatever the rule.
    made: Duration,
    /// How long orphans are kept aside.
    orphans: Duration,
    /// How long is kept what is made again when it is wanted.
    caches: Duration,
    report: &'a mut dyn FnMut(&Gone),
    /// What it has reported: in a dry run it is still there.
    reported: Vec<PathBuf>,
    /// The first thing that went wrong.
    failed: Option<ServerError>,
}

/// Follows the rules every hour until the server stops.
pub async fn keep_clean(app: Arc<App>, serves: bool) {
    loop {
        tokio::select! {
            () = tokio::time::sleep(PERIOD) => clean(app.clone(), serves, PERIOD).await,
            () = app.shutdown.cancelled() => return,
        }
    }
}

/// Follows the rules. Files that have changed within `made` stay; before there are workers and
/// requests that is nothing: what has no row then will never have one. What goes wrong is in
/// the log, and keeps no server from starting.
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
    // It waits for the disk, which no other task may wait for.
    if let Err(error) = tokio::task::spawn_blocking(round).await {
        tracing::error!(%error, "the janitor broke off");
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

    /// How many things went.
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
            (Name::Copies, Some(app)) => return copies::remove_unused(app, 7 * DAY).await,
            (Name::Blobs, Some(app)) => return blobs::follow(app).await,
            (of_files, _) => self.find(of_files).await?,
        };
        let gone = found.into_iter().map(|path| self.remove(rule, path));
        Ok(gone.filter(|gone| *gone).count())
    }

    /// A server marks first, so that nothing goes that it has not announced for a while.
    async fn expired(&mut self, rule: &Rule, app: Option<&App>, now: i64) -> Result<Vec<PathBuf>> {
        if let Some(app) = app {
            let retention = &app.config.retention;
            // Deleting is what helps where the disk is too full to mark.
            if let Err(error) = self.store.mark_expiring(retention, now).await {
                self.fail(rule, error);
            }
            // Where nothing may be deleted any more, what was marked is not deleted either.
            if retention.is_off() {
                return Ok(Vec::new());
            }
        }
        let expired = self.store.delete_expired(now, self.dry_run).await?;
        if let Some(app) = app {
            expired.jobs.iter().for_each(|id| app.videos.stop_all(id));
            app.changed();
        }
        let jobs = expired.jobs.iter().map(|id| self.data.job(id));
        let captures = expired.captures.iter().map(|id| self.data.capture(id));
        Ok(jobs.chain(captures).collect())
    }

    async fn expired_uploads(&self, app: Option<&App>, now: i64) -> Result<Vec<PathBuf>> {
        let mut found = Vec::new();
        for id in self.store.expired_uploads(now).await? {
            // A piece that has taken longer than that is no reason.
            let is_held = app.is_some_and(|app| app.holders.has(&id));
            if !is_held && (self.dry_run || self.store.forget_upload(&id, Some(now)).await?) {
                found.push(self.data.upload(&id));
            }
        }
        Ok(found)
    }

    /// The file of an upload is made before its row and goes after it.
    async fn forget_lost_uploads(&self) -> Result<usize> {
        let mut lost = 0;
        for id in self.store.ids("uploads").await? {
            let path = self.data.upload(&id);
            let is_there = path.try_exists().map_err(ServerError::io(&path))?;
            if !is_there && self.store.forget_upload(&id, None).await? {
                tracing::warn!(upload = id, "forgotten: its file is not there");
                lost += 1;
            }
        }
        Ok(lost)
    }

    fn fail(&mut self, rule: &Rule, error: ServerError) {
        tracing::warn!(rule = ?rule.name, %error, "cannot remove what nobody wants");
        self.failed.get_or_insert(error);
    }
}

/// Removes the file or the folder of something that is no longer in the database. Its loss of name
/// is what counts; what cannot be removed is in the log.
pub async fn remove(path: &Path) {
    let from = path.to_owned();
    let removed = tokio::task::spawn_blocking(move || delete(&from)).await;
    if let Err(error) = removed.unwrap_or_else(|error| Err(std::io::Error::other(error))) {
        tracing::warn!(%error, path = %path.display(), "cannot remove");
    }
}
