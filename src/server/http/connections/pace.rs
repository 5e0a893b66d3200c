//! Bodies and answers with a minimum pace.

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::Bytes;
use hyper::body::{Body, Frame, Incoming, SizeHint};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::runtime::Handle;
use tokio::time::{Sleep, sleep, timeout};

/// Bytes of a body that must arrive within the stall time: no client sends photographs at less
/// than 1 KiB a second over 30 seconds.
const LEAST: usize = 30 << 10;

/// Maximum bytes read of an unwanted body. Many clients read no answer before they have sent
/// everything; closing the connection earlier would lose the answer.
const DRAINED: usize = 64 << 20;
/// Maximum time spent reading an unwanted body.
const DRAINING: Duration = Duration::from_secs(5);

/// A request body whose sender must keep a minimum pace. If dropped before its end, the rest is
/// read and discarded, within bounds.
pub(super) struct PacedBody {
    /// `None` at its end, or after a timeout.
    body: Option<Incoming>,
    stall: Duration,
    /// Whether the sender waits for `100 Continue`.
    is_held_back: bool,
    /// Runs while waiting for the sender, until it has sent enough.
    timer: Option<Pin<Box<Sleep>>>,
    since: usize,
}

impl PacedBody {
    /// Fails if less than [`LEAST`] arrives within `stall`. A body that is held back is sent only
    /// when it is polled.
    pub(super) fn new(body: Incoming, stall: Duration, is_held_back: bool) -> Self {
        Self { body: Some(body), stall, is_held_back, timer: None, since: 0 }
    }
}

impl Body for PacedBody {
    type Data = Bytes;
    type Error = axum::BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::BoxError>>> {
        self.is_held_back = false;
        let Some(body) = &mut self.body else {
            return Poll::Ready(None);
        };
        match Pin::new(body).poll_frame(context) {
            Poll::Ready(frame) => {
                if let Some(Ok(frame)) = &frame {
                    self.since += frame.data_ref().map_or(0, Bytes::len);
                    if self.since >= LEAST {
                        (self.since, self.timer) = (0, None);
                    }
                } else {
                    self.body = None;
                }
                Poll::Ready(frame.map(|frame| frame.map_err(Into::into)))
            }
            Poll::Pending => {
                let stall = self.stall;
                let timer = self.timer.get_or_insert_with(|| Box::pin(sleep(stall)));
                ready!(timer.as_mut().poll(context));
                self.body = None;
                let error = io::Error::new(io::ErrorKind::TimedOut, "the body arrives too slowly");
                Poll::Ready(Some(Err(error.into())))
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.as_ref().is_none_or(Body::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        let body = self.body.as_ref();
        body.map_or_else(|| SizeHint::with_exact(0), Body::size_hint)
    }
}

impl Drop for PacedBody {
    fn drop(&mut self) {
        let Some(body) = self.body.take() else { return };
        if self.is_held_back || body.is_end_stream() {
            return;
        }
        // Without a runtime the server has stopped, and its connections are closed.
        if let Ok(runtime) = Handle::try_current() {
            runtime.spawn(timeout(DRAINING, drain(body)));
        }
    }
}

/// Discards the rest of a body, within [`DRAINED`].
async fn drain(mut body: Incoming) {
    let mut left = DRAINED;
    while let Some(Ok(frame)) = poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await {
        left = left.saturating_sub(frame.data_ref().map_or(0, Bytes::len));
        if left == 0 {
            break;
        }
    }
}

/// A connection whose reader must keep a minimum pace.
pub(super) struct PacedStream {
    stream: TcpStream,
    stall: Duration,
    /// Runs while waiting for the reader.
    timer: Option<Pin<Box<Sleep>>>,
}

impl PacedStream {
    /// Fails if the reader takes nothing within `stall`.
    pub(super) fn new(stream: TcpStream, stall: Duration) -> Self {
        Self { stream, stall, timer: None }
    }

    fn paced<T>(
        &mut self,
        context: &mut Context<'_>,
        outcome: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if outcome.is_ready() {
            self.timer = None;
            return outcome;
        }
        let stall = self.stall;
        let timer = self.timer.get_or_insert_with(|| Box::pin(sleep(stall)));
        ready!(timer.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for PacedStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for PacedStream {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.paced(context, outcome)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.paced(context, outcome)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
