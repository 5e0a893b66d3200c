//! `/v1/work`: what workers ask and tell that reach the service by HTTP alone.
//!
//! Every effect is the same transaction as a worker's that has the database: it begins by checking
//! the epoch, and what is said twice is done once.

use std::sync::Arc;

use axum::Json as Answer;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use fled_blobs::Kept;
use uuid::Uuid;

use super::extract::{Json, Query};
use super::problem::Problem;
use crate::app::App;
use crate::coordinator::{
    Assignment, Failures, Files, NamedFile, Present, Pulse, Released, Settled, Standing, Told,
    Under, VERSION, VERSION_HEADER, Wanted, What, milliseconds, see,
};
use crate::copies::is_the_jobs;
use crate::error::Result;
use crate::jobs::after_death;
use crate::store::{Engine, Lease, Saying};

/// Refuses workers of another version, and all where files are not shared.
pub(super) async fn check(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    if let Err(problem) = same_version(request.headers()) {
        return problem.into_response();
    }
    if app.mirror.blobs().is_none() {
        let detail = "This server keeps its files where no worker reaches them.";
        return Problem::conflict("no_store", detail)
            .hint("Whoever runs it starts it with --store DIR or --store s3://BUCKET/PREFIX.")
            .into_response();
    }
    next.run(request).await
}

fn same_version(headers: &HeaderMap) -> Result<(), Problem> {
    let theirs = headers.get(VERSION_HEADER).and_then(|v| v.to_str().ok());
    let theirs = theirs.unwrap_or("none");
    if minor(theirs) == minor(VERSION) {
        return Ok(());
    }
    let theirs: String = theirs.chars().take(40).collect();
    let detail = format!("This server is fled {VERSION}, and the worker is fled {theirs}.");
    let problem = Problem::conflict("other_version", detail);
    Err(problem.hint(format!("Start a worker of fled {VERSION}.")))
}

/// A version up to its second number: what differs behind it speaks the same.
fn minor(version: &str) -> &str {
    version.rsplit_once('.').map_or(version, |(minor, _)| minor)
}

/// A worker's name for itself, which is a UUID: others would mean more in a lease.
pub(super) fn name(worker: &str) -> Result<String, Problem> {
    let name: Result<Uuid, _> = worker.parse();
    let bad = |_| Problem::unprocessable("bad_input", "A worker's name has to be a UUID.");
    name.map(|name| name.to_string()).map_err(bad)
}

/// A worker is there, and what machine it is.
#[utoipa::path(put, path = "/v1/work/workers/{worker}", operation_id = "show_worker_present",
    tag = "work", params(("worker" = String, Path)), request_body = Present,
    responses((status = 204, description = "Noted")))]
pub async fn present(
    State(app): State<Arc<App>>,
    Path(worker): Path<String>,
    Json(present): Json<Present>,
) -> Result<StatusCode, Problem> {
    see(
        &app.store,
        &name(&worker)?,
        &present.about,
        present.draining,
    )
    .await?;
    Ok(StatusCode::NO_CONTENT)
}

/// A worker goes.
#[utoipa::path(delete, path = "/v1/work/workers/{worker}", operation_id = "forget_worker",
    tag = "work", params(("worker" = String, Path)),
    responses((status = 204, description = "Forgotten")))]
pub async fn gone(
    State(app): State<Arc<App>>,
    Path(worker): Path<String>,
) -> Result<StatusCode, Problem> {
    app.store.forget_workers(Some(&name(&worker)?), 0).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// A worker begins, and runs nothing: what it ran before waits again.
#[utoipa::path(post, path = "/v1/work/workers/{worker}/release", operation_id = "release_jobs",
    tag = "work", params(("worker" = String, Path)),
    responses((status = 200, description = "What waits again", body = Released)))]
pub async fn release(
    State(app): State<Arc<App>>,
    Path(worker): Path<String>,
) -> Result<Answer<Released>, Problem> {
    let settle = |deaths| after_death(&app.limits, deaths);
    let jobs = app.store.release_of(&name(&worker)?, settle).await?;
    ring(&app);
    Ok(Answer(Released { jobs }))
}

