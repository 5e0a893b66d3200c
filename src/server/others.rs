//! The other processes that work together: hearing of what they do, and being seen by them.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::MissedTickBehavior;

use crate::app::App;
use crate::error::Result;
use crate::store::News;

/// Between two looks of all streams, whatever is heard.
const BELL: Duration = Duration::from_millis(50);
/// A worker that was not heard of for so long is forgotten, milliseconds.
const FORGOTTEN_MS: i64 = 24 * 3600 * 1000;

/// Wakes who waits in this process when somebody else changes a job, until the server stops. What
/// it is told is a hint: it looks by itself every few seconds, too.
pub async fn keep_hearing(app: Arc<App>) {
    while !app.shutdown.is_cancelled() {
        if let Err(error) = hear(&app).await {
            tracing::warn!(%error, "cannot listen to the database: looking by itself");
        }
        tokio::select! {
            () = tokio::time::sleep(app.limits.look) => {}
            () = app.shutdown.cancelled() => {}
        }
        ring(&app);
    }
}

async fn hear(app: &App) -> Result<()> {
    let Some(mut heard) = app.store.listen().await? else {
        return Ok(());
    };
    // What happened while nobody listened.
    ring(app);
    let mut look = tokio::time::interval(app.limits.look);
    let mut bell = tokio::time::interval(BELL);
    bell.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut has_changed = false;
    loop {
        tokio::select! {
            // Of a thousand jobs that run something is heard all the time, which is no work for
            // those who wait for some.
            news = heard.next() => match news? {
                News::Waiting => ring(app),
                News::Changed => has_changed = true,
            },
            _ = bell.tick(), if has_changed => {
                has_changed = false;
                app.changed();
            }
            _ = look.tick() => ring(app),
            () = app.shutdown.cancelled() => return Ok(()),
        }
    }
}

fn ring(app: &App) {
    app.changed();
    // Of the workers here one is enough for one job, and each looks by itself, too.
    app.wake.notify_one();
}

/// Says again and again that this worker is there, and forgets those that have not been for long.
pub async fn keep_being_seen(app: Arc<App>) {
    let Some(about) = &app.config.about else {
        return;
    };
    let see = async |draining| {
        app.store.see_worker(&app.worker, about, draining).await?;
        let before = app.store.now().await? - FORGOTTEN_MS;
        app.store.forget_workers(None, before).await
    };
    let mut every = tokio::time::interval(app.limits.heartbeat.max(Duration::from_millis(1)));
    loop {
        tokio::select! {
            _ = every.tick() => {}
            () = app.shutdown.cancelled() => {
                // Until what runs has ended, and the worker is gone.
                if let Err(error) = see(true).await {
                    tracing::warn!(%error, "cannot say that this worker stops");
                }
                return;
            }
        }
        if let Err(error) = see(false).await {
            tracing::warn!(%error, "cannot say that this worker is there");
        }
    }
}
