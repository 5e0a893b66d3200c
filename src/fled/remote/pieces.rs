//! The files of a capture, sent in pieces as resumable uploads: tus 1.0.
//!
//! A lost connection costs at most one piece, and a proxy that limits the size of a request only
//! makes the pieces smaller.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use fled_core::pipeline::error::ErrorKind;
use indicatif::{ProgressBar, ProgressStyle};
use ureq::http::request::Builder;
use ureq::http::{Request, Response, header};
use ureq::{AsSendBody, Body, SendBody};

use super::begun::Begun;
use super::{Fault, Remote};
use crate::failure::{Failure, io as at};

/// Largest piece in bytes.
const MOST: u64 = 8 << 20;
/// Bytes of the smallest piece that is tried.
const LEAST: u64 = 512 << 10;
/// Path of the uploads.
const UPLOADS: &str = "/v1/uploads";
/// The header that each request about an upload carries.
const RESUMABLE: (&str, &str) = ("tus-resumable", "1.0.0");

/// The files to send.
pub struct Files {
    /// Names, paths and sizes in bytes.
    files: Vec<(String, PathBuf, u64)>,
    /// Equal for equal names and contents of files and fields.
    pub digest: blake3::Hash,
}

impl Files {
    /// All files of a folder that are not hidden, or one file, such as a ZIP; `fields` only count
    /// for the digest.
    ///
    /// # Errors
    /// [`Failure`] if a file cannot be read.
    pub fn new(capture: &Path, fields: &str) -> Result<Self, Failure> {
        let mut hasher = blake3::Hasher::new();
        // With the lengths, so that texts cannot run into one another.
        hasher.update(&(fields.len() as u64).to_le_bytes()).update(fields.as_bytes());
        let mut files = Vec::new();
        for (name, path) in found(capture)? {
            hasher.update(&(name.len() as u64).to_le_bytes()).update(name.as_bytes());
            let mut file = File::open(&path).map_err(at(&path))?;
            let bytes = file.metadata().map_err(at(&path))?.len();
            hasher.update(&bytes.to_le_bytes());
            hasher.update_reader(&mut file).map_err(at(&path))?;
            files.push((name, path, bytes));
        }
        Ok(Self { files, digest: hasher.finalize() })
    }

    /// Sends what the service lacks of the files and returns the ids of their uploads, which
    /// `begun` keeps. All uploads begin before the first byte is sent, so that the service refuses
    /// what it has no room for.
    ///
    /// # Errors
    /// [`Failure`] with the service's own message, or if a proxy before it refuses even small
    /// pieces.
    pub fn send(&self, remote: &Remote, begun: &mut Begun) -> Result<Vec<String>, Failure> {
        let bar = ProgressBar::new(self.files.iter().map(|(.., bytes)| bytes).sum());
        let style = ProgressStyle::with_template(
            "{bar:30} {percent:>3}% sent, {bytes} of {total_bytes} at {binary_bytes_per_sec}",
        );
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        let mut sender = Sender { remote, bar, most: MOST, begun };
        let ids = sender.all(&self.files);
        sender.bar.finish_and_clear();
        ids
    }
}

/// Deletes uploads that no job uses: they count until they expire. If the service does not answer,
/// they stay, and a second command continues them.
pub fn discard(remote: &Remote, begun: &mut Begun) {
    for id in begun.ids() {
        let request = Request::delete(remote.url(&format!("{UPLOADS}/{id}")));
        let answer = remote.send(&remote.patient, request.header(RESUMABLE.0, RESUMABLE.1), ());
        if matches!(answer, Err(Fault::Lost(..) | Fault::Later(..))) {
            return;
        }
    }
    begun.forget();
}

/// Sends files one after another.
struct Sender<'a> {
    remote: &'a Remote,
    bar: ProgressBar,
    /// Bytes of the largest piece that a proxy may accept.
    most: u64,
    /// The uploads begun so far.
    begun: &'a mut Begun,
}

