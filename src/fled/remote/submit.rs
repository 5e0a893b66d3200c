//! `fled submit`: sends a capture to a service.

use std::io::{Read, Write};
use std::path::PathBuf;

use fled_core::pipeline::config::Preset;
use fled_core::pipeline::error::ErrorKind;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Deserialize;
use serde_json::Value;
use ureq::SendBody;
use ureq::http::{Request, header};

use super::multipart::Form;
use super::retry::assigned;
use super::{Fault, MUCH, Remote, fetch, read_json, watch};
use crate::failure::Failure;

/// Arguments of `fled submit`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder of photographs, ZIP file, or video (MP4, MOV).
    capture: PathBuf,
    #[command(flatten)]
    remote: super::Args,
    /// Preset: preview, standard or paper.
    #[arg(long, default_value = "standard")]
    preset: Preset,
    /// Overrides one option of the preset; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// Number of photographs to take from a video [default: 40].
    #[arg(long, value_name = "N")]
    frames: Option<u32>,
    /// Priority, -100 to 100: waiting jobs with a higher one start first; above 0 requires scope
    /// `admin`.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
        value_parser = clap::value_parser!(i64).range(-100..=100))]
    priority: Option<i64>,
    /// Name of the job [default: the folder's name].
    #[arg(long)]
    name: Option<String>,
    /// Creates a new job even if the same one was submitted before.
    #[arg(long)]
    again: bool,
    /// Returns as soon as the job is accepted.
    #[arg(long, conflicts_with = "out")]
    detach: bool,
    /// Downloads the result into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Deserialize)]
struct Accepted {
    id: String,
}

/// Sends the capture, watches the job and fetches its result. Repeating the command resumes an
/// interrupted one: the same capture and options give the same job.
///
/// # Errors
/// [`Failure`] with the service's own message.
pub fn main(args: &Args) -> Result<(), Failure> {
    let remote = Remote::new(&args.remote)?;
    let form = Form::new(&fields(args)?, &args.capture)?;
    let mut key = form.digest.to_hex().to_string();
    if args.again {
        let now = std::time::SystemTime::UNIX_EPOCH.elapsed();
        key += &format!("-{}", now.unwrap_or_default().as_nanos());
    }
    // Check the address and the token first.
    remote.json::<Value>("/v1/options")?;
    let job = remote.persist(|| send(&remote, &form, &key))?;
    writeln!(std::io::stdout(), "{job}").map_err(|e| Failure::new(ErrorKind::Io, e))?;
    if args.detach {
        eprintln!("Follow it with `fled watch {job} --server {}`", remote.base());
        return Ok(());
    }
    watch::watch(&remote, &job)?;
    match &args.out {
        Some(out) => fetch::fetch(&remote, &job, out, &[]),
        None => Ok(()),
    }
}

fn fields(args: &Args) -> Result<Vec<(&'static str, String)>, Failure> {
    let options = assigned(args.preset, &args.assignments)?;
    let name = args.name.clone().or_else(|| {
        let path = args.capture.canonicalize().ok()?;
        Some(path.file_stem()?.to_string_lossy().into_owned())
    });
    let frames = args.frames.map(|frames| ("frames", frames.to_string()));
    let priority = args.priority.map(|n| ("priority", n.to_string()));
    let fields = [
        ("name", name.unwrap_or_default()),
        ("preset", args.preset.name().to_owned()),
        ("options", Value::Object(options).to_string()),
    ];
    Ok(fields.into_iter().chain(frames).chain(priority).collect())
}

fn send(remote: &Remote, form: &Form, key: &str) -> Result<String, Fault> {
    let bar = ProgressBar::new(form.bytes());
    let style = ProgressStyle::with_template(
        "{bar:30} {percent:>3}% sent, {bytes} of {total_bytes} at {binary_bytes_per_sec}",
    );
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let mut body = form.body();
    let mut body = bar.wrap_read(body.by_ref());
    let request = Request::post(remote.url("/v1/jobs"))
        .header(header::CONTENT_TYPE, Form::content_type())
        .header(header::CONTENT_LENGTH, form.bytes())
        // With this header, a refusal arrives before the body is sent.
        .header(header::EXPECT, "100-continue")
        .header("idempotency-key", key);
    let answer = remote.send(&remote.patient, request, SendBody::from_reader(&mut body));
    let sent = bar.position();
    bar.finish_and_clear();
    let answer = answer.map_err(|fault| match fault {
        Fault::Lost(why, _) => Fault::Lost(why, sent > MUCH),
        fault => fault,
    })?;
    if answer.headers().contains_key("idempotent-replayed") {
        eprintln!("this job was submitted before; use --again to create another");
    }
    read_json::<Accepted>(answer).map(|accepted| accepted.id)
}
