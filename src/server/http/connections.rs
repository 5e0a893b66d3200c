//! Limits on the number of connections and on how long each may keep the server waiting.
//!
//! A silent or very slow client costs a descriptor and a place. So headers, bodies and answers have
//! to progress, and when all places are taken, the connection that has been idle longest makes room
//! for a new one.

mod pace;

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::pin::{Pin, pin};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::{Request, StatusCode, header};
use hyper::body::{Body as HttpBody, Frame, Incoming, SizeHint};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use rustix::process::{Resource, getrlimit};
use serde_json::json;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::client::ClientAddress;
use super::problem::Problem;
use crate::config::Limits;
use pace::{PacedBody, PacedStream};

/// Descriptors that the server needs besides connections: database, logs, pipes of children.
const DESCRIPTORS: u64 = 64;
/// Pause after a failed accept, which is mostly due to a lack of descriptors.
const RECOVERY: Duration = Duration::from_millis(100);
/// Seconds after which a place may be free.
const RETRY: u32 = 5;

/// Accepts connections until `shutdown`, then lets open requests end.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    limits: Limits,
    shutdown: CancellationToken,
) {
    let places = Arc::new(Places::new(places(limits.connections)));
    let mut open = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            // Remove ended ones at once, or the set would grow forever.
            Some(_) = open.join_next() => continue,
            () = shutdown.cancelled() => break,
        };
        let (stream, address) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(RECOVERY).await;
                continue;
            }
        };
        let Some(place) = places.take() else {
            tracing::warn!(%address, "a connection was refused: all are in use");
            // A few bytes always fit into a socket that has sent nothing yet.
            drop(stream.try_write(&full()));
            continue;
        };
        // Short answers must not wait for the acknowledgement of earlier ones.
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "cannot set TCP_NODELAY");
        }
        let (router, shutdown) = (router.clone(), shutdown.clone());
        let client = ClientAddress::of(address.ip());
        open.spawn(async move {
            converse((stream, client), router, &limits, &place, &shutdown).await;
        });
    }
    drop(listener);
    while open.join_next().await.is_some() {}
}

/// The answer when every place is taken by an active request.
fn full() -> Vec<u8> {
    let problem = Problem::new(
        StatusCode::SERVICE_UNAVAILABLE,
        "too_many_connections",
        "All connections of the server are in use.",
    );
    let body = json!(problem.hint("Try again in some seconds.")).to_string();
    let head = format!(
        "HTTP/1.1 503 Service Unavailable\r\nRetry-After: {RETRY}\r\nConnection: close\r\n\
         Content-Type: application/problem+json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body.as_bytes()].concat()
}

/// The number of places: as many as requested, as far as descriptors allow. A connection may open a
/// file in addition to its socket.
fn places(asked: usize) -> usize {
    let descriptors = getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX);
    let possible = descriptors.saturating_sub(DESCRIPTORS) / 2;
    asked.min(usize::try_from(possible).unwrap_or(usize::MAX)).max(1)
}

/// Answers the requests of one connection.
async fn converse(
    (stream, client): (TcpStream, ClientAddress),
    router: Router,
    limits: &Limits,
    place: &Place,
    shutdown: &CancellationToken,
) {
    let stall = limits.stall;
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(client);
        let busy = Busy::of(&place.state);
        let is_asked_for = request.headers().contains_key(header::EXPECT);
        let answer = router
            .clone()
            .oneshot(request.map(|body| Body::new(PacedBody::new(body, stall, is_asked_for))));
        async move {
            let response = answer.await?;
            Ok::<_, Infallible>(response.map(|body| Body::new(Held { body, _busy: busy })))
        }
    });
    let mut connection = pin!(
        http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(limits.header)
            .serve_connection(TokioIo::new(PacedStream::new(stream, stall)), service)
    );
    let outcome = tokio::select! {
        outcome = connection.as_mut() => outcome,
        () = place.state.leave.cancelled() => return,
        () = shutdown.cancelled() => {
            if place.state.is_idle() {
                return;
            }
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = outcome {
        tracing::debug!(%error, "a connection ended");
    }
}

/// The places for connections.
#[derive(Debug)]
struct Places {
    most: usize,
    began: Instant,
    taken: Mutex<BTreeMap<u64, Arc<State>>>,
    next: AtomicU64,
}

/// The state of a connection.
#[derive(Debug)]
struct State {
    /// Requests in progress.
    busy: AtomicUsize,
    /// Milliseconds between [`Places::began`] and the end of the last request.
    idle_since: AtomicU64,
    began: Instant,
    leave: CancellationToken,
}

/// A place, freed when dropped.
struct Place {
    number: u64,
    state: Arc<State>,
    places: Arc<Places>,
}

impl Places {
    fn new(most: usize) -> Self {
        Self { most, began: Instant::now(), taken: Mutex::default(), next: AtomicU64::new(0) }
    }

    /// Takes a free place, or that of the connection idle longest; `None` if all are busy.
    fn take(self: &Arc<Self>) -> Option<Place> {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if taken.len() >= self.most {
            let idle = taken.iter().filter(|(_, state)| state.is_idle());
            let (&number, _) =
                idle.min_by_key(|(_, state)| state.idle_since.load(Ordering::Relaxed))?;
            if let Some(state) = taken.remove(&number) {
                state.leave.cancel();
            }
        }
        let state = Arc::new(State {
            busy: AtomicUsize::new(0),
            idle_since: AtomicU64::new(0),
            began: self.began,
            leave: CancellationToken::new(),
        });
        state.rest();
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        taken.insert(number, state.clone());
        Some(Place { number, state, places: self.clone() })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let taken = self.places.taken.lock();
        taken.unwrap_or_else(PoisonError::into_inner).remove(&self.number);
    }
}

impl State {
    fn is_idle(&self) -> bool {
        self.busy.load(Ordering::Relaxed) == 0
    }

    fn rest(&self) {
        let now = u64::try_from(self.began.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.idle_since.store(now, Ordering::Relaxed);
    }
}

/// A request in progress, until the last byte of its answer is sent.
struct Busy(Arc<State>);

impl Busy {
    fn of(state: &Arc<State>) -> Self {
        state.busy.fetch_add(1, Ordering::Relaxed);
        Self(state.clone())
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.rest();
        self.0.busy.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The body of an answer, which keeps its connection busy.
struct Held {
    body: Body,
    _busy: Busy,
}

impl HttpBody for Held {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
