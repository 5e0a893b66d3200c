//! Multipart uploads: streamed to disk under names of our own, fsynced, examined, moved into place.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};

use axum::extract::Multipart;
use axum::extract::multipart::{Field, MultipartError};
use axum::http::StatusCode;
use tokio::fs::{self, File};
use tokio::io::AsyncWriteExt;
use uuid::Uuid;

use super::problem::{Problem, disk_full};
use crate::app::App;
use crate::data::sync_directory;
use crate::error::ServerError;
use crate::intake::{self, CaptureReport, Refusal};
use crate::store::{CaptureRow, now_ms};

/// Text fields are short; files stream.
const LONGEST_TEXT: usize = 1 << 16;
/// Between two looks at the free space of the disk, bytes.
const LOOK_AT_DISK: u64 = 32 << 20;

/// A complete upload in its own directory, not yet a capture. Dropped unused, it is removed.
#[derive(Debug)]
pub struct Upload {
    dir: PathBuf,
    /// Text fields: `name`, `preset`, `options`.
    pub fields: BTreeMap<String, String>,
    /// Identifies the content: names, fields and bytes.
    pub fingerprint: String,
    /// Files received.
    files: usize,
}

impl Drop for Upload {
    fn drop(&mut self) {
        // Moved into place already, when it became a capture.
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

/// Receives every part of a multipart body.
///
/// # Errors
/// 400 for a broken body, 413 and 507 when it is too large for us or for the disk.
pub async fn receive(app: &App, mut body: Multipart) -> Result<Upload, Problem> {
    check_space(app)?;
    let dir = app.data.incoming().join(Uuid::now_v7().to_string());
    fs::create_dir(&dir).await.map_err(ServerError::io(&dir))?;
    let mut upload = Upload {
        dir,
        fields: BTreeMap::new(),
        fingerprint: String::new(),
        files: 0,
    };
    let mut receiver = Receiver {
        app,
        hasher: blake3::Hasher::new(),
        bytes: 0,
        looked: 0,
        names: HashMap::new(),
        taken: HashSet::new(),
    };
    while let Some(field) = body.next_field().await.map_err(|error| broken(&error))? {
        let part = field.name().unwrap_or_default().to_owned();
        receiver.hasher.update(part.as_bytes());
        match field.file_name().map(str::to_owned) {
            Some(name) => {
                receiver.hasher.update(name.as_bytes());
                receiver.file(&upload.dir, &part, &name, field).await?;
                upload.files += 1;
            }
            None => {
                let text = receiver.text(field).await?;
                upload.fields.insert(part, text);
            }
        }
    }
    upload.fingerprint = receiver.hasher.finalize().to_hex().to_string();
    Ok(upload)
}

impl Upload {
    /// Judges the files; the photographs that cannot be used stay listed with the reason.
    ///
    /// # Errors
    /// 422 with the assessments when too few photographs can be used.
    pub async fn examine(&self, app: &App) -> Result<CaptureReport, Problem> {
        if self.files == 0 {
            return Err(
                Problem::unprocessable("bad_input", "The upload holds no file.")
                    .hint("Send photographs as parts named `images`, or one zip."),
            );
        }
        let dir = self.dir.clone();
        let source = dir.clone();
        let unpacked = tokio::task::spawn_blocking(move || intake::unpacked_bytes(&source))
            .await
            .map_err(|_| Problem::internal())?
            .map_err(|refusal| refused(*refusal))?;
        if app.has_no_space_for(unpacked) {
            return Err(disk_full());
        }
        let outcome = tokio::task::spawn_blocking(move || intake::examine(&dir)).await;
        match outcome.map_err(|_| Problem::internal())? {
            Ok(report) => Ok(report),
            Err(refusal) => Err(refused(*refusal)),
        }
    }

    /// Makes the upload a capture: on disk, fsynced, then in the database.
    ///
    /// # Errors
    /// When the disk or the database refuses.
    pub async fn keep(self, app: &App, report: &CaptureReport) -> Result<CaptureRow, Problem> {
        let row = CaptureRow {
            id: Uuid::now_v7().to_string(),
            name: self
                .fields
                .get("name")
                .filter(|name| !name.is_empty())
                .cloned()
                .unwrap_or_else(default_name),
            accepted: report.accepted,
            report: serde_json::to_value(report).unwrap_or_default(),
            created_at: now_ms(),
        };
        let (from, to) = (self.dir.clone(), app.data.capture(&row.id));
        let moved = tokio::task::spawn_blocking(move || {
            sync_tree(&from)?;
            std::fs::rename(&from, &to)?;
            sync_directory(to.parent().unwrap_or(Path::new(".")))
        });
        moved
            .await
            .map_err(|_| Problem::internal())?
            .map_err(ServerError::io(&self.dir))?;
        app.store.insert_capture(&row).await?;
        Ok(row)
    }
}

fn refused(refusal: Refusal) -> Problem {
    if refusal.is_ours {
        tracing::error!(refusal.detail, "cannot examine an upload");
        return Problem::internal();
    }
    let (status, code) = if refusal.unsupported_format {
        (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_format")
    } else {
        (StatusCode::UNPROCESSABLE_ENTITY, "bad_input")
    };
    let capture = serde_json::to_value(&refusal.report).unwrap_or_default();
    Problem::new(status, code, refusal.detail)
        .hint(refusal.hint)
        .capture(capture)
}

fn default_name() -> String {
    format!(
        "capture of {}",
        jiff::Zoned::now().strftime("%Y-%m-%d %H:%M")
    )
}

/// Makes the files and the names of a whole tree survive a power cut. Zips are unpacked by the
/// examine, so the files received are not all there is.
fn sync_tree(dir: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_tree(&entry.path())?;
        } else {
            std::fs::File::open(entry.path())?.sync_all()?;
        }
    }
    sync_directory(dir)
}

/// # Errors
/// 507 when less space is left than the server needs to go on.
pub fn check_space(app: &App) -> Result<(), Problem> {
    if app.is_disk_full() {
        return Err(disk_full());
    }
    Ok(())
}

fn broken(error: &MultipartError) -> Problem {
    Problem::new(
        error.status(),
        "bad_request",
        format!("The multipart body is broken: {}", error.body_text()),
    )
}

struct Receiver<'a> {
    app: &'a App,
    hasher: blake3::Hasher,
    bytes: u64,
    looked: u64,
    /// Names as sent, to names as stored: ground truth follows its photograph.
    names: HashMap<String, String>,
    taken: HashSet<PathBuf>,
}