/// Gives a worker the job that is next, if there is one for its machine.
#[utoipa::path(post, path = "/v1/work/workers/{worker}/claim", operation_id = "claim_job",
    tag = "work", params(("worker" = String, Path)), request_body = Wanted,
    responses(
        (status = 200, description = "Its job", body = Assignment),
        (status = 204, description = "There is none")))]
pub async fn claim(
    State(app): State<Arc<App>>,
    Path(worker): Path<String>,
    Json(wanted): Json<Wanted>,
) -> Result<Response, Problem> {
    let (worker, wish) = (name(&worker)?, name(&wanted.wish)?);
    let owner = format!("{worker}/{}/{wish}", wanted.turn);
    let _alone = app.running.claiming().await;
    if let Some(claim) = app.store.claim_of(&owner).await? {
        return Ok(Answer(Assignment::from(claim)).into_response());
    }
    let mut running = wanted.running.clone();
    let settle = |deaths| after_death(&app.limits, deaths);
    let released = if app.store.engine() == Engine::Sqlite {
        // What runs here was stopped with this server, however long ago its lease ran out.
        running.extend(app.running.jobs());
        let here = app.running.jobs();
        app.store.release_expired(&here, settle).await?
    } else {
        app.store.release_expired(&[], settle).await?
    };
    for job in &released {
        tracing::warn!(job, "its worker was not heard of any more: it waits again");
    }
    let lease = milliseconds(app.limits.lease);
    let claim = app
        .store
        .claim_fit(&owner, lease, &running, wanted.machine())
        .await?;
    if claim.is_some() || !released.is_empty() {
        ring(&app);
    }
    Ok(match claim {
        Some(claim) => Answer(Assignment::from(claim)).into_response(),
        None => StatusCode::NO_CONTENT.into_response(),
    })
}

/// A worker lives: its lease is extended.
#[utoipa::path(post, path = "/v1/work/jobs/{job}/heartbeat", operation_id = "extend_lease",
    tag = "work", params(("job" = String, Path)), request_body = Under,
    responses(
        (status = 200, description = "It is extended", body = Pulse),
        (status = 409, description = "The lease is over", body = Problem,
            content_type = "application/problem+json")))]
pub async fn heartbeat(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
    Json(Under { epoch }): Json<Under>,
) -> Result<Answer<Pulse>, Problem> {
    let lease = Lease { job, epoch };
    let cancel = app.store.heartbeat(&lease, milliseconds(app.limits.lease));
    let cancel = cancel.await?;
    let (_, told) = app.store.held(&lease).await?;
    Ok(Answer(Pulse { cancel, told }))
}

/// A worker tells one thing of its job.
#[utoipa::path(post, path = "/v1/work/jobs/{job}/told", operation_id = "tell_of_job",
    tag = "work", params(("job" = String, Path)), request_body = Told,
    responses(
        (status = 204, description = "It holds, now or since it was told before"),
        (status = 409, description = "The lease is over", body = Problem,
            content_type = "application/problem+json")))]
pub async fn told(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
    Json(told): Json<Told>,
) -> Result<StatusCode, Problem> {
    let lease = Lease {
        job,
        epoch: told.epoch,
    };
    match told.what {
        What::Event(event) => say(&app, &lease, told.before, Saying::Event(&event)).await?,
        What::Progress(progress) => {
            say(&app, &lease, told.before, Saying::Progress(&progress)).await?;
        }
        What::Files { kept, gone } => {
            let kept: Vec<Kept> = kept.into_iter().map(Kept::from).collect();
            if let Some(bad) = kept.iter().find(|file| !is_a_jobs(file)) {
                let detail = format!("{:?} is no file of a job, or has no digest.", bad.path);
                return Err(Problem::unprocessable("bad_file", detail));
            }
            say(&app, &lease, told.before, Saying::Files(&kept, &gone)).await?;
        }
    }
    Ok(StatusCode::NO_CONTENT)
}

