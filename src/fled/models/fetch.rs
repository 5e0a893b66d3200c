//! Downloading a network: only when asked for, resumed, and checked before anything uses it.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
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

/// The file of a known network, from `from` or the manifest's address. What an interrupted download left in `folder` is gone
/// on with where the manifest has a checksum that proves the whole right in the end.
///
/// # Errors
/// [`Failure`] of kind `environment` when it cannot be had or is not the file that the manifest names.
pub fn fetch(entry: &Entry, from: Option<&str>, folder: &Path) -> Result<Vec<u8>, Failure> {
    let Some(url) = from.or(entry.url.as_deref()) else {
        let note = entry.note.as_deref().unwrap_or_default();
        return Err(environment(format!("{} has no address. {note}", entry.id), &by_hand(entry)));
    };
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    let part = part(entry, folder);
    if entry.sha256.is_none() {
        let _ = std::fs::remove_file(&part);
    }
    let lost = |detail: String| {
        environment(format!("cannot get {} from {url}: {detail}", entry.id), &by_hand(entry))
    };
    let limit = entry.bytes.unwrap_or(LARGEST);
    download(url, &part, limit).map_err(lost)?;
    let content = std::fs::read(&part).map_err(io(&part))?;
    let actual = digest(&content);
    match &entry.sha256 {
        Some(expected) if *expected != actual => {
            // Neither more bytes nor another attempt can make it right.
            let _ = std::fs::remove_file(&part);
            let detail = format!(
                "what {url} gives is not {}: sha256 {actual}, {expected} is expected. It was removed",
                entry.id
            );
            Err(environment(detail, &by_hand(entry)))
        }
        _ => Ok(content),
    }
}

/// Removes what the download left, once the network is in its place.
pub fn forget(entry: &Entry, folder: &Path) {
    let _ = std::fs::remove_file(part(entry, folder));
}

fn part(entry: &Entry, folder: &Path) -> PathBuf {
    folder.join(format!("{}.part", entry.id))
}

fn by_hand(entry: &Entry) -> String {
    format!("Without a network: get the file elsewhere, then fled models add FILE --id {}", entry.id)
}

fn environment(detail: String, hint: &str) -> Failure {
    Failure { hint: hint.to_owned(), ..Failure::new(ErrorKind::Environment, detail) }
}

/// Brings `part` to the whole content of `url`.
fn download(url: &str, part: &Path, limit: u64) -> Result<(), String> {
    let text = |error: std::io::Error| format!("{}: {error}", part.display());
    let agent: Agent = Agent::config_builder()
        .http_status_as_error(false)
        .timeout_connect(Some(PATIENCE))
        .timeout_recv_response(Some(PATIENCE))
        .timeout_per_read(Some(PATIENCE))
        .build()
        .into();
    let have = std::fs::metadata(part).map_or(0, |file| file.len());
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
    if total.is_some_and(|total| total > limit) {
        return Err(format!("it has {} bytes, {limit} are expected", total.unwrap_or_default()));
    }
    let file = OpenOptions::new().create(true).append(at > 0).write(true).truncate(at == 0).open(part);
    let mut file = file.map_err(text)?;
    copy(&mut response, &mut file, at, total, limit)?;
    file.sync_all().map_err(text)
}

fn request(agent: &Agent, url: &str, from: u64) -> Result<Response<Body>, String> {
    let request = agent.get(url);
    // Compressed, the bytes would not be those that the range counts.
    let request = request.header("accept-encoding", "identity");
    let request = if from > 0 { request.header("range", format!("bytes={from}-")) } else { request };
    request.call().map_err(|error| error.to_string())
}

/// First byte of a partial answer.
fn begins(response: &Response<Body>) -> Option<u64> {
    let range = response.headers().get("content-range")?.to_str().ok()?;
    range.strip_prefix("bytes ")?.split('-').next()?.parse().ok()
}

fn copy(
    response: &mut Response<Body>,
    file: &mut File,
    mut at: u64,
    total: Option<u64>,
    limit: u64,
) -> Result<(), String> {
    let bar = ProgressBar::new(total.unwrap_or(0)).with_position(at);
    let style = ProgressStyle::with_template("{bar:30} {bytes}/{total_bytes} {bytes_per_sec} {eta}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let mut reader = response.body_mut().as_reader();
    let mut buffer = vec![0; 1 << 16];
    loop {
        let read = reader.read(&mut buffer).map_err(|error| {
            format!("stopped after {at} bytes: {error}. Called again, it goes on from there")
        })?;
        if read == 0 {
            break;
        }
        at += read as u64;
        if at > limit {
            return Err(format!("it has more than the {limit} bytes that are expected"));
        }
        file.write_all(&buffer[..read]).map_err(|error| error.to_string())?;
        bar.set_position(at);
    }
    bar.finish_and_clear();
    match total {
        Some(total) if at != total => {
            Err(format!("stopped after {at} of {total} bytes. Called again, it goes on"))
        }
        _ => Ok(()),
    }
}
