//! Multipart uploads: streamed to disk under generated names, fsynced, examined, moved into place.

mod ahead;
mod assess;
mod budget;
mod earlier;
mod gather;
mod keep;
mod places;
mod videos;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;

use axum::body::HttpBody;
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{FromRequest, Multipart, Request};
use axum::http::{HeaderMap, StatusCode, header};
use fled_core::capture::{MAX_FILES, NAMES};
use fled_core::reading::below;
use tokio::fs::{self, File};
use tokio::io::AsyncWriteExt;

use self::ahead::Ahead;
use self::budget::Budget;
use self::places::Places;
use super::extract::is_of_type;
use super::problem::{Problem, too_large};
use super::quota::over_quota;
use super::texts::check_text;
use crate::app::App;
use crate::error::ServerError;
use crate::files::incoming::Incoming;
use crate::files::upload_locks::UploadLock;

pub use budget::check_space;
pub use gather::gather;
pub use keep::{Placed, put};

/// Maximum bytes of a text field. Text fields are short; files are streamed.
const LONGEST_TEXT: usize = 1 << 16;
/// Maximum characters of the name of a capture or a job.
const LONGEST_NAME: usize = 200;
/// Maximum bytes of a file name with its folders; file systems allow 255 for the name alone.
pub(super) const LONGEST_FILE_NAME: usize = 1024;
/// Name of the part with a job's options, as JSON.
pub(super) const OPTIONS: &str = "options";
/// Names of the file parts.
const FILE_PARTS: [&str; 3] = ["images", "gt", "poses"];

/// A complete upload in its own directory, not yet a capture. Dropping it removes the directory.
#[derive(Debug)]
pub struct Upload {
    dir: Arc<Incoming>,
    /// Text fields: `name`, `frames`, `preset`, `options`, `priority`.
    pub fields: BTreeMap<String, String>,
    /// Identifies the content: names, fields and bytes.
    pub fingerprint: String,
    /// Files received.
    files: usize,
    /// Bytes it may take on disk, if its owner has a quota.
    most: Option<u64>,
    /// Bytes of other files that will be its owner's, too.
    beside: u64,
    /// The resumable uploads that it was gathered from.
    used: Used,
}

/// Resumable uploads that are deleted when the capture is stored.
#[derive(Debug, Default)]
struct Used {
    ids: Vec<String>,
    /// Bytes they count towards the quota until then.
    bytes: u64,
    /// Locked, so that no other request writes to them.
    locks: Vec<UploadLock>,
}

impl Upload {
    /// An upload that the server creates itself, to be stored with `beside` bytes of other files:
    /// `make` fills its folder and returns the number of files.
    ///
    /// # Errors
    /// When `make` or another disk operation fails.
    pub(super) async fn made(
        app: &App,
        most: Option<u64>,
        beside: u64,
        fields: BTreeMap<String, String>,
        make: impl FnOnce(&Path) -> io::Result<usize> + Send + 'static,
    ) -> Result<Self, Problem> {
        let upload = Self::empty(app, most)?;
        let dir = upload.dir.clone();
        let made = tokio::task::spawn_blocking(move || {
            make(dir.path()).map_err(ServerError::io(dir.path()))
        });
        let files = made.await.map_err(|_| Problem::internal())??;
        Ok(Self { fields, files, beside, ..upload })
    }

    /// An empty upload.
    fn empty(app: &App, most: Option<u64>) -> Result<Self, Problem> {
        let incoming = app.data.incoming();
        let dir = app.uploads.begin(&incoming).map_err(ServerError::io(&incoming))?;
        Ok(Self {
            dir,
            fields: BTreeMap::new(),
            fingerprint: String::new(),
            files: 0,
            most,
            beside: 0,
            used: Used::default(),
        })
    }
}

