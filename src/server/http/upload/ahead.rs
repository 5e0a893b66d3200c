//! How far the reader of a body is ahead of those who take its parts.
//!
//! The parser keeps what it has read until it finds the end of a part's header. A body that never
//! has one would be kept whole.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use axum::body::Body;
use futures::StreamExt;

/// Most bytes that the parser may hold; a header has some hundred.
const FARTHEST: usize = 4 << 20;

/// Bytes read of a body and not yet taken.
#[derive(Debug, Default)]
pub(super) struct Ahead(AtomicUsize);

impl Ahead {
    /// The body, which fails once too much of it is held.
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

    /// So many bytes of a part were taken.
    pub(super) fn taken(&self, bytes: usize) {
        // What was held when a part began is not counted: then more is taken than was counted.
        let less = |held: usize| Some(held.saturating_sub(bytes));
        let _ = self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
    }

    /// A part's header was found: what is held belongs to parts.
    pub(super) fn caught_up(&self) {
        self.0.store(0, Ordering::Relaxed);
    }
}
