//! `fled submit`: sends a capture to a service.

use std::io::Write;
use std::path::PathBuf;

use fled_core::pipeline::config::Preset;
use fled_core::pipeline::error::ErrorKind;
use serde::Deserialize;
use serde_json::{Map, Value};
use ureq::http::{Request, header};

use super::begun::Begun;
use super::pieces::{Files, discard};
use super::retry::assigned;
use super::{Fault, Remote, fetch, read_json, watch};
use crate::failure::Failure;

/// Arguments of `fled submit`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder of photographs, ZIP file, or video (MP4, MOV).
    capture: PathBuf,
    #[command(flatten)]
    remote: super::Args,
    /// Preset: auto (high on a GPU with at least 6 GB of memory, else standard), preview, standard,
    /// high or paper [default: the service's, auto].
    #[arg(long)]
    preset: Option<Preset>,
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

#[derive(Deserialize)]
struct Jobs {
    jobs: Vec<Accepted>,
}

/// Sends the capture, watches the job and fetches its result. Repeating the command resumes an
/// interrupted one: the same capture and options give the same job.
///
/// # Errors
/// [`Failure`] with the service's own message.
pub fn main(args: &Args) -> Result<(), Failure> {
    let remote = Remote::new(&args.remote)?;
    let mut order = order(args)?;
    let files = Files::new(&args.capture, &Value::Object(order.clone()).to_string())?;
    let mut key = files.digest.to_hex().to_string();
    if args.again {
        let now = std::time::SystemTime::UNIX_EPOCH.elapsed();
        key += &format!("-{}", now.unwrap_or_default().as_nanos());
    }
    // Also checks the address and the token before anything is sent.
    let before: Jobs = remote.json(&format!("/v1/jobs?idempotency_key={key}"))?;
    let job = if let Some(job) = before.jobs.into_iter().next() {
        eprintln!("this job was submitted before; use --again to create another");
        job.id
    } else {
        let mut begun = Begun::open(remote.base(), &files.digest);
        let sent = files.send(&remote, &mut begun).and_then(|uploads| {
            order.insert("uploads".to_owned(), uploads.into());
            remote.persist(|| create(&remote, &order, &key))
        });
        let created = sent.inspect_err(|_| discard(&remote, &mut begun))?;
        begun.forget();
        created
    };
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

/// The order of the job, without its uploads.
fn order(args: &Args) -> Result<Map<String, Value>, Failure> {
    let options = assigned(args.preset.unwrap_or(Preset::Auto), &args.assignments)?;
    let name = args.name.clone().or_else(|| {
        let path = args.capture.canonicalize().ok()?;
        Some(path.file_stem()?.to_string_lossy().into_owned())
    });
    let fields = [
        ("name", name.map(Value::from)),
        // Left open unless it is given: an older service has another default.
        ("preset", args.preset.map(|preset| preset.name().into())),
        ("options", Some(Value::Object(options))),
        ("frames", args.frames.map(Value::from)),
        ("priority", args.priority.map(Value::from)),
    ];
    let fields = fields.into_iter();
    Ok(fields.filter_map(|(key, value)| Some((key.to_owned(), value?))).collect())
}

/// Creates the job; the key makes repeated requests a single one.
fn create(remote: &Remote, order: &Map<String, Value>, key: &str) -> Result<String, Fault> {
    let request = Request::post(remote.url("/v1/jobs"))
        .header(header::CONTENT_TYPE, "application/json")
        .header("idempotency-key", key);
    let body = Value::Object(order.clone()).to_string();
    let answer = remote.send(&remote.patient, request, body.as_str())?;
    read_json::<Accepted>(answer).map(|accepted| accepted.id)
}
