//! `/v1/jobs/{id}/artifacts`: the files of a job, whole or in ranges, each with its digest.

use std::fs;
use std::io;
use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;
use std::time::UNIX_EPOCH;

use axum::extract::{Extension, Path, State};
use axum::http::HeaderMap;
use axum::response::Response;
use fled_core::run_folder::RunFolder;
use serde::Serialize;
use sha2::{Digest, Sha256};
use utoipa::ToSchema;

use super::access::Visitor;
use super::lookup::find;
use super::problem::Problem;
use super::sent::Sent;
use crate::app::App;
use crate::error::ServerError;

/// A file of a job.
#[derive(Debug, Serialize, ToSchema)]
pub struct Artifact {
    /// Path below the job's output, separated by `/`.
    name: String,
    /// Size, bytes.
    bytes: u64,
    /// SHA-256, hexadecimal.
    sha256: String,
    /// Media type.
    media_type: &'static str,
}

/// The files of a job.
#[derive(Debug, Serialize, ToSchema)]
pub struct Artifacts {
    /// The files, sorted by name.
    artifacts: Vec<Artifact>,
}

/// Lists the files that the job has written so far.
#[utoipa::path(get, path = "/v1/jobs/{id}/artifacts", operation_id = "list_artifacts",
    tag = "results", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The files", body = Artifacts),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn list(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Extension(visitor): Extension<Visitor>,
) -> Result<axum::Json<Artifacts>, Problem> {
    find(&app, &id).await?;
    let output = app.data.output(&id).root().to_owned();
    let names = tokio::task::spawn_blocking({
        let output = output.clone();
        move || {
            let mut names = Vec::new();
            collect(&output, "", &mut names).map(|()| names)
        }
    });
    let mut names =
        names.await.map_err(|_| Problem::internal())?.map_err(ServerError::io(&output))?;
    let folder = app.data.output(&id);
    names.retain(|name| may_see(&visitor, &folder, name));
    names.sort();
    let mut artifacts = Vec::with_capacity(names.len());
    for name in names {
        // A file of a running job may disappear between listing and reading.
        if let Some(file) = Stored::open(&app, &id, &name).await? {
            artifacts.push(Artifact {
                bytes: file.bytes,
                sha256: file.sha256,
                media_type: media_type(&name),
                name,
            });
        }
    }
    Ok(axum::Json(Artifacts { artifacts }))
}

/// Downloads a file of the job, whole or by range.
#[utoipa::path(get, path = "/v1/jobs/{id}/artifacts/{*name}", operation_id = "download_artifact",
    tag = "results",
    params(("id" = String, Path), ("name" = String, Path, description = "Name as listed; may contain `/`"),
        ("Range" = Option<String>, Header, description = "A single range of bytes")),
    responses(
        (status = 200, description = "The file", body = serde_json::Value, content_type = "*/*"),
        (status = 206, description = "The requested range", body = serde_json::Value, content_type = "*/*"),
        (status = 304, description = "Not modified"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 416, description = "The range begins beyond the end", body = Problem, content_type = "application/problem+json")))]
pub async fn download(
    State(app): State<Arc<App>>,
    Path((id, name)): Path<(String, String)>,
    Extension(visitor): Extension<Visitor>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    find(&app, &id).await?;
    let file = match may_see(&visitor, &app.data.output(&id), &name) {
        true => Stored::open(&app, &id, &name).await?,
        false => None,
    };
    let file = file.ok_or_else(|| Problem::not_found("artifact"))?;
    let sent = Sent {
        etag: format!("\"{}\"", file.sha256),
        path: file.path,
        bytes: file.bytes,
        media_type: media_type(&name),
    };
    sent.answer(&headers).await
}

/// Returns whether a visitor may see a file: a share link hides the log, which describes the
/// machine.
fn may_see(visitor: &Visitor, output: &RunFolder, name: &str) -> bool {
    visitor.only_job().is_none() || output.root().join(name) != output.log()
}

/// A file with its digest.
struct Stored {
    path: PathBuf,
    bytes: u64,
    sha256: String,
}

impl Stored {
    /// Opens a file; `None` if it does not exist below the job's output.
    async fn open(app: &App, id: &str, name: &str) -> Result<Option<Self>, Problem> {
        let output = app.data.output(id).root().to_owned();
        let Some(path) = inside(&output, name) else {
            return Ok(None);
        };
        let Ok(metadata) = tokio::fs::metadata(&path).await else {
            return Ok(None);
        };
        if !metadata.is_file() {
            return Ok(None);
        }
        let bytes = metadata.len();
        let modified =
            metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let modified_ns = i64::try_from(modified.unwrap_or_default().as_nanos()).unwrap_or(0);
        let size = i64::try_from(bytes).unwrap_or(i64::MAX);
        let sha256 = match app.store.digest(id, name, size, modified_ns).await? {
            Some(known) => known,
            None => {
                let source = path.clone();
                let digest = tokio::task::spawn_blocking(move || sha256(&source)).await;
                let digest = match digest.map_err(|_| Problem::internal())? {
                    // Deleted since its metadata was read.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
                    digest => digest.map_err(ServerError::io(&path))?,
                };
                app.store.remember_digest(id, (name, size, modified_ns), &digest).await?;
                digest
            }
        };
        Ok(Some(Self { path, bytes, sha256 }))
    }
}

fn sha256(path: &FilePath) -> io::Result<String> {
    let mut hasher = Sha256::new();
    io::copy(&mut fs::File::open(path)?, &mut hasher)?;
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Resolves a public file name, if it really lies below `output`.
fn inside(output: &FilePath, name: &str) -> Option<PathBuf> {
    if !RunFolder::is_public(name) {
        return None;
    }
    // Canonicalised: a symbolic link must not lead out.
    let (root, path) = (output.canonicalize().ok()?, output.join(name).canonicalize().ok()?);
    path.starts_with(&root).then_some(path)
}

/// Every public file below `dir`.
fn collect(dir: &FilePath, prefix: &str, names: &mut Vec<String>) -> io::Result<()> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        let Ok(name) = entry.file_name().into_string() else {
            continue;
        };
        if !RunFolder::is_public(&format!("{prefix}{name}")) {
            continue;
        }
        let kind = entry.file_type()?;
        if kind.is_dir() {
            collect(&entry.path(), &format!("{prefix}{name}/"), names)?;
        } else if kind.is_file() {
            names.push(format!("{prefix}{name}"));
        }
    }
    Ok(())
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("json") => "application/json",
        Some("jpg" | "jpeg") => "image/jpeg",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("txt") => "text/plain; charset=utf-8",
        Some("csv") => "text/csv; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_escapes_the_output() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let output = dir.path().join("output");
        fs::create_dir_all(output.join("rounds")).expect("create");
        fs::create_dir_all(output.join("work")).expect("create");
        fs::write(output.join("work/checkpoint"), "x").expect("write");
        fs::write(output.join("scene.ply"), "ply").expect("write");
        fs::write(output.join(".lock"), "x").expect("write");
        fs::write(dir.path().join("secret"), "x").expect("write");
        std::os::unix::fs::symlink(dir.path().join("secret"), output.join("link")).expect("link");
        assert!(inside(&output, "scene.ply").is_some());
        for name in [
            "../secret",
            "rounds/../../secret",
            "/etc/passwd",
            "link",
            ".lock",
            "",
            "rounds//x",
            "a\0b",
            "work/checkpoint",
        ] {
            assert!(inside(&output, name).is_none(), "{name:?}");
        }
        let mut names = Vec::new();
        collect(&output, "", &mut names).expect("list");
        assert_eq!(names, ["scene.ply"]);
    }
}
