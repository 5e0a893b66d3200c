//! An S3 server on a free port, over a temporary folder, that misbehaves when it is told to.

use std::convert::Infallible;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::Duration;

use futures::Stream;
use hyper::body::Incoming;
use hyper::header::CONTENT_LENGTH;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use s3s::auth::SimpleAuth;
use s3s::service::{S3Service, S3ServiceBuilder};
use s3s::stream::{ByteStream, DynByteStream, RemainingLength};
use s3s::{Body, HttpError};
use tempfile::TempDir;
use tokio::net::TcpListener;

use crate::Blobs;

/// What becomes of a request.
#[derive(Clone, Copy)]
pub enum Fault {
    /// It is answered.
    None,
    /// It is refused with this status.
    Status(u16),
    /// The connection ends after so many bytes of the answer.
    CutAfter(usize),
    /// Nothing comes after so many bytes of the answer.
    StallAfter(usize),
    /// The answer has the length and the bytes of its beginning alone.
    ShortenTo(usize),
    /// The first byte of the answer is another one.
    Flip,
    /// The answer begins later.
    Late(Duration),
}

/// Decides by method and address, for example `PUT /bucket/key`.
type Rule = Box<dyn Fn(&str) -> Fault + Send>;

struct State {
    service: S3Service,
    rule: Mutex<Rule>,
    requests: Mutex<Vec<String>>,
    now: AtomicUsize,
    most: AtomicUsize,
}

pub struct Server {
    address: String,
    root: TempDir,
    state: Arc<State>,
}

impl Server {
    pub async fn start() -> Self {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir(root.path().join("bucket")).unwrap();
        let mut service = S3ServiceBuilder::new(s3s_fs::FileSystem::new(root.path()).unwrap());
        service.set_auth(SimpleAuth::from_single("name", "password"));
        let state = Arc::new(State {
            service: service.build(),
            rule: Mutex::new(Box::new(|_| Fault::None)),
            requests: Mutex::default(),
            now: AtomicUsize::new(0),
            most: AtomicUsize::new(0),
        });
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        tokio::spawn(serve(listener, state.clone()));
        Self {
            address,
            root,
            state,
        }
    }

    /// A store here, whose requests are made again for `patience`.
    pub fn blobs(&self, patience: Duration) -> Blobs {
        self.blobs_with("bucket/some/prefix", &[], patience)
    }

    /// As [`Server::blobs`], but a request may make no progress for a second only.
    pub fn hasty_blobs(&self, patience: Duration) -> Blobs {
        let hasty = [("AWS_READ_TIMEOUT", "1 second")];
        self.blobs_with("bucket/some/prefix", &hasty, patience)
    }

    pub fn blobs_with(&self, place: &str, more: &[(&str, &str)], patience: Duration) -> Blobs {
        let settings = [
            ("AWS_ENDPOINT", self.address.as_str()),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ACCESS_KEY_ID", "name"),
            ("AWS_SECRET_ACCESS_KEY", "password"),
            ("HOME", "not ours"),
        ];
        let settings = settings.iter().chain(more).copied();
        let settings = settings.map(|(name, value)| (name.to_owned(), value.to_owned()));
        Blobs::bucket(place, settings, patience).unwrap()
    }

    /// Where the objects of [`Server::blobs`] lie.
    pub fn objects(&self) -> PathBuf {
        self.root.path().join("bucket/some/prefix")
    }

    /// Files of uploads that were neither completed nor aborted.
    pub fn unfinished(&self) -> Vec<String> {
        let mut names = super::names(self.root.path());
        names.retain(|name| name.starts_with(".upload"));
        names
    }

    pub fn misbehave(&self, rule: impl Fn(&str) -> Fault + Send + 'static) {
        *self.state.rule.lock().unwrap() = Box::new(rule);
    }