/// Receives every part of a multipart body; `known` are the accepted text fields, `most` is the
/// number of bytes it may take on disk, if its owner has a quota.
///
/// # Errors
/// 400 for a malformed body, 413 and 507 if it exceeds the upload limit or the disk, 415 for
/// another media type, 422 for an unknown part.
pub async fn receive(
    app: &App,
    request: Request,
    known: &[&str],
    most: Option<u64>,
) -> Result<Upload, Problem> {
    check_space(app)?;
    // Refuse before gigabytes are sent.
    let announced = request.body().size_hint().lower();
    if most.is_some_and(|most| announced > most) {
        return Err(over_quota());
    }
    let (ahead, mut body) = open(request).await?;
    let mut upload = Upload::empty(app, most)?;
    let mut receiver = Receiver {
        ahead: ahead.clone(),
        hasher: blake3::Hasher::new(),
        budget: Budget::new(app, most),
        places: Places::default(),
    };
    while let Some(field) = body.next_field().await.map_err(|error| broken(&error))? {
        ahead.caught_up();
        let part = field.name().unwrap_or_default().to_owned();
        check_text(&part, &below(&part, ""))?;
        receiver.hasher.update(part.as_bytes());
        match file_name(&field) {
            Some(name) => {
                check_file(&part, &name, upload.files)?;
                receiver.hasher.update(name.as_bytes());
                receiver.file(upload.dir.path(), &part, &name, field).await?;
                upload.files += 1;
            }
            None => {
                if !known.contains(&part.as_str()) || upload.fields.contains_key(&part) {
                    return Err(unknown_field(&part, known));
                }
                let text = receiver.text(field).await?;
                check_field(&part, &text)?;
                upload.fields.insert(part, text);
            }
        }
    }
    if let Some(names) = receiver.places.names() {
        let path = upload.dir.path().join(NAMES);
        fs::write(&path, names).await.map_err(ServerError::io(&path))?;
    }
    upload.fingerprint = receiver.hasher.finalize().to_hex().to_string();
    Ok(upload)
}

/// The parts of a multipart/form-data body.
async fn open(request: Request) -> Result<(Arc<Ahead>, Multipart), Problem> {
    if !is_multipart(request.headers()) {
        return Err(other_type());
    }
    let ahead = Arc::new(Ahead::default());
    let request = request.map(|body| ahead.clone().watch(body));
    let body = Multipart::from_request(request, &()).await;
    let body = body.map_err(|rejection| {
        Problem::new(rejection.status(), "bad_request", rejection.body_text())
    })?;
    Ok((ahead, body))
}

/// 415: the body is neither a form nor JSON.
pub fn other_type() -> Problem {
    Problem::new(
        StatusCode::UNSUPPORTED_MEDIA_TYPE,
        "unsupported_media_type",
        "The body is neither multipart/form-data nor JSON.",
    )
    .hint(
        "Send photographs, a ZIP file or a video as multipart/form-data, each in a part named \
        `images` (`curl --form images=@capture.zip`). JSON names a `capture_id` or `uploads`.",
    )
}

/// Returns whether the content type is multipart/form-data, ignoring case.
pub fn is_multipart(headers: &HeaderMap) -> bool {
    is_of_type(headers, "multipart/form-data")
}

/// # Errors
/// 422 if the name of a capture or a job is too long to display.
pub fn check_name(name: &str) -> Result<(), Problem> {
    if name.chars().count() <= LONGEST_NAME {
        return Ok(());
    }
    Err(Problem::unprocessable("bad_input", "The name is too long.")
        .pointer("/name")
        .hint(format!("A name has at most {LONGEST_NAME} characters.")))
}

/// The file name of a part, as sent.
fn file_name(field: &Field<'_>) -> Option<String> {
    let header = field.headers().get(header::CONTENT_DISPOSITION)?;
    let extended = extended_name(&String::from_utf8_lossy(header.as_bytes()));
    extended.or_else(|| field.file_name().map(as_written))
}

/// The RFC 5987 file name, which some clients send with a plain one for servers that do not read
/// it.
fn extended_name(header: &str) -> Option<String> {
    let (_, value) = header.rsplit_once("; filename*=")?;
    let value = value.split(';').next()?.trim().trim_matches('"');
    let (charset, rest) = value.split_once('\'')?;
    let (_, name) = rest.split_once('\'')?;
    let name = percent_encoding::percent_decode_str(name).decode_utf8();
    let is_read = charset.eq_ignore_ascii_case("utf-8");
    name.ok().filter(|_| is_read).map(Cow::into_owned)
}

fn nameless(part: &str) -> Problem {
    let detail = format!("A part `{part}` has no file name in UTF-8.");
    Problem::unprocessable("bad_input", detail)
        .hint("Send each file with its name, as curl -F images=@photograph.jpg does.")
}

/// Removes the escapes that browsers and curl use in this header.
fn as_written(name: &str) -> String {
    name.replace("%22", "\"").replace("%0D", "\r").replace("%0A", "\n")
}

