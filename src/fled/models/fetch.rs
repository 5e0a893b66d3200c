//! Downloading a network: only when asked for, resumed, and checked before anything uses it.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use fled_core::deblur::manifest::{Entry, digest};
use fled_core::pipeline::error::ErrorKind;
use indicatif::{ProgressBar, ProgressStyle};
use ureq::http::{Response, StatusCode};
use ureq::{Agent, Body};

use crate::failure::{Failure, io};

/// Longest wait for a connection, for an answer, or for the next bytes.
const PATIENCE: Duration = Duration::from_secs(30);

/// No network is larger, bytes: an address that never ends must not fill the disk.
const LARGEST: u64 = 4 << 30;

/// The file of a known network, from `from` or the manifest's address. What an interrupted download
/// left in `folder` is gone on with where the manifest has a checksum that proves the whole right
/// in the end.
///
/// # Errors
/// [`Failure`] of kind `environment` when it cannot be had or is not the file that the manifest
/// names.
pub fn fetch(entry: &Entry, from: Option<&str>, folder: &Path) -> Result<Vec<u8>, Failure> {
    let Some(url) = from.or(entry.url.as_deref()) else {
        let note = entry.note.as_deref().unwrap_or_default();
        return Err(environment(
            format!("{} has no address. {note}", entry.id),
            &by_hand(entry),
        ));
    };
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    let path = part(entry, folder);
    let mut options = OpenOptions::new();
    let mut part = options
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path)
        .map_err(io(&path))?;
    if part.try_lock().is_err() {
        let detail = format!(
            "{} is being fetched already, into {}",
            entry.id,
            path.display()
        );
        return Err(environment(detail, "Wait for it."));
    }
    let Some(expected) = &entry.sha256 else {
        // Nothing would tell whether what is here belongs to what is there now.
        let content = attempt(entry, url, &mut part, 0)?;
        return Ok(content);
    };
    let have = part.metadata().map_err(io(&path))?.len();
    let before = read(&mut part).map_err(io(&path))?;
    if digest(&before) == *expected {
        return Ok(before);
    }
    drop(before);
    let mut content = attempt(entry, url, &mut part, have)?;
    if have > 0 && digest(&content) != *expected {
        // The beginning may have been of another address or day.
        content = attempt(entry, url, &mut part, 0)?;
    }
    let actual = digest(&content);
    if actual != *expected {
        let _ = std::fs::remove_file(&path);
        let detail = format!(
            "what {url} gives is not {}: sha256 {actual}, {expected} is expected. It was removed",
            entry.id
        );
        return Err(environment(detail, &by_hand(entry)));
    }
    Ok(content)
}

/// The file's whole content, downloaded from its byte `have` on.
fn attempt(entry: &Entry, url: &str, part: &mut File, have: u64) -> Result<Vec<u8>, Failure> {
    let lost = |detail: String| {
        let resumed = if entry.sha256.is_some() {
            " Called again, it goes on from there."
        } else {
            ""
        };
        let detail = format!("cannot get {} from {url}: {detail}.{resumed}", entry.id);
        environment(detail, &by_hand(entry))
    };
    download(url, part, have, entry.bytes.unwrap_or(LARGEST)).map_err(lost)?;
    read(part).map_err(|error| lost(error.to_string()))
}

fn read(part: &mut File) -> std::io::Result<Vec<u8>> {
    let mut content = Vec::new();
    part.seek(SeekFrom::Start(0))?;
    part.read_to_end(&mut content)?;
    Ok(content)
}

/// Removes what the download left, once the network is in its place.
pub fn forget(entry: &Entry, folder: &Path) {
    let _ = std::fs::remove_file(part(entry, folder));
}

fn part(entry: &Entry, folder: &Path) -> PathBuf {
    folder.join(format!("{}.part", entry.id))
}

fn by_hand(entry: &Entry) -> String {
    format!(
        "Without a network: get the file elsewhere, then fled models add FILE --id {}",
        entry.id
    )
}

fn environment(detail: String, hint: &str) -> Failure {
    Failure {
        hint: hint.to_owned(),
        ..Failure::new(ErrorKind::Environment, detail)
    }
}

/// Brings `part`, of which `have` bytes are good, to the whole content of `url`.
fn download(url: &str, part: &mut File, have: u64, limit: u64) -> Result<(), String> {
    let text = |error: std::io::Error| error.to_string();
    let agent: Agent = Agent::config_builder()
        .http_status_as_error(false)
        .timeout_connect(Some(PATIENCE))
        .timeout_recv_response(Some(PATIENCE))
        .timeout_per_read(Some(PATIENCE))
        .build()
        .into();
    let mut response = request(&agent, url, have)?;
    let mut at = have;
    match response.status() {
        StatusCode::PARTIAL_CONTENT if begins(&response) == Some(have) => {}
        // The whole once more: the server knows no ranges, or has less than is here already.
        StatusCode::PARTIAL_CONTENT | StatusCode::RANGE_NOT_SATISFIABLE => {
            response = request(&agent, url, 0)?;
            at = 0;
        }
        _ => at = 0,
    }
    if !response.status().is_success() {
        return Err(format!("it answers {}", response.status()));
    }
    let total = response.body().content_length().map(|length| length + at);
    if let Some(total) = total.filter(|total| *total > limit) {
        return Err(format!("it has {total} bytes, {limit} are expected"));
    }
    part.set_len(at)
        .and_then(|()| part.seek(SeekFrom::Start(at)))
        .map_err(text)?;
    copy(&mut response, part, at, total, limit)?;
    part.sync_all().map_err(text)
}

fn request(agent: &Agent, url: &str, from: u64) -> Result<Response<Body>, String> {
    let request = agent.get(url);
    // Compressed, the bytes would not be those that the range counts.
    let request = request.header("accept-encoding", "identity");
    let request = if from > 0 {
        request.header("range", format!("bytes={from}-"))
    } else {
        request
    };
    request.call().map_err(|error| error.to_string())
}

/// First byte of a partial answer.
fn begins(response: &Response<Body>) -> Option<u64> {
    let range = response.headers().get("content-range")?.to_str().ok()?;
    range
        .strip_prefix("bytes ")?
        .split('-')
        .next()?
        .parse()
        .ok()
}

fn copy(
    response: &mut Response<Body>,
    file: &mut File,
    mut at: u64,
    total: Option<u64>,
    limit: u64,
) -> Result<(), String> {
    let bar = ProgressBar::new(total.unwrap_or(0)).with_position(at);
    let style =
        ProgressStyle::with_template("{bar:30} {bytes}/{total_bytes} {bytes_per_sec} {eta}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let mut reader = response.body_mut().as_reader();
    let mut buffer = vec![0; 1 << 16];
    loop {
        let read = reader
            .read(&mut buffer)
            .map_err(|error| format!("stopped after {at} bytes: {error}"))?;
        if read == 0 {
            break;
        }
        at += read as u64;
        if at > limit {
            return Err(format!(
                "it has more than the {limit} bytes that are expected"
            ));
        }
        file.write_all(&buffer[..read])
            .map_err(|error| error.to_string())?;
        bar.set_position(at);
    }
    bar.finish_and_clear();
    match total {
        Some(total) if at != total => Err(format!(
            "stopped after {at} of {total} bytes. Called again, it goes on"
        )),
        _ => Ok(()),
    }
}