impl Sender<'_> {
    /// Sends files of these names, paths and sizes.
    fn all(&mut self, files: &[(String, PathBuf, u64)]) -> Result<Vec<String>, Failure> {
        let remote = self.remote;
        let mut offsets = Vec::with_capacity(files.len());
        for (at, (name, _, bytes)) in files.iter().enumerate() {
            offsets.push(remote.persist(|| self.find(at, name, *bytes))?);
        }
        let there: u64 = offsets.iter().sum();
        if there > 0 {
            eprintln!("continuing an interrupted submission: {there} bytes of it are there");
        }
        let sent = files.iter().zip(offsets).enumerate();
        sent.map(|(at, (file, offset))| self.file(at, file, offset)).collect()
    }

    /// Begins the upload of the file at a place, unless an earlier command has; returns the bytes
    /// that have arrived.
    fn find(&mut self, at: usize, name: &str, bytes: u64) -> Result<u64, Fault> {
        if let Some(id) = self.begun.of(at).map(str::to_owned)
            && let Some(offset) = self.reached(&id)?
        {
            return Ok(offset);
        }
        self.begin(at, name, bytes).map(|_| 0)
    }

    /// Sends the file at a place from `offset` on and returns the id of its upload.
    fn file(
        &mut self,
        at: usize,
        (name, path, bytes): &(String, PathBuf, u64),
        mut offset: u64,
    ) -> Result<String, Failure> {
        let (remote, bytes) = (self.remote, *bytes);
        let before = self.bar.position();
        let mut id = match self.begun.of(at) {
            Some(id) => id.to_owned(),
            None => remote.persist(|| self.begin(at, name, bytes))?,
        };
        self.bar.set_position(before + offset);
        while offset < bytes {
            let mut is_first = true;
            let reached = remote.persist(|| {
                if !std::mem::take(&mut is_first) {
                    match self.reached(&id)? {
                        Some(from) if from == offset => self.most = LEAST.max(self.most / 2),
                        // Part of the lost piece arrived: patience begins anew.
                        reached => return Ok(reached),
                    }
                }
                match self.piece(path, &id, offset, bytes) {
                    Err(Fault::Gone(_)) => Ok(None),
                    // A proxy may deliver a lost piece late: HEAD says where to continue.
                    Err(Fault::Conflict(failure)) => Err(Fault::Later(None, failure)),
                    outcome => outcome.map(Some),
                }
            })?;
            match reached {
                Some(reached) => offset = reached,
                // It expired while the service did not respond.
                None => (id, offset) = (remote.persist(|| self.begin(at, name, bytes))?, 0),
            }
            self.bar.set_position(before + offset);
        }
        Ok(id)
    }

    /// Starts the upload of the file at a place and returns its id.
    fn begin(&mut self, at: usize, name: &str, bytes: u64) -> Result<String, Fault> {
        let request = Request::post(self.remote.url(UPLOADS))
            .header("upload-length", bytes)
            .header("upload-metadata", format!("filename {}", STANDARD.encode(name)));
        let answer = self.ask(request, "")?;
        let address = answer.headers().get(header::LOCATION).and_then(|value| value.to_str().ok());
        let id = address.and_then(|address| address.rsplit('/').next());
        let id = id.ok_or_else(|| no_service("its answer has no `Location`"))?.to_owned();
        self.begun.set(at, id.clone());
        Ok(id)
    }

    /// Bytes of an upload that have arrived; `None` if it is gone.
    fn reached(&self, id: &str) -> Result<Option<u64>, Fault> {
        let request = Request::head(self.remote.url(&format!("{UPLOADS}/{id}")));
        match self.ask(request, ()) {
            Ok(answer) => offset(&answer).map(Some),
            Err(Fault::Gone(_)) => Ok(None),
            Err(fault) => Err(fault),
        }
    }

    /// Sends a piece from `from` on, the largest that passes; returns the upload's new offset.
    fn piece(&mut self, path: &Path, id: &str, from: u64, bytes: u64) -> Result<u64, Fault> {
        loop {
            let length = self.most.min(bytes - from);
            match self.pass(path, id, from, length) {
                Err(Fault::TooLarge(_)) if length > LEAST => self.most = LEAST.max(length / 2),
                Err(Fault::TooLarge(failure)) => {
                    let kib = length.div_ceil(1024);
                    let detail =
                        format!("a proxy before the server refuses even pieces of {kib} KiB");
                    return Err(Fault::Refused(Failure { detail, ..failure }));
                }
                outcome => return outcome,
            }
        }
    }

    /// Sends one piece.
    fn pass(&self, path: &Path, id: &str, from: u64, length: u64) -> Result<u64, Fault> {
        let read = |error| Fault::Refused(at(path)(error));
        let mut file = File::open(path).map_err(read)?;
        file.seek(SeekFrom::Start(from)).map_err(read)?;
        let before = self.bar.position();
        let mut body = self.bar.wrap_read(file.take(length));
        let request = Request::patch(self.remote.url(&format!("{UPLOADS}/{id}")))
            .header("upload-offset", from)
            .header(header::CONTENT_TYPE, "application/offset+octet-stream")
            .header(header::CONTENT_LENGTH, length)
            // With this header, a refusal arrives before the body is sent.
            .header(header::EXPECT, "100-continue");
        let answer = self.ask(request, SendBody::from_reader(&mut body));
        // Bytes sent are not bytes stored.
        offset(&answer.inspect_err(|_| self.bar.set_position(before))?)
    }

    fn ask(&self, request: Builder, body: impl AsSendBody) -> Result<Response<Body>, Fault> {
        self.remote.send(&self.remote.patient, request.header(RESUMABLE.0, RESUMABLE.1), body)
    }
}