fn check_file(part: &str, name: &str, files: usize) -> Result<(), Problem> {
    if files >= MAX_FILES {
        return Err(too_large(&format!("More than {MAX_FILES} files.")));
    }
    if name.len() > LONGEST_FILE_NAME {
        let detail = format!("A file name is longer than {LONGEST_FILE_NAME} bytes.");
        return Err(Problem::unprocessable("bad_input", detail));
    }
    if FILE_PARTS.contains(&part) {
        return check_text(name, &below(part, ""));
    }
    Err(unknown_field(part, &FILE_PARTS))
}

fn check_field(part: &str, text: &str) -> Result<(), Problem> {
    match part {
        // JSON may contain line breaks between strings.
        OPTIONS => Ok(()),
        "name" => check_text(text, "/name").and_then(|()| check_name(text)),
        part => check_text(text, &below(part, "")),
    }
}

fn unknown_field(part: &str, known: &[&str]) -> Problem {
    if FILE_PARTS.contains(&part) {
        return nameless(part);
    }
    let shown: String = part.chars().take(LONGEST_NAME).collect();
    Problem::unprocessable("bad_input", format!("The part `{shown}` is unknown or sent twice."))
        .pointer(below(&shown, ""))
        .hint(format!("Known parts: {}.", known.join(", ")))
}

/// Runs `work` to completion even if the client disconnects, so that storing is not interrupted.
///
/// # Errors
/// Those of `work`.
pub async fn to_its_end<T: Send + 'static>(
    work: impl Future<Output = Result<T, Problem>> + Send + 'static,
) -> Result<T, Problem> {
    tokio::spawn(work).await.unwrap_or_else(|_| Err(Problem::internal()))
}

fn broken(error: &MultipartError) -> Problem {
    // A malformed, incomplete or stalled body is the client's fault.
    let status = match error.status() {
        status if status.is_server_error() => StatusCode::BAD_REQUEST,
        status => status,
    };
    Problem::new(
        status,
        "bad_request",
        format!("The multipart body is malformed: {}", error.body_text()),
    )
}

struct Receiver<'a> {
    ahead: Arc<Ahead>,
    hasher: blake3::Hasher,
    budget: Budget<'a>,
    places: Places,
}

impl Receiver<'_> {
    /// Reads a text field, up to the maximum length.
    async fn text(&mut self, mut field: Field<'_>) -> Result<String, Problem> {
        let mut text = Vec::new();
        while let Some(chunk) = field.chunk().await.map_err(|error| broken(&error))? {
            self.count(chunk.len())?;
            if text.len() + chunk.len() > LONGEST_TEXT {
                return Err(too_large("A text field is too long."));
            }
            text.extend_from_slice(&chunk);
        }
        self.hasher.update(&text);
        String::from_utf8(text)
            .map_err(|_| Problem::unprocessable("bad_input", "A text field is not UTF-8."))
    }

    async fn file(
        &mut self,
        dir: &Path,
        part: &str,
        name: &str,
        mut field: Field<'_>,
    ) -> Result<(), Problem> {
        let path = dir.join(self.places.place(part, name)?);
        let parent = path.parent().unwrap_or(dir);
        fs::create_dir_all(parent).await.map_err(ServerError::io(parent))?;
        let mut file = File::create(&path).await.map_err(ServerError::io(&path))?;
        while let Some(chunk) = field.chunk().await.map_err(|error| broken(&error))? {
            self.count(chunk.len())?;
            self.hasher.update(&chunk);
            file.write_all(&chunk).await.map_err(ServerError::io(&path))?;
        }
        file.flush().await.map_err(ServerError::io(&path))?;
        Ok(())
    }

    fn count(&mut self, bytes: usize) -> Result<(), Problem> {
        self.ahead.taken(bytes);
        self.budget.count(bytes as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_clients_encode_are_read() {
        let named = |rest: &str| extended_name(&format!("form-data; name=\"images\"{rest}"));
        // As sent by aiohttp and .NET.
        for first in ["", "; filename=\"cam0%2FK%C3%BC.jpg\"", "; filename=\"=?utf-8?B?S8O8?=\""] {
            let name = named(&format!("{first}; filename*=utf-8''cam0%2FK%C3%BC%201.jpg"));
            assert_eq!(name.as_deref(), Some("cam0/K\u{fc} 1.jpg"));
        }
        for other in ["; filename=\"a.jpg\"", "; filename*=latin1''%FC", "; filename*=%C3"] {
            assert_eq!(named(other), None, "{other}");
        }
    }
}