/// Whether a job makes such files, and the blob has a name: what is told is fetched by others.
fn is_a_jobs(file: &Kept) -> bool {
    let is_name = |name: &str| !["", ".", ".."].contains(&name) && !name.contains('\0');
    let digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    let digest = &file.blob.digest;
    is_the_jobs(&file.path)
        && file.path.split('/').all(is_name)
        && digest.len() == 64
        && digest.bytes().all(digit)
}

async fn say(app: &App, lease: &Lease, before: i64, saying: Saying<'_>) -> Result<()> {
    app.store.say_after(lease, before, saying).await?;
    app.changed();
    Ok(())
}

/// How many times in a row a job has failed without progress, if it fails now.
#[utoipa::path(get, path = "/v1/work/jobs/{job}/failures", operation_id = "count_failures",
    tag = "work", params(("job" = String, Path), Under),
    responses(
        (status = 200, description = "So many times", body = Failures),
        (status = 409, description = "The lease is over", body = Problem,
            content_type = "application/problem+json")))]
pub async fn failures(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
    Query(Under { epoch }): Query<Under>,
) -> Result<Answer<Failures>, Problem> {
    let lease = Lease { job, epoch };
    app.store.held(&lease).await?;
    let failures = app.store.count_failure(&lease).await?;
    Ok(Answer(Failures { failures }))
}

/// A worker's attempt has ended.
#[utoipa::path(post, path = "/v1/work/jobs/{job}/settle", operation_id = "settle_job",
    tag = "work", params(("job" = String, Path)), request_body = Settled,
    responses(
        (status = 200, description = "Where the job stands", body = Standing),
        (status = 409, description = "The lease is over", body = Problem,
            content_type = "application/problem+json")))]
pub async fn settle(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
    Json(settled): Json<Settled>,
) -> Result<Answer<Standing>, Problem> {
    let lease = Lease {
        job,
        epoch: settled.epoch,
    };
    let state = app.store.settle(&lease, &settled.settlement).await?;
    ring(&app);
    Ok(Answer(Standing { state }))
}

/// The files of a worker's job.
#[utoipa::path(get, path = "/v1/work/jobs/{job}/files", operation_id = "list_job_files",
    tag = "work", params(("job" = String, Path), Under),
    responses(
        (status = 200, description = "All of them", body = Files),
        (status = 409, description = "The lease is over", body = Problem,
            content_type = "application/problem+json")))]
pub async fn files(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
    Query(Under { epoch }): Query<Under>,
) -> Result<Answer<Files>, Problem> {
    let lease = Lease { job, epoch };
    app.store.held(&lease).await?;
    let files = app.store.job_files(&lease.job).await?;
    let (version, files) = files.ok_or_else(|| Problem::not_found("job"))?;
    Ok(Answer(named(version, files)))
}

/// The files of the capture of a worker's job.
#[utoipa::path(get, path = "/v1/work/jobs/{job}/capture", operation_id = "list_capture_files",
    tag = "work", params(("job" = String, Path), Under),
    responses(
        (status = 200, description = "All of them", body = Files),
        (status = 409, description = "The lease is over", body = Problem,
            content_type = "application/problem+json")))]
pub async fn capture(
    State(app): State<Arc<App>>,
    Path(job): Path<String>,
    Query(Under { epoch }): Query<Under>,
) -> Result<Answer<Files>, Problem> {
    let (capture, _) = app.store.held(&Lease { job, epoch }).await?;
    let files = app.store.capture_files(&capture).await?;
    Ok(Answer(named(0, files)))
}

fn named(version: i64, files: Vec<Kept>) -> Files {
    let files = files.into_iter().map(NamedFile::from).collect();
    Files { version, files }
}

/// Who looks at jobs here looks again, and so does a worker that waits for one.
fn ring(app: &App) {
    app.changed();
    app.wake.notify_one();
}
