//! Blobs of a service that alone knows where they lie, and is asked for them by HTTP:
//! `GET`, `HEAD` and `PUT <address>/<digest>`.
//!
//! Answers say `Content-Length`, and in [`AGE`] how long ago the blob was written: no clock but
//! the service's counts. It compares what it is sent with the digest.

use std::fmt;
use std::io;
use std::ops::Range;
use std::time::{Duration, Instant, SystemTime};

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::{self, BoxStream};
use futures::{StreamExt, TryStreamExt};
use object_store::path::Path as Key;
use object_store::{
    Attributes, CopyOptions, Error, GetOptions, GetResult, GetResultPayload, ListResult,
    MultipartUpload, ObjectMeta, ObjectStore, PutMultipartOptions, PutOptions, PutPayload,
    PutResult, Result, UploadPart,
};
use reqwest::{Body, Client, RequestBuilder, Response, StatusCode};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;

/// The header that says how many seconds ago a blob was written.
pub const AGE: &str = "fled-age";

/// Wait before a request is made again; before each other one twice as long as before the last.
const WAIT: Duration = Duration::from_millis(200);

/// Longest wait.
const LONGEST_WAIT: Duration = Duration::from_secs(4);

/// A blob that is sent piece by piece has to be there after so long: at 1 MiB a second 14 GiB.
const LONGEST: Duration = Duration::from_secs(4 * 3600);

/// Characters that are kept of what is answered to a request that is refused.
const WORDS: usize = 500;

/// The service.
#[derive(Clone, Debug)]
pub(crate) struct Service {
    /// For what is answered soon.
    pub brisk: Client,
    /// For what is sent for as long as it takes: it minds no silence.
    pub patient: Client,
    /// What stands before `/<digest>`.
    pub address: String,
    /// Requests that fail are made again for so long.
    pub patience: Duration,
}

impl fmt::Display for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.address)
    }
}

impl Service {
    fn url(&self, key: &Key) -> String {
        let digest = key.filename().unwrap_or_default();
        format!("{}/{digest}", self.address)
    }

    /// An answer that says yes. What fails by the network, or by a service that is not well, is
    /// asked again.
    async fn ask(
        &self,
        key: &Key,
        request: impl Fn() -> RequestBuilder + Send,
    ) -> Result<Response> {
        let (begun, mut wait) = (Instant::now(), WAIT);
        loop {
            let error = match request().send().await {
                Ok(answer) if answer.status().is_success() => return Ok(answer),
                Ok(answer) if may_pass(answer.status()) => refused(key, answer).await,
                Ok(answer) => return Err(refused(key, answer).await),
                Err(error) => generic(error),
            };
            if begun.elapsed() + wait > self.patience {
                return Err(error);
            }
            tracing::info!(%error, "a blob is asked for again");
            tokio::time::sleep(wait).await;
            wait = (2 * wait).min(LONGEST_WAIT);
        }
    }
}

fn may_pass(status: StatusCode) -> bool {
    let later = [StatusCode::TOO_MANY_REQUESTS, StatusCode::REQUEST_TIMEOUT];
    // A full disk does not become empty within a minute.
    (status.is_server_error() && status != StatusCode::INSUFFICIENT_STORAGE)
        || later.contains(&status)
}

async fn refused(key: &Key, answer: Response) -> Error {
    let status = answer.status();
    let text = answer.text().await.unwrap_or_default();
    let words: String = text.chars().take(WORDS).collect();
    let source = format!("it answered {status}: {words}").into();
    if status == StatusCode::NOT_FOUND {
        let path = key.to_string();
        return Error::NotFound { path, source };
    }
    generic(source)
}

