//! A client of the service, shared by `fled submit`, `watch`, `fetch`, `retry` and `cancel`.
//!
//! Connections break, so every request is repeated until it is answered. A request counts as done
//! if it took effect but its answer was lost.

mod begun;
pub mod cancel;
pub mod fetch;
mod pieces;
pub mod retry;
pub mod submit;
pub mod watch;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use fled_core::pipeline::error::ErrorKind;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use ureq::http::{Request, Response, StatusCode, header};
use ureq::{Agent, AsSendBody, Body};

use crate::failure::{Failure, io};

/// How long a connection may stall before it counts as lost.
const STALL: Duration = Duration::from_secs(60);
/// Maximum time for an answer: the service validates photographs and hashes files first.
const ANSWER: Duration = Duration::from_secs(600);
/// An attempt has made progress if it moved more bytes than this.
const MUCH: u64 = 1 << 20;
/// Wait between the first two attempts.
const FIRST_WAIT: Duration = Duration::from_secs(1);
/// Maximum wait between attempts, which doubles each time.
const LONGEST_WAIT: Duration = Duration::from_secs(30);
/// Maximum number of unusable photographs listed by name.
const LISTED: usize = 20;
/// The variable that holds a token: other users of this machine could read a token in an argument.
const TOKEN: &str = "FLED_TOKEN";

/// Which service, and as who.
#[derive(clap::Args)]
pub struct Args {
    /// Address of the service.
    #[arg(long, value_name = "URL", env = "FLED_SERVER", default_value = "http://127.0.0.1:8080")]
    server: String,
    /// File with the token, if one is required [default: the variable FLED_TOKEN].
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Seconds to keep retrying while the service does not respond.
    #[arg(long, value_name = "SECONDS", default_value_t = 600)]
    patience: u64,
}

/// A connection to a service.
pub struct Remote {
    /// For requests whose answer takes time.
    patient: Agent,
    /// For files that are only transferred.
    brisk: Agent,
    base: String,
    bearer: Option<String>,
    patience: Duration,
}

/// Why a request failed.
enum Fault {
    /// No answer, or only a part of one: a retry may succeed. The flag is set if much was
    /// transferred.
    Lost(String, bool),
    /// The service asks to retry later.
    Later(Option<Duration>, Failure),
    /// The service refused.
    Refused(Failure),
    /// What the request is about does not exist, or no longer.
    Gone(Failure),
    /// The state of what the request is about does not allow it.
    Conflict(Failure),
    /// A proxy before the service refused the size of the body.
    TooLarge(Failure),
}

/// The fields of a job that are read.
#[derive(Deserialize)]
struct State {
    state: String,
}

/// The fields of a problem document that are read.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Problem {
    /// Missing in the answer of a proxy.
    code: String,
    detail: String,
    hint: String,
    capture: Option<Assessed>,
}

#[derive(Deserialize)]
struct Assessed {
    #[serde(default)]
    images: Vec<Assessment>,
}

#[derive(Deserialize)]
struct Assessment {
    name: String,
    #[serde(default)]
    accepted: bool,
    reason: Option<String>,
}

impl Remote {
    /// # Errors
    /// [`Failure`] if the token cannot be read.
    pub fn new(args: &Args) -> Result<Self, Failure> {
        let token = token(args.token_file.as_deref())?;
        let agent = |silence| -> Agent {
            Agent::config_builder()
                .http_status_as_error(false)
                .timeout_connect(Some(STALL))
                .timeout_per_write(Some(STALL))
                .timeout_per_read(Some(silence))
                .build()
                .into()
        };
        Ok(Self {
            patient: agent(ANSWER),
            brisk: agent(STALL),
            base: args.server.trim_end_matches('/').to_owned(),
            bearer: token.map(|token| format!("Bearer {token}")),
            patience: Duration::from_secs(args.patience),
        })
    }