    /// Does this to the first `count` requests that begin so.
    pub fn misbehave_first(&self, count: usize, begin: &'static str, fault: Fault) {
        let done = AtomicUsize::new(0);
        self.misbehave(move |request| {
            let meant = request.starts_with(begin);
            if meant && done.fetch_add(1, Ordering::Relaxed) < count {
                fault
            } else {
                Fault::None
            }
        });
    }

    /// How many requests began so.
    pub fn count(&self, begin: &str) -> usize {
        let requests = self.state.requests.lock().unwrap();
        let meant = requests.iter().filter(|request| request.starts_with(begin));
        meant.count()
    }

    /// The most requests that were under way at one time.
    pub fn most_at_once(&self) -> usize {
        self.state.most.load(Ordering::Relaxed)
    }
}

async fn serve(listener: TcpListener, state: Arc<State>) {
    loop {
        let (socket, _) = listener.accept().await.unwrap();
        let state = state.clone();
        let answer = hyper::service::service_fn(move |request| {
            let state = state.clone();
            async move { Ok::<_, Infallible>(answer(&state, request).await) }
        });
        let connection = hyper::server::conn::http1::Builder::new()
            .serve_connection(TokioIo::new(socket), answer);
        tokio::spawn(async move { drop(connection.await) });
    }
}

async fn answer(state: &State, request: Request<Incoming>) -> Response<Body> {
    let name = format!("{} {}", request.method(), request.uri());
    let fault = state.rule.lock().unwrap()(&name);
    state.requests.lock().unwrap().push(name);
    let now = 1 + state.now.fetch_add(1, Ordering::Relaxed);
    state.most.fetch_max(now, Ordering::Relaxed);
    if let Fault::Late(wait) = fault {
        tokio::time::sleep(wait).await;
    }
    let is_head = request.method() == Method::HEAD;
    let answer = match fault {
        Fault::Status(status) => Ok(refusal(status)),
        _ => state.service.call(request.map(Body::from)).await,
    };
    state.now.fetch_sub(1, Ordering::Relaxed);
    let answer = answer.unwrap_or_else(|_: HttpError| refusal(500));
    if is_head {
        answer
    } else {
        spoil(answer, fault)
    }
}

fn refusal(status: u16) -> Response<Body> {
    let mut refusal = Response::new(Body::empty());
    *refusal.status_mut() = StatusCode::from_u16(status).unwrap();
    refusal
}

fn spoil(mut answer: Response<Body>, fault: Fault) -> Response<Body> {
    let left = match fault {
        Fault::CutAfter(bytes) | Fault::StallAfter(bytes) | Fault::ShortenTo(bytes) => bytes,
        Fault::Flip => usize::MAX,
        Fault::None | Fault::Status(_) | Fault::Late(_) => return answer,
    };
    if let Fault::ShortenTo(bytes) = fault {
        answer.headers_mut().insert(CONTENT_LENGTH, bytes.into());
    }
    answer.map(|inner| {
        let spoiled: DynByteStream = Box::pin(Spoiled { inner, left, fault });
        Body::from(spoiled)
    })
}

/// A body with something wrong in it.
struct Spoiled {
    inner: Body,
    /// Bytes until then.
    left: usize,
    fault: Fault,
}

impl Stream for Spoiled {
    type Item = <Body as Stream>::Item;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.left == 0 {
            return match self.fault {
                Fault::CutAfter(_) => Poll::Ready(Some(Err("cut".into()))),
                Fault::StallAfter(_) => Poll::Pending,
                _ => Poll::Ready(None),
            };
        }
        let polled = Pin::new(&mut self.inner).poll_next(context);
        polled.map(|chunk| {
            chunk.map(|chunk| {
                let mut chunk = chunk?;
                chunk.truncate(self.left);
                self.left -= chunk.len();
                if let Fault::Flip = self.fault {
                    self.fault = Fault::None;
                    let mut flipped = chunk.to_vec();
                    flipped[0] ^= 1;
                    chunk = flipped.into();
                }
                Ok(chunk)
            })
        })
    }
}

impl ByteStream for Spoiled {
    fn remaining_length(&self) -> RemainingLength {
        RemainingLength::unknown()
    }
}
