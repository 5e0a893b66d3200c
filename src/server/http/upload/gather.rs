//! Gathers resumable uploads as if they had arrived in one body.

use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;

use fled_core::capture::video::is_video;
use fled_core::capture::{MAX_FILES, NAMES};
use fled_core::photo_path::PhotoPath;

use super::budget::Budget;
use super::earlier::Earlier;
use super::places::{Places, is_archive};
use super::{Upload, Used, check_name};
use crate::app::App;
use crate::error::ServerError;
use crate::files::upload_locks::UploadLock;
use crate::http::access::Visitor;
use crate::http::problem::{Problem, disk_full, too_large};
use crate::http::quota::bytes_left_beside;
use crate::http::tus::lock;
use crate::store::UploadRow;

/// Gathers finished uploads of the visitor, each under its file name, for a capture with these text
/// fields, beside the photographs of the capture `add_to`, if any. They stay unchanged until the
/// capture is stored, and are locked until then: otherwise a piece still arriving would be written
/// into the capture.
///
/// # Errors
/// 423 if another request does not release one, 404 if one does not exist or has another owner, 409
/// for unfinished ones, 413 if all are too large together, 422 for an empty list, too many, a
/// repeated one, or what cannot be added to photographs, 507 if there is no room.
pub async fn gather(
    app: &Arc<App>,
    ids: &[String],
    add_to: Option<&str>,
    fields: BTreeMap<String, String>,
    visitor: &Visitor,
) -> Result<Upload, Problem> {
    let earlier = match add_to {
        Some(id) => Some(Earlier::of(app, id, visitor).await?),
        None => None,
    };
    let beside = earlier.as_ref().map_or(0, |earlier| earlier.names.len());
    check_list(ids, beside)?;
    if let Some(name) = fields.get("name") {
        check_name(name)?;
    }
    let rows = own(app, ids, visitor).await?;
    if earlier.is_some() {
        check_added(&rows)?;
    }
    let locks = lock_all(app, ids).await?;
    // By now, pieces that were arriving are stored or discarded.
    let rows = own(app, ids, visitor).await?;
    let bytes: u64 = rows.iter().map(|row| row.length).sum();
    if bytes > app.limits.max_upload_bytes {
        return Err(too_large("The uploads are too large in total."));
    }
    let most = bytes_left_beside(app, visitor, bytes).await?;
    let incoming = app.data.incoming();
    let dir = app.uploads.begin(&incoming);
    let upload = Upload {
        dir: dir.map_err(ServerError::io(&incoming))?,
        fields,
        fingerprint: String::new(),
        files: rows.len() + beside,
        most,
        beside: 0,
        used: Used { ids: ids.to_vec(), bytes, locks },
    };
    let (app, dir) = (app.clone(), upload.dir.clone());
    let linked = move || link_all(&app, dir.path(), earlier.as_ref(), most, &rows);
    tokio::task::spawn_blocking(linked).await.map_err(|_| Problem::internal())??;
    Ok(upload)
}

/// Checks the listed uploads, used with `beside` other files.
fn check_list(ids: &[String], beside: usize) -> Result<(), Problem> {
    let refused = |detail: &str, pointer: &str| {
        Err(Problem::unprocessable("bad_input", detail)
            .pointer(pointer)
            .hint("List each finished upload once, by the last part of its address."))
    };
    if ids.is_empty() {
        return refused("No upload is listed.", "/uploads");
    }
    if ids.len() + beside > MAX_FILES {
        return Err(too_large(&format!("More than {MAX_FILES} files.")));
    }
    let mut seen = HashSet::new();
    match ids.iter().position(|id| !seen.insert(id)) {
        Some(at) => refused("An upload is listed twice.", &pointer(at)),
        None => Ok(()),
    }
}

/// Checks uploads that are added to the photographs of a capture. A video beside photographs is
/// left out, as everywhere.
fn check_added(rows: &[UploadRow]) -> Result<(), Problem> {
    let path = |row: &UploadRow| PhotoPath::new(&row.filename);
    let detail = if rows.iter().any(|row| is_archive(&path(row))) {
        "A ZIP file cannot be added to a capture."
    } else if rows.iter().all(|row| is_video(Path::new(path(row).name()))) {
        "A video cannot be added to a capture."
    } else {
        return Ok(());
    };
    Err(Problem::unprocessable("bad_input", detail)
        .pointer("/add_to")
        .hint("Send photographs, or leave `add_to` out to make a new capture."))
}

/// The rows of uploads, in order. An admin may see other owners' uploads, but can use only their
/// own: the capture counts towards the quota of its creator.
async fn own(app: &App, ids: &[String], visitor: &Visitor) -> Result<Vec<UploadRow>, Problem> {
    let mut rows = app.store.uploads(ids).await?;
    let own = |(at, id): (usize, &String)| {
        let row = rows.remove(id);
        row.filter(|row| row.owner.as_deref() == visitor.owner()).ok_or_else(|| unknown(at))
    };
    ids.iter().enumerate().map(own).collect()
}

/// Locks all uploads, always in the same order, so that two requests cannot wait for each other.
async fn lock_all(app: &App, ids: &[String]) -> Result<Vec<UploadLock>, Problem> {
    let mut ordered: Vec<&String> = ids.iter().collect();
    ordered.sort();
    let mut locks = Vec::with_capacity(ids.len());
    for id in ordered {
        locks.push(lock(app, id).await?);
    }
    Ok(locks)
}

/// Links every file into `dir`, under its upload's file name, after those of an `earlier` capture:
/// with these, they are at most `most` bytes.
fn link_all(
    app: &App,
    dir: &Path,
    earlier: Option<&Earlier>,
    most: Option<u64>,
    rows: &[UploadRow],
) -> Result<(), Problem> {
    let mut places = Places::default();
    if let Some(earlier) = earlier {
        let mut budget = Budget::new(app, most);
        budget.count(rows.iter().map(|row| row.length).sum())?;
        earlier.link_into(dir, &mut places, &mut budget)?;
    }
    for (at, row) in rows.iter().enumerate() {
        let from = app.data.upload(&row.id);
        let bytes = match fs::metadata(&from) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(unknown(at)),
            about => about.map_err(ServerError::io(&from))?.len(),
        };
        if bytes != row.length {
            return Err(unfinished(at, row, bytes));
        }
        let to = dir.join(places.place("images", &row.filename)?);
        match link(&from, &to) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(unknown(at)),
            // The file system has no hard links, or is another one.
            Err(_) if app.has_no_space_for(bytes) => return Err(disk_full()),
            Err(_) => fs::copy(&from, &to).map(drop).map_err(ServerError::io(&to))?,
        }
    }
    if let Some(names) = places.names() {
        let path = dir.join(NAMES);
        fs::write(&path, names).map_err(ServerError::io(&path))?;
    }
    Ok(())
}

/// Hard-links a file.
pub(super) fn link(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::hard_link(from, to)
}

fn unknown(at: usize) -> Problem {
    Problem::not_found("upload")
        .pointer(pointer(at))
        .hint("It may have expired or been used by a capture. Upload it again.")
}

fn unfinished(at: usize, row: &UploadRow, bytes: u64) -> Problem {
    let detail = format!("Only {bytes} of {} bytes of this upload have arrived.", row.length);
    Problem::conflict("unfinished", detail)
        .pointer(pointer(at))
        .hint("Send the rest first. HEAD returns where to continue.")
}

fn pointer(at: usize) -> String {
    format!("/uploads/{at}")
}