    /// Address of the service.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Fetches the JSON at a path.
    ///
    /// # Errors
    /// [`Failure`] with the service's own message, or if the service does not answer in time.
    pub fn json<T: DeserializeOwned>(&self, path: &str) -> Result<T, Failure> {
        self.persist(|| self.ask(path))
    }

    fn ask<T: DeserializeOwned>(&self, path: &str) -> Result<T, Fault> {
        let request = Request::get(self.url(path));
        read_json(self.send(&self.patient, request, ())?)
    }

    /// Posts a command to a job, with JSON or no body, and returns the job's new state. If the
    /// first answer was lost and the retry is refused as no longer possible, the command has taken
    /// effect.
    ///
    /// # Errors
    /// As [`Remote::json`].
    fn order(&self, job: &str, verb: &str, body: Option<&Value>) -> Result<String, Failure> {
        let body = body.map(Value::to_string).unwrap_or_default();
        let path = format!("/v1/jobs/{job}");
        let mut is_lost = false;
        let state: State = self.persist(|| {
            let mut request = Request::post(self.url(&format!("{path}/{verb}")));
            if !body.is_empty() {
                request = request.header(header::CONTENT_TYPE, "application/json");
            }
            match self.send(&self.patient, request, body.as_str()) {
                Ok(answer) => read_json(answer),
                Err(Fault::Refused(failure) | Fault::Conflict(failure)) if is_lost => {
                    self.ask(&path).map_err(|_| Fault::Refused(failure))
                }
                Err(fault) => {
                    is_lost |= matches!(fault, Fault::Lost(..));
                    Err(fault)
                }
            }
        })?;
        Ok(state.state)
    }

    /// Requests a file or the rest of it.
    fn download(&self, path: &str, headers: &[(&str, String)]) -> Result<Response<Body>, Fault> {
        let mut request = Request::get(self.url(path));
        for (name, value) in headers {
            request = request.header(*name, value);
        }
        self.send(&self.brisk, request, ())
    }

    fn url(&self, path: &str) -> String {
        format!("{}{path}", self.base)
    }

    /// Sends a request and returns a successful answer.
    fn send(
        &self,
        agent: &Agent,
        mut request: ureq::http::request::Builder,
        body: impl AsSendBody,
    ) -> Result<Response<Body>, Fault> {
        if let Some(bearer) = &self.bearer {
            request = request.header(header::AUTHORIZATION, bearer);
        }
        let request = request.body(body).map_err(|error| Fault::Refused(Failure::usage(error)))?;
        match agent.run(request) {
            Ok(response) if response.status().is_success() => Ok(response),
            Ok(response) => Err(refusal(response)),
            Err(
                error @ (ureq::Error::BadUri(_)
                | ureq::Error::Http(_)
                | ureq::Error::RequireHttpsOnly(_)),
            ) => Err(Fault::Refused(Failure::usage(format!("{}: {error}", self.base)))),
            Err(error) => Err(Fault::Lost(error.to_string(), false)),
        }
    }

    /// Retries until there is an answer, the service refuses, or there is no progress for too long.
    fn persist<T>(&self, mut attempt: impl FnMut() -> Result<T, Fault>) -> Result<T, Failure> {
        let (mut silent_since, mut wait) = (Instant::now(), FIRST_WAIT);
        loop {
            let (pause, failure) = match attempt() {
                Ok(done) => return Ok(done),
                Err(
                    Fault::Refused(failure)
                    | Fault::Gone(failure)
                    | Fault::Conflict(failure)
                    | Fault::TooLarge(failure),
                ) => return Err(failure),
                Err(Fault::Later(pause, failure)) => (pause, failure),
                Err(Fault::Lost(why, has_moved)) => {
                    if has_moved {
                        (silent_since, wait) = (Instant::now(), FIRST_WAIT);
                    }
                    (None, self.lost(&why))
                }
            };
            let pause = pause.unwrap_or(wait);
            if silent_since.elapsed() + pause > self.patience {
                return Err(failure);
            }
            eprintln!("{}; retrying in {} s", failure.detail, pause.as_secs());
            std::thread::sleep(pause);
            wait = (2 * wait).min(LONGEST_WAIT);
        }
    }

