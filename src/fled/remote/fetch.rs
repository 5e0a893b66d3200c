//! `fled fetch`: downloads a job's files, each of them complete and verified against its digest.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Component, Path, PathBuf};

use fled_core::pipeline::error::ErrorKind;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use ureq::http::StatusCode;

use super::{Fault, MUCH, Remote};
use crate::failure::{Failure, io as at};

/// Arguments of `fled fetch`.
#[derive(clap::Args)]
pub struct Args {
    /// ID of the job, as printed by `fled submit`.
    job: String,
    #[command(flatten)]
    remote: super::Args,
    /// Folder for the files. Complete files are not downloaded again.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Only files whose path starts with this, such as `scene.ply` or `rounds/2/`; may be repeated.
    #[arg(long, value_name = "PATH")]
    only: Vec<String>,
}

#[derive(Deserialize)]
struct Artifacts {
    artifacts: Vec<Artifact>,
}

#[derive(Deserialize)]
struct Artifact {
    name: String,
    bytes: u64,
    sha256: String,
}

/// Fetches the files of a job.
///
/// # Errors
/// [`Failure`] with the service's own message, or if the local disk fails.
pub fn main(args: &Args) -> Result<(), Failure> {
    let remote = Remote::new(&args.remote)?;
    fetch(&remote, &args.job, &args.out, &args.only)
}

/// Like [`main`]; fetches all files if `only` is empty.
pub fn fetch(remote: &Remote, job: &str, out: &Path, only: &[String]) -> Result<(), Failure> {
    let list: Artifacts = remote.json(&format!("/v1/jobs/{job}/artifacts"))?;
    let is_wanted = |file: &Artifact| {
        only.is_empty() || only.iter().any(|start| file.name.starts_with(start.as_str()))
    };
    let files: Vec<Artifact> = list.artifacts.into_iter().filter(is_wanted).collect();
    if files.is_empty() {
        let detail = format!("job {job} has no such file");
        return Err(Failure::new(ErrorKind::BadInput, detail));
    }
    let bar = ProgressBar::new(files.iter().map(|file| file.bytes).sum());
    let style = ProgressStyle::with_template("{bar:30} {percent:>3}% {bytes} {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let mut fetched = 0;
    for file in &files {
        bar.set_message(file.name.clone());
        let to = out.join(inside(&file.name)?);
        if digest(&to).map_err(at(&to))?.as_deref() != Some(&file.sha256) {
            fetch_file(remote, job, file, &to)?;
            fetched += 1;
        }
        bar.inc(file.bytes);
    }
    bar.finish_and_clear();
    let kept = files.len() - fetched;
    eprintln!("{fetched} files downloaded to {}, {kept} already there", out.display());
    Ok(())
}

/// Converts a name from the service into a relative path that stays below the folder.
fn inside(name: &str) -> Result<PathBuf, Failure> {
    let path = Path::new(name);
    let is_inside = path.components().all(|part| matches!(part, Component::Normal(_)));
    if is_inside && !name.is_empty() {
        return Ok(path.to_owned());
    }
    let detail = format!("the service lists a file `{name}`, which is not a path of a result");
    Err(Failure::new(ErrorKind::Environment, detail))
}

/// Fetches one file, resuming an earlier download.
fn fetch_file(remote: &Remote, job: &str, file: &Artifact, to: &Path) -> Result<(), Failure> {
    let parent = to.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(at(parent))?;
    let mut part = to.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    let address = format!("/v1/jobs/{job}/artifacts/{}", escaped(&file.name));
    // The remains of an earlier download may belong to another result: then download the whole
    // file, once.
    for _ in 0..2 {
        remote.persist(|| resume(remote, &address, file.bytes, &part))?;
        if digest(&part).map_err(at(&part))?.as_deref() == Some(&file.sha256) {
            return fs::rename(&part, to).map_err(at(to));
        }
        fs::remove_file(&part).map_err(at(&part))?;
    }
    let detail = format!("{} differs from what the service describes", file.name);
    Err(Failure::new(ErrorKind::Environment, detail))
}

/// Downloads the missing rest of `part`.
fn resume(remote: &Remote, address: &str, bytes: u64, part: &Path) -> Result<(), Fault> {
    let here = |error| Fault::Refused(at(part)(error));
    let mut file = OpenOptions::new().create(true).append(true).open(part).map_err(here)?;
    let have = file.metadata().map_err(here)?.len();
    if have >= bytes {
        return Ok(());
    }
    let range = [("range", format!("bytes={have}-"))];
    let asked = if have > 0 { &range[..] } else { &[] };
    let response = remote.download(address, asked)?;
    if have > 0 && response.status() != StatusCode::PARTIAL_CONTENT {
        file.set_len(0).map_err(here)?;
    }
    // One byte more than expected: reading fails at the limit.
    let body = response.into_body().into_with_config();
    let mut body = body.limit(bytes + 1).reader();
    let mut received = file.metadata().map_err(here)?.len();
    let mut buffer = vec![0; 1 << 16];
    let lost = |why: String, received: u64| Fault::Lost(why, received > have + MUCH);
    loop {
        match body.read(&mut buffer) {
            Ok(0) => break,
            Ok(read) => file.write_all(&buffer[..read]).map_err(here)?,
            Err(error) => return Err(lost(error.to_string(), received)),
        }
        received = file.metadata().map_err(here)?.len();
    }
    if received < bytes {
        return Err(lost(format!("only {received} of {bytes} bytes arrived"), received));
    }
    Ok(())
}

/// The SHA-256 of a file in hexadecimal; `None` if it does not exist.
fn digest(path: &Path) -> io::Result<Option<String>> {
    let mut file = match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        file => file?,
    };
    let mut hasher = Sha256::new();
    io::copy(&mut file, &mut hasher)?;
    let bytes = hasher.finalize();
    Ok(Some(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
}

/// Percent-encodes a path.
fn escaped(name: &str) -> String {
    name.bytes()
        .map(|byte| match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' | b'/' => {
                char::from(byte).to_string()
            }
            byte => format!("%{byte:02X}"),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_leave_the_folder() {
        assert!(inside("rounds/2/scene.ply").is_ok());
        for outside in ["", "/etc/passwd", "../x", "a/../../x", "./x"] {
            assert!(inside(outside).is_err(), "{outside:?}");
        }
        assert_eq!(escaped("a b/ä.png"), "a%20b/%C3%A4.png");
    }
}
