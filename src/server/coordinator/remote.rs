//! A service that is reached by HTTP alone, as a worker sees it: what stands in its database is
//! asked and told below `/v1/work`, with a token.
//!
//! Connections break. What is told is told again for as long as a worker may go on without being
//! heard of; what had been done although its answer was lost is not done twice.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use fled_blobs::{Blobs, Kept, choose_tls};
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, HeaderMap, HeaderName, HeaderValue};
use reqwest::{Client, ClientBuilder, Method, Response, StatusCode, Url, redirect};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::errand::{Awaited, Errand, Headway, Kind, Outcome, Willing};
use super::wire::{
    Assignment, Failures, Files, LEASE_LOST, Present, Pulse, Released, Settled, Standing, Told,
    Under, VERSION, VERSION_HEADER, Wanted,
};
use crate::config::Service;
use crate::error::{Result, ServerError};
use crate::jobs::state::JobState;
use crate::store::{About, Lease, Machine, Saying, Settlement};

/// A service that is away is asked again for so long: not longer than a worker may go on without
/// being heard of.
const PATIENCE: Duration = Duration::from_secs(20);
/// Between two attempts.
const PAUSE: Duration = Duration::from_millis(500);
/// A question has to be answered within this.
const ANSWER: Duration = Duration::from_secs(15);
/// A connection has to be made within this.
const CONNECT: Duration = Duration::from_secs(10);
/// Nothing moves for so long: the connection is lost.
const STALL: Duration = Duration::from_secs(30);

/// A service. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Remote {
    client: Client,
    blobs: Blobs,
    /// Its address without a slash at the end.
    base: Arc<str>,
    /// How much was told of each job under its lease, where that is known.
    told: Arc<Mutex<HashMap<String, i64>>>,
}

/// What is read of a problem document.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Problem {
    code: String,
    detail: String,
    hint: String,
}

impl Remote {
    /// What asks a service. Asks nothing yet.
    ///
    /// # Errors
    /// [`ServerError::BadService`] when its address or the token can be none.
    pub fn new(service: &Service) -> Result<Self> {
        let bad = |detail: &str| ServerError::BadService(detail.to_owned());
        let url: Url = service.url.parse().map_err(|_| bad("it is no URL"))?;
        if !matches!(url.scheme(), "http" | "https") {
            return Err(bad("it begins with neither https:// nor http://"));
        }
        if url.host_str().is_none_or(str::is_empty) {
            return Err(bad("it names no host"));
        }
        if !url.username().is_empty() || url.password().is_some() || url.query().is_some() {
            return Err(bad("it holds more than a host and a path"));
        }
        let headers = headers(service).ok_or_else(|| bad("the token has signs that none has"))?;
        if url.scheme() == "http" && service.token.is_some() && !is_this_machine(&url) {
            tracing::warn!(
                "the token and all files go through the network in the clear: https:// hides them"
            );
        }
        let build = |client: ClientBuilder| client.build().map_err(|error| bad(&words(&error)));
        let brisk = build(client(&headers).read_timeout(STALL))?;
        let patient = build(client(&headers))?;
        let base = url.as_str().trim_end_matches('/');
        let blobs = Blobs::of_service(brisk.clone(), patient, &format!("{base}/v1/work/blobs"));
        Ok(Self {
            client: brisk,
            blobs,
            base: base.into(),
            told: Arc::default(),
        })
    }

    /// The files that it keeps.
    pub fn blobs(&self) -> Blobs {
        self.blobs.clone()
    }

    /// Says that a worker begins: whatever it ran before waits again. Asks once.
    ///
    /// # Errors
    /// [`ServerError::Away`], [`ServerError::Refused`].
    pub async fn begin(&self, worker: &str) -> Result<Vec<String>> {
        let path = format!("workers/{worker}/release");
        let released: Released = self.json(Method::POST, &path, None::<&()>).await?;
        Ok(released.jobs)
    }

    /// Says that a worker is there.
    ///
    /// # Errors
    /// As [`Remote::begin`].
    pub async fn see(&self, worker: &str, about: &About, draining: bool) -> Result<()> {
        let present = Present {
            about: about.clone(),
            draining,
        };
        let path = format!("workers/{worker}");
        self.send(Method::PUT, &path, Some(&present))
            .await
            .map(drop)
    }

    /// Says that a worker goes.
    ///
    /// # Errors
    /// As [`Remote::begin`].
    pub async fn forget(&self, worker: &str) -> Result<()> {
        let path = format!("workers/{worker}");
        self.send(Method::DELETE, &path, None::<&()>)
            .await
            .map(drop)
    }

