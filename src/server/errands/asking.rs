//! A replica's side.

use std::cmp::Reverse;
use std::time::{Duration, Instant};

use fled_blobs::Blob;
use tokio::sync::Notify;
use uuid::Uuid;

use crate::app::App;
use crate::coordinator::{Errand, Kind, NamedFile, Outcome, Task, milliseconds};
use crate::error::{Result, ServerError};
use crate::store::{ErrandState, Store, WorkerRow, errands_bell};

/// Between two looks, whatever rings.
const LOOK: Duration = Duration::from_millis(250);
/// So many workers are asked for one thing.
const CHOSEN: usize = 2;
/// Who does not say for so many times as long as a worker may be silent that it waits is gone. A
/// stall of the database has both be silent, and must not end what both go on with.
const PATIENCE: i64 = 2;
/// Most bytes of a picture that a worker may have made.
const LARGEST_PICTURE: u64 = 64 << 20;

/// Lets workers make something of these files of a job; what they have made is in the store then.
/// `None` where none does it: who asks does it then.
///
/// # Errors
/// When the database refuses.
pub async fn ask(
    app: &App,
    job: &str,
    files: &[String],
    task: &Task,
    advance: impl Fn(u32, u32),
) -> Result<Option<Blob>> {
    // Who works on jobs has what it needs.
    if app.mirror.blobs().is_none() || app.config.workers > 0 {
        return Ok(None);
    }
    let workers = willing(app, job, task.kind()).await?;
    if workers.is_empty() {
        return Ok(None);
    }
    let mut named = Vec::new();
    for path in files {
        match app.store.job_file(job, path).await? {
            Some(file) => named.push(NamedFile::from(file)),
            None => return Ok(None),
        }
    }
    for worker in workers.iter().take(CHOSEN) {
        let errand = Errand {
            id: Uuid::now_v7().to_string(),
            job: job.to_owned(),
            files: named.clone(),
            task: task.clone(),
        };
        match ask_one(app, worker, &errand, &advance).await? {
            Some(Outcome::Made { digest, bytes }) if fits(app, task.kind(), bytes) => {
                return Ok(Some(Blob { digest, bytes }));
            }
            Some(outcome) => {
                tracing::warn!(
                    worker,
                    job,
                    ?outcome,
                    "a worker cannot do what it was asked"
                );
            }
            None => {
                tracing::warn!(worker, job, "a worker does not do what it was asked");
                app.unwilling
                    .note(&errands_bell(worker, task.kind().name()));
            }
        }
    }
    Ok(None)
}

/// Whether there is room for what a worker has made.
fn fits(app: &App, kind: Kind, bytes: u64) -> bool {
    (kind == Kind::Video || bytes <= LARGEST_PICTURE) && !app.has_no_space_for(bytes)
}

/// The workers that do such things, best first.
async fn willing(app: &App, job: &str, kind: Kind) -> Result<Vec<String>> {
    let heard = app.store.now().await? - milliseconds(app.limits.unheard);
    let mut workers = app.store.workers().await?;
    workers.retain(|worker| {
        let does = match kind {
            Kind::View => worker.about.renders,
            Kind::Video => worker.about.films,
        };
        let is_there = !worker.draining && worker.seen_at >= heard;
        let bell = errands_bell(&worker.id, kind.name());
        does && is_there && !app.unwilling.has(&bell, app.limits.lease)
    });
    workers.sort_by_cached_key(|worker| (Reverse(worker.about.has_gpu), rank(job, worker)));
    Ok(workers.into_iter().map(|worker| worker.id).collect())
}

/// An order of workers that is another for each job, and in which nobody changes places when
/// others come or go.
fn rank(job: &str, worker: &WorkerRow) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(job.as_bytes()).update(worker.id.as_bytes());
    *hasher.finalize().as_bytes()
}

/// Removes the question, however its asking ends: who does it stops then.
struct Question {
    store: Store,
    id: String,
}

impl Drop for Question {
    fn drop(&mut self) {
        let (store, id) = (self.store.clone(), std::mem::take(&mut self.id));
        tokio::spawn(async move {
            if let Err(error) = store.withdraw_errand(&id).await {
                tracing::warn!(%error, "what is asked for no more is forgotten later");
            }
        });
    }
}

/// What one worker makes of it; `None` where it does not take it up or is lost.
async fn ask_one(
    app: &App,
    worker: &str,
    errand: &Errand,
    advance: impl Fn(u32, u32),
) -> Result<Option<Outcome>> {
    let told = serde_json::to_string(errand).map_err(|error| damaged(&error))?;
    let kind = errand.task.kind().name();
    let life = PATIENCE * milliseconds(app.limits.errand);
    let bell = app.bells.of(&errand.id);
    let _question = Question {
        store: app.store.clone(),
        id: errand.id.clone(),
    };
    app.store
        .ask_errand(&errand.id, (worker, kind), &told, life)
        .await?;
    app.bells.ring(&errands_bell(worker, kind));
    answer(app, (worker, kind), &errand.id, &bell, advance).await
}

async fn answer(
    app: &App,
    of: (&str, &str),
    id: &str,
    bell: &Notify,
    advance: impl Fn(u32, u32),
) -> Result<Option<Outcome>> {
    let (mut idle, mut said) = (Instant::now(), Instant::now());
    loop {
        if said.elapsed() > app.limits.errand / 4 {
            said = Instant::now();
            let life = PATIENCE * milliseconds(app.limits.errand);
            app.store.want_errand(id, life).await?;
        }
        match app.store.errand(id).await? {
            Some(ErrandState::Answered(outcome)) => {
                let outcome = serde_json::from_str(&outcome);
                return outcome.map(Some).map_err(|error| damaged(&error));
            }
            Some(ErrandState::Taken { is_lost: true, .. }) | None => return Ok(None),
            Some(ErrandState::Taken { done, total, .. }) => advance(done, total),
            Some(ErrandState::Asked) => {
                // Who does another comes to this one after it.
                if app.store.is_on_errand(of).await? {
                    idle = Instant::now();
                }
                let patience = app.limits.errand / 3;
                if idle.elapsed() > patience && app.store.withdraw_untaken(id).await? {
                    return Ok(None);
                }
            }
        }
        tokio::select! {
            () = bell.notified() => {}
            () = tokio::time::sleep(LOOK) => {}
        }
    }
}

fn damaged(error: &serde_json::Error) -> ServerError {
    ServerError::Damaged {
        what: "errand",
        detail: error.to_string(),
    }
}
