//! Captures that the server fetches itself, of servers that whoever runs it has named.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use fled_core::capture::MAX_FILES;
use percent_encoding::percent_decode_str;
use tokio::sync::oneshot;
use ureq::http::Uri;

use super::budget::Budget;
use super::places::Places;
use super::{LONGEST_FILE_NAME, Upload, Used, check_name};
use crate::app::App;
use crate::error::ServerError;
use crate::http::access::Visitor;
use crate::http::problem::{Problem, too_large};
use crate::http::quota::bytes_left;
use crate::outside::{Origin, check_url, patient_agent, reason};

/// What is read at a time, bytes.
const PIECE: usize = 1 << 16;
/// Until it is worth asking again when others have all turns, seconds.
const RETRY: u32 = 10;

/// An address and the server it is of.
struct Source {
    url: String,
    origin: Origin,
    /// What its path says after decoding: folders and the file's name.
    name: String,
}

/// Fetches files, each under the name that its address ends with, for a capture with these text
/// fields. One after the other: what is fetched is mostly one zip.
///
/// # Errors
/// 422 for addresses that are none, are not allowed or do not answer with a file, 413 and 507 when
/// there is too much, 503 when as many as are allowed are fetched already.
pub async fn fetch(
    app: &Arc<App>,
    urls: &[String],
    fields: BTreeMap<String, String>,
    visitor: &Visitor,
) -> Result<Upload, Problem> {
    let sources = sources(app, urls)?;
    if let Some(name) = fields.get("name") {
        check_name(name)?;
    }
    let turn = app.fetching.clone().try_acquire_owned();
    let turn = turn.map_err(|_| busy())?;
    let most = bytes_left(app, visitor).await?;
    let incoming = app.data.incoming();
    let dir = app.uploads.begin(&incoming);
    let upload = Upload {
        dir: dir.map_err(ServerError::io(&incoming))?,
        fields,
        fingerprint: String::new(),
        files: sources.len(),
        most,
        used: Used::default(),
    };
    let stop = Stop::default();
    let (app, dir, stopped) = (app.clone(), upload.dir.clone(), stop.0.clone());
    let (sender, receiver) = oneshot::channel();
    // A thread of its own: one that waits for a slow server does not keep this one from stopping.
    let work = move || {
        let fetched = fetch_all(&app, dir.path(), &sources, most, &stopped);
        drop((dir, turn));
        // Nobody listens any more where the client has hung up.
        let _ = sender.send(fetched);
    };
    std::thread::Builder::new()
        .name("fetch".to_owned())
        .spawn(work)
        .map_err(ServerError::io(&incoming))?;
    receiver.await.map_err(|_| Problem::internal())??;
    drop(stop);
    Ok(upload)
}

/// Ends the thread when the request is given up.
#[derive(Default)]
struct Stop(Arc<AtomicBool>);

impl Drop for Stop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn sources(app: &App, urls: &[String]) -> Result<Vec<Source>, Problem> {
    if app.config.import_from.is_empty() {
        let detail = "This server fetches nothing: send the files.";
        let hint = "Whoever runs it allows a server by `fled serve --import-from https://HOST`.";
        return Err(Problem::unprocessable("no_imports", detail)
            .pointer("/urls")
            .hint(hint));
    }
    if urls.is_empty() {
        return Err(Problem::unprocessable("bad_input", "There is no address.").pointer("/urls"));
    }
    if urls.len() > MAX_FILES {
        return Err(too_large(&format!("More than {MAX_FILES} files.")));
    }
    let source = |(at, url): (usize, &String)| {
        let refused =
            |code, detail: String| Err(Problem::unprocessable(code, detail).pointer(pointer(at)));
        let uri = match check_url(url) {
            Ok(uri) => uri,
            Err(reason) => {
                return refused(
                    "bad_url",
                    format!("The address cannot be fetched: {reason}."),
                );
            }
        };
        let name = name_of(&uri);
        if name.len() > LONGEST_FILE_NAME {
            let detail = format!("A file name is longer than {LONGEST_FILE_NAME} bytes.");
            return refused("bad_url", detail);
        }
        match Origin::of(&uri).filter(|origin| app.config.import_from.contains(origin)) {
            Some(origin) => Ok(Source {
                url: url.clone(),
                origin,
                name,
            }),
            None => Err(Problem::unprocessable(
                "source_not_allowed",
                "Nothing is fetched from that server.",
            )
            .pointer(pointer(at))
            .hint("Whoever runs this server says which it fetches from: `--import-from`.")),
        }
    };
    urls.iter().enumerate().map(source).collect()
}

/// The path of an address as it names a file. Where it goes on the disk is for [`Places`] to say.
fn name_of(uri: &Uri) -> String {
    percent_decode_str(uri.path().trim_matches('/'))
        .decode_utf8_lossy()
        .into_owned()
}

fn fetch_all(
    app: &App,
    dir: &Path,
    sources: &[Source],
    most: Option<u64>,
    stopped: &AtomicBool,
) -> Result<(), Problem> {
    let mut places = Places::default();
    let mut budget = Budget::new(app, most);
    let ends = Instant::now() + app.limits.fetching_time;
    for (at, source) in sources.iter().enumerate() {
        let path = dir.join(places.place("images", &source.name));
        let left = ends.saturating_duration_since(Instant::now());
        fetch_one(source, &path, &mut budget, left, stopped)
            .map_err(|problem| problem.pointer(pointer(at)))?;
    }
    Ok(())
}

fn fetch_one(
    source: &Source,
    path: &Path,
    budget: &mut Budget<'_>,
    left: Duration,
    stopped: &AtomicBool,
) -> Result<(), Problem> {
    // An address of an inner network is fetched from where it was allowed as such; a name may come
    // to stand for one without anybody's leave.
    let agent = patient_agent(left, budget.app.limits.stall, source.origin.is_address());
    let answer = agent.get(&source.url).call();
    let mut answer = answer.map_err(|error| unfetched(source, &reason(&error)))?;
    let status = answer.status();
    if status.is_redirection() {
        let hint = "Redirects are not followed: name the address that it leads to.";
        return Err(unfetched(source, &format!("it answers {}", status.as_u16())).hint(hint));
    }
    if status != StatusCode::OK.as_u16() {
        return Err(unfetched(
            source,
            &format!("it answers {}", status.as_u16()),
        ));
    }
    // Told before gigabytes are read.
    budget.expect(answer.body().content_length().unwrap_or(0))?;
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(ServerError::io(parent))?;
    }
    let mut file = File::create(path).map_err(ServerError::io(path))?;
    let mut body = answer.body_mut().as_reader();
    let mut piece = vec![0; PIECE];
    loop {
        let read = body.read(&mut piece);
        let read = read.map_err(|error| unfetched(source, &error.to_string()))?;
        if read == 0 {
            return Ok(());
        }
        if stopped.load(Ordering::Relaxed) {
            return Err(unfetched(source, "nobody waits for it any more"));
        }
        budget.count(read)?;
        file.write_all(&piece[..read])
            .map_err(ServerError::io(path))?;
    }
}

fn unfetched(source: &Source, reason: &str) -> Problem {
    let detail = format!("{} sent no file: {reason}.", source.origin);
    Problem::unprocessable("not_fetched", detail)
}

fn busy() -> Problem {
    let detail = "As many captures as are allowed are being fetched.";
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", detail)
        .hint("Try again when one is done.")
        .retry_after(RETRY)
}

fn pointer(at: usize) -> String {
    format!("/urls/{at}")
}