impl Receiver<'_> {
    async fn text(&mut self, field: Field<'_>) -> Result<String, Problem> {
        let text = field.text().await.map_err(|error| broken(&error))?;
        if text.len() > LONGEST_TEXT {
            return Err(too_large("A text field is too long."));
        }
        self.hasher.update(text.as_bytes());
        Ok(text)
    }

    async fn file(
        &mut self,
        dir: &Path,
        part: &str,
        name: &str,
        mut field: Field<'_>,
    ) -> Result<(), Problem> {
        let path = dir.join(self.place(part, name));
        let parent = path.parent().unwrap_or(dir);
        fs::create_dir_all(parent)
            .await
            .map_err(ServerError::io(parent))?;
        let mut file = File::create(&path).await.map_err(ServerError::io(&path))?;
        while let Some(chunk) = field.chunk().await.map_err(|error| broken(&error))? {
            self.count(chunk.len())?;
            self.hasher.update(&chunk);
            file.write_all(&chunk)
                .await
                .map_err(ServerError::io(&path))?;
        }
        file.flush().await.map_err(ServerError::io(&path))?;
        Ok(())
    }

    fn count(&mut self, bytes: usize) -> Result<(), Problem> {
        self.bytes += bytes as u64;
        if self.bytes > self.app.limits.max_upload_bytes {
            return Err(too_large("The upload is too large."));
        }
        if self.bytes - self.looked > LOOK_AT_DISK {
            self.looked = self.bytes;
            check_space(self.app)?;
        }
        Ok(())
    }

    /// Where a file goes, relative to the capture: never where its name says.
    fn place(&mut self, part: &str, name: &str) -> PathBuf {
        let components: Vec<&str> = name.split(['/', '\\']).filter(|c| !c.is_empty()).collect();
        let file = components.last().copied().unwrap_or("unnamed");
        let folder = components
            .len()
            .checked_sub(2)
            .and_then(|i| components.get(i))
            .copied()
            .unwrap_or_default();
        let lower = file.to_ascii_lowercase();
        let is_pose = ["transforms.json", "poses_bounds.npy"].contains(&lower.as_str());
        let is_model = ["cameras", "images", "points3d"]
            .iter()
            .any(|stem| lower == format!("{stem}.txt") || lower == format!("{stem}.bin"));
        if is_pose {
            return PathBuf::from(lower);
        }
        if is_model {
            // COLMAP's readers know these names only with their capitals.
            let name = if lower.starts_with("points3d") {
                lower.replace("points3d", "points3D")
            } else {
                lower
            };
            return Path::new("sparse").join(name);
        }
        if lower.ends_with(".zip") && part != "gt" {
            return self.unique(Path::new(""), intake::ARCHIVE);
        }
        let is_truth = part == "gt"
            || ["gt", "hl"]
                .iter()
                .any(|truth| folder.eq_ignore_ascii_case(truth));
        let stored = match self.names.get(file) {
            // The second of a pair takes the name of the first.
            Some(stored) if !self.taken.contains(&folder_of(is_truth).join(stored)) => {
                stored.clone()
            }
            _ => safe_name(file),
        };
        let path = self.unique(&folder_of(is_truth), &stored);
        if let Some(stored) = path.file_name().and_then(|name| name.to_str()) {
            self.names.insert(file.to_owned(), stored.to_owned());
        }
        path
    }

    fn unique(&mut self, folder: &Path, name: &str) -> PathBuf {
        let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
        let mut path = folder.join(name);
        let mut number = 2;
        while !self.taken.insert(path.clone()) {
            path = folder.join(format!("{stem}-{number}.{extension}"));
            number += 1;
        }
        path
    }
}

