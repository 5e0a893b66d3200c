//! An S3 server on a free port, over a temporary folder, with injected faults.

use std::convert::Infallible;
use std::path::Path;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::Duration;

use futures::{Stream, StreamExt};
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
use tokio_util::sync::CancellationToken;

/// The treatment of a request.
#[derive(Clone, Copy, Debug)]
pub enum Fault {
    /// Responds normally.
    None,
    /// Refuses with this status.
    Status(u16),
    /// Closes the connection after this many bytes of the response.
    CutAfter(usize),
    /// Stalls after this many bytes of the response.
    StallAfter(usize),
    /// Truncates the response, and its length, to its first bytes.
    ShortenTo(usize),
    /// Changes the first byte of the response.
    Flip,
    /// Delays the response.
    Late(Duration),
}

/// Chooses a fault by method and path, for example `PUT /bucket/key`.
type Rule = Box<dyn Fn(&str) -> Fault + Send>;

struct State {
    service: S3Service,
    rule: Mutex<Rule>,
    requests: Mutex<Vec<String>>,
    now: AtomicUsize,
    most: AtomicUsize,
}

/// An S3 server with one bucket, `bucket`, until it is dropped.
#[expect(missing_debug_implementations, reason = "a service of s3s has none")]
pub struct S3 {
    address: String,
    root: TempDir,
    state: Arc<State>,
    stop: CancellationToken,
}

impl Drop for S3 {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

impl S3 {
    /// Starts a server in a separate thread.
    ///
    /// # Panics
    /// If there is no free port or no temporary folder.
    pub fn start() -> Self {
        let root = tempfile::tempdir().expect("temporary directory");
        std::fs::create_dir(root.path().join("bucket")).expect("a bucket");
        let files = s3s_fs::FileSystem::new(root.path()).expect("a file system");
        let mut service = S3ServiceBuilder::new(files);
        service.set_auth(SimpleAuth::from_single("name", "password"));
        let state = Arc::new(State {
            service: service.build(),
            rule: Mutex::new(Box::new(|_| Fault::None)),
            requests: Mutex::default(),
            now: AtomicUsize::new(0),
            most: AtomicUsize::new(0),
        });
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
        listener.set_nonblocking(true).expect("a socket");
        let address = format!("http://{}", listener.local_addr().expect("address"));
        let stop = CancellationToken::new();
        let (serving, stopped) = (state.clone(), stop.clone());
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
                .expect("a runtime");
            runtime.block_on(async {
                let listener = TcpListener::from_std(listener).expect("a socket");
                tokio::select! {
                    () = serve(listener, serving) => {}
                    () = stopped.cancelled() => {}
                }
            });
        });
        Self { address, root, state, stop }
    }

    /// The settings of a client, named like the environment variables.
    pub fn settings(&self) -> [(&'static str, &str); 5] {
        [
            ("AWS_ENDPOINT", &self.address),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ACCESS_KEY_ID", "name"),
            ("AWS_SECRET_ACCESS_KEY", "password"),
        ]
    }

    /// The parent folder of the bucket.
    pub fn root(&self) -> &Path {
        self.root.path()
    }

    /// Sets the rule for all further requests.
    ///
    /// # Panics
    /// If an earlier rule panicked.
    pub fn misbehave(&self, rule: impl Fn(&str) -> Fault + Send + 'static) {
        *self.state.rule.lock().expect("whole") = Box::new(rule);
    }

    /// Applies a fault to the first `count` requests that start with `begin`.
    ///
    /// # Panics
    /// As [`S3::misbehave`].
    pub fn misbehave_first(&self, count: usize, begin: &'static str, fault: Fault) {
        let done = AtomicUsize::new(0);
        self.misbehave(move |request| {
            let meant = request.starts_with(begin);
            if meant && done.fetch_add(1, Ordering::Relaxed) < count { fault } else { Fault::None }
        });
    }

    /// Number of requests that start with `begin`.
    ///
    /// # Panics
    /// If a request panicked.
    pub fn count(&self, begin: &str) -> usize {
        let requests = self.state.requests.lock().expect("whole");
        let meant = requests.iter().filter(|request| request.starts_with(begin));
        meant.count()
    }

    /// Largest number of concurrent requests.
    pub fn most_at_once(&self) -> usize {
        self.state.most.load(Ordering::Relaxed)
    }
}

async fn serve(listener: TcpListener, state: Arc<State>) {
    loop {
        let (socket, _) = listener.accept().await.expect("a connection");
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
    let fault = state.rule.lock().expect("whole")(&name);
    state.requests.lock().expect("whole").push(name);
    let now = 1 + state.now.fetch_add(1, Ordering::Relaxed);
    state.most.fetch_max(now, Ordering::Relaxed);
    if let Fault::Late(wait) = fault {
        tokio::time::sleep(wait).await;
    }
    let is_head = request.method() == Method::HEAD;
    let answer = match fault {
        Fault::Status(status) => {
            read_all(request.into_body()).await;
            Ok(refusal(status))
        }
        _ => state.service.call(request.map(Body::from)).await,
    };
    state.now.fetch_sub(1, Ordering::Relaxed);
    let answer = answer.unwrap_or_else(|_: HttpError| refusal(500));
    if is_head { answer } else { spoil(answer, fault) }
}

/// Unread data resets the connection, which may lose the response.
async fn read_all(body: Incoming) {
    let mut body = Body::from(body);
    while let Some(Ok(_)) = body.next().await {}
}

fn refusal(status: u16) -> Response<Body> {
    let mut refusal = Response::new(Body::empty());
    *refusal.status_mut() = StatusCode::from_u16(status).expect("a status");
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

/// A response body with a fault.
struct Spoiled {
    inner: Body,
    /// Bytes before the fault.
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