fn generic(source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Error {
    let (store, source) = ("service", source.into());
    Error::Generic { store, source }
}

/// What only the service itself does with blobs.
fn not_by_http(what: &str) -> Error {
    let source = format!("{what} is done by the service itself").into();
    Error::NotSupported { source }
}

fn put() -> PutResult {
    PutResult {
        e_tag: None,
        version: None,
        extensions: Default::default(),
    }
}

#[async_trait]
impl ObjectStore for Service {
    async fn put_opts(&self, key: &Key, payload: PutPayload, _: PutOptions) -> Result<PutResult> {
        let (url, bytes) = (self.url(key), Bytes::from(payload));
        self.ask(key, || self.brisk.put(&url).body(bytes.clone()))
            .await
            .map(|_| put())
    }

    async fn put_multipart_opts(
        &self,
        key: &Key,
        _: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        let (parts, coming) = mpsc::unbounded_channel();
        let body = Body::wrap_stream(stream::unfold(coming, next_part));
        let request = self.patient.put(self.url(key)).timeout(LONGEST).body(body);
        let (mut answer, key) = (JoinSet::new(), key.clone());
        answer.spawn(async move {
            match request.send().await {
                Ok(answer) if answer.status().is_success() => Ok(()),
                Ok(answer) => Err(refused(&key, answer).await),
                Err(error) => Err(generic(error)),
            }
        });
        let parts = Some(parts);
        Ok(Box::new(Upload { parts, answer }))
    }

    async fn get_opts(&self, key: &Key, options: GetOptions) -> Result<GetResult> {
        let url = self.url(key);
        let request = || match options.head {
            true => self.brisk.head(&url),
            false => self.brisk.get(&url),
        };
        let answer = self.ask(key, request).await?;
        let size = number(&answer, "content-length")?;
        let age = Duration::from_secs(number(&answer, AGE)?);
        let written = SystemTime::now().checked_sub(age);
        let range: Range<u64> = 0..size;
        Ok(GetResult {
            payload: GetResultPayload::Stream(answer.bytes_stream().map_err(generic).boxed()),
            meta: ObjectMeta {
                location: key.clone(),
                last_modified: written.unwrap_or(SystemTime::UNIX_EPOCH).into(),
                size,
                e_tag: None,
                version: None,
            },
            range,
            attributes: Attributes::default(),
            extensions: Default::default(),
        })
    }

    fn delete_stream(&self, _: BoxStream<'static, Result<Key>>) -> BoxStream<'static, Result<Key>> {
        stream::once(async { Err(not_by_http("deleting")) }).boxed()
    }

    fn list(&self, _: Option<&Key>) -> BoxStream<'static, Result<ObjectMeta>> {
        stream::once(async { Err(not_by_http("listing")) }).boxed()
    }

    async fn list_with_delimiter(&self, _: Option<&Key>) -> Result<ListResult> {
        Err(not_by_http("listing"))
    }

    async fn copy_opts(&self, _: &Key, _: &Key, _: CopyOptions) -> Result<()> {
        Err(not_by_http("copying"))
    }
}

fn number(answer: &Response, header: &str) -> Result<u64> {
    let text = answer.headers().get(header);
    let number = text.and_then(|text| text.to_str().ok()?.parse().ok());
    number.ok_or_else(|| generic(format!("its answer has no number as {header}")))
}

/// A piece on its way, and whom to tell when it has left.
type Part = (Bytes, oneshot::Sender<()>);

async fn next_part(
    mut coming: mpsc::UnboundedReceiver<Part>,
) -> Option<(io::Result<Bytes>, mpsc::UnboundedReceiver<Part>)> {
    let (bytes, left) = coming.recv().await?;
    // Nobody waits for a part of an upload that is given up.
    let _ = left.send(());
    Some((Ok(bytes), coming))
}

/// Parts that become the body of one request, in their order.
#[derive(Debug)]
struct Upload {
    /// `None` once the last was sent.
    parts: Option<mpsc::UnboundedSender<Part>>,
    /// Dropped, it cuts the request: the service then keeps nothing.
    answer: JoinSet<Result<()>>,
}

impl Upload {
    /// What the service answered.
    async fn answered(&mut self) -> Result<()> {
        match self.answer.join_next().await {
            Some(Ok(answered)) => answered,
            Some(Err(error)) => Err(generic(error)),
            None => Err(generic("the upload is over")),
        }
    }
}

#[async_trait]
impl MultipartUpload for Upload {
    fn put_part(&mut self, part: PutPayload) -> UploadPart {
        let (tell, left) = oneshot::channel();
        let parts = self.parts.as_ref();
        let sent = parts.is_some_and(|parts| parts.send((part.into(), tell)).is_ok());
        Box::pin(async move {
            // Why is said when the upload is completed.
            let lost = || generic("the transfer broke off");
            if !sent {
                return Err(lost());
            }
            left.await.map_err(|_| lost())
        })
    }

    async fn complete(&mut self) -> Result<PutResult> {
        self.parts = None;
        self.answered().await.map(|()| put())
    }

    async fn abort(&mut self) -> Result<()> {
        self.answer.shutdown().await;
        Ok(())
    }
}
