//! A worker's side.

use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use fled_blobs::{Kept, pull};
use fled_core::run_folder::RunFolder;
use fled_core::video::Plan;
use tokio::sync::Notify;
use tokio::time::MissedTickBehavior;

use crate::coordinator::{Errand, Headway, Kind, Outcome, Task};
use crate::copies::{scene_copy, used_now};
use crate::error::{Result, ServerError};
use crate::removal::remove;
use crate::render::RenderRequest;
use crate::store::errands_bell;
use crate::videos::film::{End, Film};
use crate::wording::without_paths;
use crate::workshop::Workshop;

/// After a fault of the database or the service.
const RECOVERY: Duration = Duration::from_secs(2);

/// Does what replicas ask for, one after the other, until the worker stops.
pub async fn keep_doing(work: Workshop, kind: Kind) {
    let bell = work.bells.of(&errands_bell(&work.worker, kind.name()));
    loop {
        let next = tokio::select! {
            next = work.coordinator.next_errand(&work.worker, kind) => next,
            () = work.shutdown.cancelled() => return,
        };
        let pause = match next {
            Ok(Some(errand)) => {
                do_one(&work, &errand).await;
                continue;
            }
            Ok(None) => work.coordinator.errand_pause(&work.limits),
            Err(error) => {
                tracing::warn!(%error, "cannot look for views and videos to be made");
                RECOVERY
            }
        };
        tokio::select! {
            () = bell.notified() => {}
            () = tokio::time::sleep(pause) => {}
            () = work.shutdown.cancelled() => return,
        }
    }
}

/// Does it and says what came of it, and meanwhile that it is being done.
async fn do_one(work: &Workshop, errand: &Errand) {
    let progress = Progress::default();
    let stop = Notify::new();
    let making = make(work, errand, &progress, &stop);
    tokio::pin!(making);
    let mut ticks = tokio::time::interval(work.limits.errand / 4);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut heard = Instant::now();
    let outcome = loop {
        tokio::select! {
            made = &mut making => break made,
            _ = ticks.tick() => {
                let headway = progress.headway();
                match work.coordinator.extend_errand(&work.worker, &errand.id, headway).await {
                    Ok(true) => heard = Instant::now(),
                    Ok(false) => stop.notify_one(),
                    Err(error) => {
                        tracing::warn!(%error, "cannot say how far it is");
                        // Who asked takes it for lost by now, or is gone.
                        if heard.elapsed() > work.limits.errand {
                            stop.notify_one();
                        }
                    }
                }
            }
        }
    };
    let outcome = outcome.unwrap_or_else(|error| {
        tracing::warn!(%error, job = errand.job, "a view or a video was not made");
        let detail = without_paths(&error.to_string());
        Outcome::Failed { detail }
    });
    let told = work
        .coordinator
        .answer_errand(&work.worker, &errand.id, &outcome);
    if let Err(error) = told.await {
        tracing::warn!(%error, "cannot say what came of a view or a video");
    }
}

async fn make(
    work: &Workshop,
    errand: &Errand,
    progress: &Progress,
    stop: &Notify,
) -> Result<Outcome> {
    if work.is_disk_full() {
        let detail = "the worker's disk is full".to_owned();
        return Ok(Outcome::Failed { detail });
    }
    let making = work.data.errand(&errand.id).ok_or_else(|| bad("id"))?;
    let scene = work.data.scene(&errand.job).ok_or_else(|| bad("job"))?;
    fetch(work, errand, &scene).await?;
    let io = ServerError::io(&making);
    tokio::fs::create_dir_all(&making).await.map_err(io)?;
    let outcome = match &errand.task {
        Task::View { .. } => {
            tokio::select! {
                made = view(work, errand, &scene, &making) => made,
                () = stop.notified() => Ok(not_awaited()),
            }
        }
        Task::Video { plan } => video(work, errand, plan, (&scene, &making), progress, stop).await,
    };
    remove(&making).await;
    outcome
}

/// What it needs of the job's files.
async fn fetch(work: &Workshop, errand: &Errand, folder: &Path) -> Result<()> {
    let blobs = work.mirror.blobs().ok_or(ServerError::NoFiles)?;
    let files: Vec<Kept> = errand.files.iter().cloned().map(Kept::from).collect();
    let copy = work.mirror.folder(&scene_copy(&errand.job));
    let mut copy = copy.lock().await;
    pull(blobs, &files, folder, None, &mut copy.seen).await?;
    used_now(folder).map_err(ServerError::io(folder))
}

async fn view(work: &Workshop, errand: &Errand, folder: &Path, making: &Path) -> Result<Outcome> {
    let Task::View {
        scene,
        camera,
        shown,
        ev,
        format,
    } = &errand.task
    else {
        return Err(bad("task"));
    };
    // Nothing is read but what was fetched, which lies in the folder.
    if !errand.files.iter().any(|file| file.path == *scene) {
        return Err(bad("scene"));
    }
    let out = making.join("picture");
    let request = RenderRequest {
        scene: folder.join(scene),
        camera: (**camera).clone(),
        shown: *shown,
        ev: *ev,
        format: *format,
        out: out.clone(),
    };
    // Those who asked have taken their turns.
    let client = IpAddr::from(Ipv4Addr::LOCALHOST);
    match work.renderers.render(client, &request).await {
        Ok(()) => put(work, &out).await,
        Err(error) => Ok(Outcome::Failed {
            detail: without_paths(&error.to_string()),
        }),
    }
}

async fn video(
    work: &Workshop,
    errand: &Errand,
    plan: &Plan,
    (scene, making): (&Path, &Path),
    progress: &Progress,
    stop: &Notify,
) -> Result<Outcome> {
    let file = making.join("video.mp4");
    let output = RunFolder::new(scene.join("output"));
    let film = Film {
        config: &work.config,
        job: &errand.job,
        output: output.root(),
        plan,
        plan_file: &making.join("plan.json"),
        video: &file,
    };
    let advance = |done, total| progress.note(done, total);
    match film.make(stop, &work.shutdown, advance).await {
        End::Made => put(work, &file).await,
        End::Failed(fault) => Ok(Outcome::Failed {
            detail: fault.detail,
        }),
        End::Stopped => Ok(not_awaited()),
        End::Interrupted => Ok(Outcome::Failed {
            detail: "the worker stops".to_owned(),
        }),
    }
}

async fn put(work: &Workshop, file: &Path) -> Result<Outcome> {
    let blobs = work.mirror.blobs().ok_or(ServerError::NoFiles)?;
    let blob = blobs.put(file).await?;
    Ok(Outcome::Made {
        digest: blob.digest,
        bytes: blob.bytes,
    })
}

fn not_awaited() -> Outcome {
    Outcome::Failed {
        detail: "nobody waits for it".to_owned(),
    }
}

fn bad(what: &str) -> ServerError {
    ServerError::Damaged {
        what: "errand",
        detail: format!("its {what} can be none"),
    }
}

/// How many pictures of how many are done.
#[derive(Default)]
struct Progress {
    done: AtomicU32,
    total: AtomicU32,
}

impl Progress {
    fn note(&self, done: u32, total: u32) {
        self.done.store(done, Ordering::Relaxed);
        self.total.store(total, Ordering::Relaxed);
    }

    fn headway(&self) -> Headway {
        Headway {
            done: self.done.load(Ordering::Relaxed),
            total: self.total.load(Ordering::Relaxed),
        }
    }
}
