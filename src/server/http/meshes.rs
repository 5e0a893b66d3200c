//! Meshes: made by a process of its own, one at a time. A mesh of a large scene may need gigabytes,
//! which the server's process must not take.

use std::ffi::OsString;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::ExitStatus;

use axum::body::Body;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use tokio::fs::File;
use tokio::time::timeout;
use tokio_util::io::ReaderStream;

use super::exports::busy;
use super::problem::{Problem, disk_full};
use crate::app::App;
use crate::error::ServerError;
use crate::process::{Group, Line};
use crate::redaction::without_paths;

/// The exit code of a command with impossible arguments, and that of one whose input is unusable.
const WRONG_USE: i32 = 2;
const UNUSABLE: i32 = 3;

/// The signal with which a process ends that gets no memory.
const ABORTED: i32 = 6;

/// Variables of the process: each thread and arena reserves address space, which is limited.
const FEW_THREADS: [(&str, &str); 2] = [("RAYON_NUM_THREADS", "8"), ("MALLOC_ARENA_MAX", "2")];

/// Makes a mesh with these arguments of `fled export` and sends it. If the client leaves, the
/// process ends.
///
/// # Errors
/// 409 if the scene has no mesh; 422 if it takes too much time or memory, or its voxels cannot be
/// used; 503 if too many wait.
pub(super) async fn make(app: &App, arguments: Vec<OsString>) -> Result<Response, Problem> {
    let _place = app.mesh_places.try_acquire().map_err(|_| busy())?;
    let _turn = app.meshing.lock().await;
    let incoming = app.data.incoming();
    // Removed on return: the open file can still be read.
    let folder = app.uploads.begin(&incoming).map_err(ServerError::io(&incoming))?;
    let path = folder.path().join("mesh");
    let memory = app.limits.mesh_bytes.to_string().into();
    let own = ["--memory".into(), memory, "--output".into(), path.clone().into_os_string()];
    let arguments: Vec<OsString> = arguments.into_iter().chain(own).collect();
    let seconds = app.limits.meshing.as_secs();
    let ended = timeout(app.limits.meshing, run(app, &arguments)).await;
    let (status, words) =
        ended.map_err(|_| too_much(&format!("Making the mesh takes more than {seconds} s.")))??;
    if !status.success() {
        return Err(failed(app, status, &words));
    }
    let file = File::open(&path).await.map_err(ServerError::io(&path))?;
    let bytes = file.metadata().await.map_err(ServerError::io(&path))?.len();
    let headers = [(header::CONTENT_LENGTH, bytes)];
    Ok((headers, Body::from_stream(ReaderStream::new(file))).into_response())
}

/// Runs the process to its end and returns what it said.
async fn run(app: &App, arguments: &[OsString]) -> Result<(ExitStatus, Vec<String>), Problem> {
    let program = Path::new("fled export");
    let group = Group::spawn(&app.config.export_command, arguments, &FEW_THREADS);
    let mut group = group.map_err(ServerError::io(program))?;
    drop(group.stdin.take());
    let mut words = Vec::new();
    while let Some(Line::Output(line) | Line::Error(line)) = group.next_line().await {
        words.push(line);
    }
    Ok((group.wait().await.map_err(ServerError::io(program))?, words))
}

fn failed(app: &App, status: ExitStatus, words: &[String]) -> Problem {
    let all = words.join("\n");
    tracing::warn!(%status, words = all, "a mesh was not made");
    let reason = words.iter().find_map(|line| line.strip_prefix("fled: ")).unwrap_or_default();
    let detail = without_paths(&format!("No mesh can be made: {reason}."));
    match (status.code(), status.signal()) {
        (Some(WRONG_USE), _) => Problem::unprocessable("bad_input", detail),
        (Some(UNUSABLE), _) => Problem::conflict("no_export", detail),
        (_, Some(ABORTED)) => {
            let most = app.limits.mesh_bytes >> 20;
            too_much(&format!("Making the mesh takes more than {most} MiB of memory."))
        }
        _ if app.is_disk_full() => disk_full(),
        _ => Problem::internal(),
    }
}

fn too_much(detail: &str) -> Problem {
    Problem::unprocessable("too_large", detail)
        .hint("Crop the scene, or ask for fewer `triangles` or a larger `voxel`.")
}