fn folder_of(is_truth: bool) -> PathBuf {
    PathBuf::from(if is_truth { "gt" } else { "images" })
}

/// The file name without what harms disks, command lines or logs. Otherwise as it was: poses that
/// come with a capture call its photographs by their names.
fn safe_name(name: &str) -> String {
    let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
    let keep = |text: &str, most: usize| -> String {
        let mut bytes = 0;
        text.chars()
            .map(|c| {
                if c.is_control() || "/\\:*?\"<>|".contains(c) {
                    '_'
                } else {
                    c
                }
            })
            .take_while(|c| {
                bytes += c.len_utf8();
                bytes <= most
            })
            .collect()
    };
    let stem = keep(stem, 150);
    let stem = stem.trim_start_matches(['-', '.', ' ']);
    let stem = if stem.is_empty() { "photograph" } else { stem };
    match keep(extension, 10) {
        extension if extension.is_empty() => stem.to_owned(),
        extension => format!("{stem}.{extension}"),
    }
}

fn too_large(detail: &str) -> Problem {
    Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", detail)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_leaves_its_folder_or_reaches_a_command_line() {
        for name in [
            "../../etc/passwd",
            "-rf.png",
            "a\nb.jpg",
            "日本.png",
            ".hidden",
            "",
            "x".repeat(300).as_str(),
        ] {
            let safe = safe_name(name);
            assert!(
                !safe.starts_with(['-', '.']) && safe.len() <= 161 && !safe.is_empty(),
                "{name:?} -> {safe:?}"
            );
            assert!(
                !safe.contains(['/', '\\', '\n', '\0']),
                "{name:?} -> {safe:?}"
            );
        }
        assert_eq!(safe_name("IMG 0001.JPG"), "IMG 0001.JPG");
    }
}
