//! Limits how far the body reader is ahead of the consumer of its parts.
//!
//! The parser buffers data until it finds the end of a part's header. A body without one would be
//! buffered whole.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use axum::body::Body;
use futures::StreamExt;

/// Maximum bytes that the parser may buffer; a header has some hundred.
const FARTHEST: usize = 4 << 20;

/// Bytes read from a body and not yet consumed.
#[derive(Debug, Default)]
pub(super) struct Ahead(AtomicUsize);

impl Ahead {
    /// Wraps the body, which fails if too much of it is buffered.
    pub(super) fn watch(self: Arc<Self>, body: Body) -> Body {
        let stream = body.into_data_stream().map(move |chunk| {
            let chunk = chunk.map_err(io::Error::other)?;
            let held = self.0.fetch_add(chunk.len(), Ordering::Relaxed) + chunk.len();
            if held > FARTHEST {
                return Err(io::Error::other("a part's header is too long or does not end"));
            }
            Ok(chunk)
        });
        Body::from_stream(stream)
    }

    /// Records that this many bytes of a part were consumed.
    pub(super) fn taken(&self, bytes: usize) {
        // Bytes buffered when a part began are not counted, so more may be consumed than was
        // counted.
        let less = |held: usize| Some(held.saturating_sub(bytes));
        let _ = self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
    }

    /// Records that a part's header was found: the buffered bytes belong to parts.
    pub(super) fn caught_up(&self) {
        self.0.store(0, Ordering::Relaxed);
    }
}