    /// Takes a job. A wish that was granted although nobody heard of it is granted once.
    ///
    /// # Errors
    /// As [`Remote::begin`].
    pub async fn claim(
        &self,
        (worker, turn): (&str, u32),
        running: &[String],
        machine: Machine,
    ) -> Result<Option<Assignment>> {
        let wanted = Wanted {
            turn,
            wish: Uuid::now_v7().to_string(),
            running: running.to_vec(),
            has_gpu: machine.has_gpu,
            memory: machine.memory,
        };
        let path = format!("workers/{worker}/claim");
        let ask = || self.send(Method::POST, &path, Some(&wanted));
        let answer = self.persist(ask).await?;
        if answer.status() == StatusCode::NO_CONTENT {
            return Ok(None);
        }
        let job: Assignment = self.read(answer).await?;
        self.lock().insert(job.lease.job.clone(), 0);
        Ok(Some(job))
    }

    /// Extends a lease. Asks once.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn heartbeat(&self, lease: &Lease) -> Result<Pulse> {
        let under = Under { epoch: lease.epoch };
        let path = format!("jobs/{}/heartbeat", lease.job);
        of(lease, self.json(Method::POST, &path, Some(&under)).await)
    }

    /// Tells one thing, once. A lease is one worker's, which tells one thing after the other.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn tell(&self, lease: &Lease, saying: Saying<'_>) -> Result<()> {
        // Forgotten until it is known that this was told: then the service is asked.
        let known = self.lock().remove(&lease.job);
        let before = match known {
            Some(before) => before,
            None => self.persist(|| self.heartbeat(lease)).await?.told,
        };
        let told = Told {
            epoch: lease.epoch,
            before,
            what: saying.into(),
        };
        let path = format!("jobs/{}/told", lease.job);
        let ask = || self.send(Method::POST, &path, Some(&told));
        of(lease, self.persist(ask).await)?;
        self.lock().insert(lease.job.clone(), before + 1);
        Ok(())
    }

    /// Failures in a row without progress, counting one that happens now.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn count_failure(&self, lease: &Lease) -> Result<u32> {
        let path = format!("jobs/{}/failures", lease.job);
        let counted: Failures = self.look(lease, &path).await?;
        Ok(counted.failures)
    }

    /// Ends an attempt.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn settle(&self, lease: &Lease, settlement: &Settlement) -> Result<JobState> {
        let settled = Settled {
            epoch: lease.epoch,
            settlement: settlement.clone(),
        };
        let path = format!("jobs/{}/settle", lease.job);
        let ask = || self.json(Method::POST, &path, Some(&settled));
        let standing: Standing = of(lease, self.persist(ask).await)?;
        self.lock().remove(&lease.job);
        Ok(standing.state)
    }

    /// The files of the capture of a job.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn capture_files(&self, lease: &Lease) -> Result<Vec<Kept>> {
        let path = format!("jobs/{}/capture", lease.job);
        let files: Files = self.look(lease, &path).await?;
        Ok(files.files.into_iter().map(Kept::from).collect())
    }

    /// The files of a job and the version of them.
    ///
    /// # Errors
    /// [`ServerError::LeaseLost`] when another worker has the job.
    pub async fn job_files(&self, lease: &Lease) -> Result<(i64, Vec<Kept>)> {
        let path = format!("jobs/{}/files", lease.job);
        let files: Files = self.look(lease, &path).await?;
        let kept = files.files.into_iter().map(Kept::from).collect();
        Ok((files.version, kept))
    }

    /// Takes up what is asked of a worker; waits a while for something.
    ///
    /// # Errors
    /// As [`Remote::begin`].
    pub async fn next_errand(&self, worker: &str, kind: Kind) -> Result<Option<Errand>> {
        let path = format!("workers/{worker}/errand");
        let willing = Willing { kind };
        let answer = self.send(Method::POST, &path, Some(&willing)).await?;
        if answer.status() == StatusCode::NO_CONTENT {
            return Ok(None);
        }
        self.read(answer).await.map(Some)
    }

    /// A worker still does it; whether somebody waits for it. Asks once.
    ///
    /// # Errors
    /// As [`Remote::begin`].
    pub async fn extend_errand(&self, worker: &str, id: &str, headway: Headway) -> Result<bool> {
        let path = format!("workers/{worker}/errands/{id}");
        let awaited: Awaited = self.json(Method::PUT, &path, Some(&headway)).await?;
        Ok(awaited.awaited)
    }

    /// Says what came of it.
    ///
    /// # Errors
    /// As [`Remote::begin`].
    pub async fn answer_errand(&self, worker: &str, id: &str, outcome: &Outcome) -> Result<()> {
        let path = format!("workers/{worker}/errands/{id}/outcome");
        let ask = || self.send(Method::POST, &path, Some(outcome));
        self.persist(ask).await.map(drop)
    }

    /// What the service knows of a job, to whom has its lease.
    async fn look<T: DeserializeOwned>(&self, lease: &Lease, path: &str) -> Result<T> {
        let path = format!("{path}?epoch={}", lease.epoch);
        let ask = || self.json(Method::GET, &path, None::<&()>);
        of(lease, self.persist(ask).await)
    }

    /// Asks again while the service is away.
    async fn persist<T, F>(&self, ask: impl Fn() -> F) -> Result<T>
    where
        F: Future<Output = Result<T>>,
    {
        let begun = Instant::now();
        loop {
            match ask().await {
                Err(error) if error.passes() && begun.elapsed() < PATIENCE => {
                    tracing::warn!(%error, "said again");
                    tokio::time::sleep(PAUSE).await;
                }
                answered => return answered,
            }
        }
    }

    async fn json<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &str,
        body: Option<&impl Serialize>,
    ) -> Result<T> {
        self.read(self.send(method, path, body).await?).await
    }

    async fn read<T: DeserializeOwned>(&self, answer: Response) -> Result<T> {
        let text = answer.bytes().await.map_err(|error| self.away(&error))?;
        serde_json::from_slice(&text).map_err(|error| {
            let detail = format!("what answers there is no fled service: {error}");
            self.refused(String::new(), detail)
        })
    }

    /// An answer that says yes.
    async fn send(
        &self,
        method: Method,
        path: &str,
        body: Option<&impl Serialize>,
    ) -> Result<Response> {
        let url = format!("{}/v1/work/{path}", self.base);
        let mut request = self.client.request(method, url).timeout(ANSWER);
        if let Some(body) = body {
            let body = serde_json::to_vec(body).map_err(|error| ServerError::Damaged {
                what: "message",
                detail: error.to_string(),
            })?;
            request = request.header(CONTENT_TYPE, "application/json").body(body);
        }
        let answer = request.send().await.map_err(|error| self.away(&error))?;
        let status = answer.status();
        if status.is_success() {
            return Ok(answer);
        }
        let text = answer.bytes().await.map_err(|error| self.away(&error))?;
        let problem: Problem = serde_json::from_slice(&text).unwrap_or_default();
        let detail = match problem.detail.as_str() {
            "" => format!("it answers {status}"),
            detail => format!("{detail} {}", problem.hint).trim_end().to_owned(),
        };
        let later = [StatusCode::TOO_MANY_REQUESTS, StatusCode::REQUEST_TIMEOUT];
        if status.is_server_error() || later.contains(&status) {
            let service = self.base.to_string();
            return Err(ServerError::Away { service, detail });
        }
        Err(self.refused(problem.code, detail))
    }

    fn away(&self, error: &reqwest::Error) -> ServerError {
        ServerError::Away {
            service: self.base.to_string(),
            detail: words(error),
        }
    }

    fn refused(&self, code: String, detail: String) -> ServerError {
        ServerError::Refused {
            service: self.base.to_string(),
            code,
            detail,
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, i64>> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An answer about a job.
fn of<T>(lease: &Lease, answer: Result<T>) -> Result<T> {
    answer.map_err(|error| match error {
        ServerError::Refused { code, .. } if code == LEASE_LOST => {
            ServerError::LeaseLost(lease.job.clone())
        }
        error => error,
    })
}

/// What every request says.
fn headers(service: &Service) -> Option<HeaderMap> {
    let mut headers = HeaderMap::new();
    let version = HeaderName::from_static(VERSION_HEADER);
    headers.insert(version, HeaderValue::from_static(VERSION));
    if let Some(token) = &service.token {
        let bearer = format!("Bearer {}", token.reveal());
        let mut bearer = HeaderValue::from_str(&bearer).ok()?;
        bearer.set_sensitive(true);
        headers.insert(AUTHORIZATION, bearer);
    }
    Some(headers)
}

fn client(headers: &HeaderMap) -> ClientBuilder {
    choose_tls();
    Client::builder()
        .default_headers(headers.clone())
        .user_agent(concat!("fled/", env!("CARGO_PKG_VERSION")))
        // Another address is another question, and the token is for this one.
        .redirect(redirect::Policy::none())
        .connect_timeout(CONNECT)
        .tcp_keepalive(STALL)
        .tcp_user_timeout(STALL)
}

/// Whether nothing that is sent there leaves this machine.
fn is_this_machine(url: &Url) -> bool {
    let host = url.host_str().unwrap_or_default();
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let address = host.parse::<std::net::IpAddr>();
    host.eq_ignore_ascii_case("localhost") || address.is_ok_and(|address| address.is_loopback())
}

/// Why there was no answer, with what lies below it.
fn words(error: &reqwest::Error) -> String {
    let mut words = error.to_string();
    let mut below = std::error::Error::source(error);
    while let Some(error) = below {
        words = format!("{words}: {error}");
        below = error.source();
    }
    words
}
