//! A file as a response: whole, as a range, or as 304 if the client has it.

use std::io::{ErrorKind, SeekFrom};
use std::path::PathBuf;

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, IntoResponseParts, Response};
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio_util::io::ReaderStream;

use super::problem::Problem;
use super::range::{Wanted, wanted};
use crate::error::ServerError;

/// A file to send.
pub(super) struct Sent {
    /// Its path.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Quoted; changes with the content.
    pub etag: String,
    /// Its media type.
    pub media_type: &'static str,
}

impl Sent {
    /// Answers a request with these headers.
    pub(super) async fn answer(&self, headers: &HeaderMap) -> Result<Response, Problem> {
        let common = [
            (header::ETAG, self.etag.clone()),
            (header::ACCEPT_RANGES, "bytes".to_owned()),
            (header::CONTENT_TYPE, self.media_type.to_owned()),
            // A file of a job must not run as a page of this site.
            (header::CONTENT_SECURITY_POLICY, "default-src 'none'; sandbox".to_owned()),
        ];
        if is_known(headers, &self.etag) {
            return Ok((StatusCode::NOT_MODIFIED, common).into_response());
        }
        let (start, length) = match wanted(headers, self.bytes, &self.etag) {
            Wanted::All => (0, self.bytes),
            Wanted::Part { start, length } => (start, length),
            Wanted::Impossible => {
                let problem = Problem::new(
                    StatusCode::RANGE_NOT_SATISFIABLE,
                    "bad_range",
                    "The range begins beyond the end.",
                );
                return Ok(([(header::CONTENT_RANGE, format!("bytes */{}", self.bytes))], problem)
                    .into_response());
            }
        };
        self.send(start, length, common).await
    }

    /// Sends `length` bytes starting at `start`.
    async fn send(
        &self,
        start: u64,
        length: u64,
        headers: impl IntoResponseParts,
    ) -> Result<Response, Problem> {
        let mut source = tokio::fs::File::open(&self.path).await.map_err(|error| {
            if error.kind() == ErrorKind::NotFound {
                // Deleted meanwhile, or lost: log which file.
                tracing::warn!(path = %self.path.display(), "a file to send is missing");
                return Problem::not_found("file");
            }
            ServerError::io(&self.path)(error).into()
        })?;
        source.seek(SeekFrom::Start(start)).await.map_err(ServerError::io(&self.path))?;
        let body = Body::from_stream(ReaderStream::with_capacity(source.take(length), 1 << 16));
        let whole = length == self.bytes;
        let status = if whole { StatusCode::OK } else { StatusCode::PARTIAL_CONTENT };
        let length_header = [(header::CONTENT_LENGTH, length.to_string())];
        let mut response = (status, headers, length_header, body).into_response();
        if !whole {
            let range = format!("bytes {start}-{}/{}", start + length - 1, self.bytes);
            response
                .headers_mut()
                .insert(header::CONTENT_RANGE, range.parse().map_err(|_| Problem::internal())?);
        }
        Ok(response)
    }
}

/// Returns whether the client already has this content, by a weak comparison.
pub(super) fn is_known(headers: &HeaderMap, etag: &str) -> bool {
    let strong = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok()).is_some_and(|tags| {
        tags.split(',').map(strong).any(|tag| tag == strong(etag) || tag == "*")
    })
}