/// The offset of an upload in an answer.
fn offset(answer: &Response<Body>) -> Result<u64, Fault> {
    let offset = answer.headers().get("upload-offset");
    let offset = offset.and_then(|value| value.to_str().ok()?.parse().ok());
    offset.ok_or_else(|| no_service("its answer has no `Upload-Offset`"))
}

fn no_service(why: &str) -> Fault {
    let detail = format!("the server there is not a fled service: {why}");
    Fault::Refused(Failure::new(ErrorKind::Environment, detail))
}

/// The files of a capture with their names, sorted.
fn found(capture: &Path) -> Result<Vec<(String, PathBuf)>, Failure> {
    if capture.is_file() {
        let name = capture.file_name().unwrap_or_default().to_string_lossy();
        return Ok(vec![(name.into_owned(), capture.to_owned())]);
    }
    let mut found = Vec::new();
    below(capture, "", &mut found)?;
    found.sort();
    if found.is_empty() {
        let detail = format!("{} has no files", capture.display());
        return Err(Failure::usage(detail));
    }
    Ok(found)
}

fn below(folder: &Path, prefix: &str, found: &mut Vec<(String, PathBuf)>) -> Result<(), Failure> {
    for entry in std::fs::read_dir(folder).map_err(at(folder))? {
        let path = entry.map_err(at(folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with('.') {
            continue;
        }
        let name = format!("{prefix}{name}");
        if path.is_dir() {
            below(&path, &format!("{name}/"), found)?;
        } else {
            found.push((name, path));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_is_of_names_contents_and_fields() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let root = folder.path();
        std::fs::create_dir(root.join("gt")).expect("a folder");
        for (name, content) in [("b.png", "22"), ("gt/b.png", "333"), (".hidden", "no")] {
            std::fs::write(root.join(name), content).expect("written");
        }
        let files = |fields: &str| Files::new(root, fields).expect("files");
        let first = files("a place");
        let names: Vec<_> = first.files.iter().map(|(name, _, bytes)| (&**name, *bytes)).collect();
        assert_eq!(names, [("b.png", 2), ("gt/b.png", 3)]);
        assert_eq!(first.digest, files("a place").digest);
        assert_ne!(first.digest, files("another").digest);
        std::fs::write(root.join("b.png"), "23").expect("written");
        assert_ne!(first.digest, files("a place").digest);
    }
}