    fn lost(&self, why: &str) -> Failure {
        Failure {
            kind: ErrorKind::Environment,
            detail: format!("{} does not respond: {why}", self.base),
            hint: "Check that `fled serve` is running there. Repeat the command to continue."
                .to_owned(),
            wrong_use: false,
        }
    }
}

/// Returns the token in `file`, or in the environment variable.
///
/// # Errors
/// [`Failure`] if the file cannot be read.
fn token(file: Option<&Path>) -> Result<Option<String>, Failure> {
    let token = match file {
        Some(path) => Some(std::fs::read_to_string(path).map_err(io(path))?),
        None => std::env::var(TOKEN).ok(),
    };
    let token = token.map(|token| token.trim().to_owned());
    Ok(token.filter(|token| !token.is_empty()))
}

fn read_json<T: DeserializeOwned>(mut response: Response<Body>) -> Result<T, Fault> {
    // The list of files of hundreds of rounds and views takes some megabytes.
    let body = response.body_mut().with_config().limit(256 << 20);
    let text = body.read_to_vec().map_err(|error| Fault::Lost(error.to_string(), false))?;
    serde_json::from_slice(&text).map_err(|error| {
        let detail = format!("the server there is not a fled service: {error}");
        Fault::Refused(Failure::new(ErrorKind::Environment, detail))
    })
}

/// A refusal, with the service's own message.
fn refusal(mut response: Response<Body>) -> Fault {
    let status = response.status();
    let seconds = response.headers().get(header::RETRY_AFTER);
    let seconds = seconds.and_then(|text| text.to_str().ok()?.parse().ok());
    let text = response.body_mut().read_to_vec().unwrap_or_default();
    let problem: Problem = serde_json::from_slice(&text).unwrap_or_default();
    let is_foreign = problem.code.is_empty();
    let mut detail = match problem.detail.as_str() {
        _ if is_foreign => format!("the server, or a proxy before it, responded with {status}"),
        detail => detail.to_owned(),
    };
    let images = problem.capture.map(|capture| capture.images);
    let images = images.into_iter().flatten();
    for image in images.filter(|image| !image.accepted).take(LISTED) {
        let reason = image.reason.as_deref().unwrap_or("cannot be used");
        detail += &format!("\n      {}: {reason}", image.name);
    }
    let failure = Failure {
        kind: match status {
            // It says nothing about the capture.
            _ if is_foreign => ErrorKind::Environment,
            StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => ErrorKind::Environment,
            status if status.is_client_error() => ErrorKind::BadInput,
            _ => ErrorKind::Environment,
        },
        detail,
        hint: match status {
            StatusCode::UNAUTHORIZED => format!("Put a token in {TOKEN}, or use --token-file."),
            StatusCode::PAYLOAD_TOO_LARGE if is_foreign => {
                "Allow larger request bodies there; for nginx: `client_max_body_size 16m;`."
                    .to_owned()
            }
            _ => problem.hint,
        },
        wrong_use: false,
    };
    let is_over = matches!(
        status,
        StatusCode::LOCKED
            | StatusCode::TOO_MANY_REQUESTS
            | StatusCode::BAD_GATEWAY
            | StatusCode::SERVICE_UNAVAILABLE
            | StatusCode::GATEWAY_TIMEOUT
    );
    if is_foreign && status == StatusCode::PAYLOAD_TOO_LARGE {
        Fault::TooLarge(failure)
    } else if is_over {
        Fault::Later(seconds.map(Duration::from_secs), failure)
    } else {
        match status {
            StatusCode::NOT_FOUND | StatusCode::GONE => Fault::Gone(failure),
            StatusCode::CONFLICT => Fault::Conflict(failure),
            _ => Fault::Refused(failure),
        }
    }
}
