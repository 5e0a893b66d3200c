//! Errors as RFC 9457 problem documents with a stable code and a hint.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

use crate::error::ServerError;

// Boxed where possible, because it is the error of every handler.
/// Why a request failed.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Problem {
    /// Always `about:blank`; see `code`.
    #[serde(rename = "type")]
    kind: &'static str,
    /// Name of the status.
    title: &'static str,
    /// HTTP status.
    status: u16,
    /// Stable name of the problem in snake_case.
    code: &'static str,
    /// What went wrong, in one sentence.
    #[schema(value_type = String)]
    detail: Box<str>,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    hint: Option<Box<str>>,
    /// JSON pointer to the invalid part of the request.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pointer: Option<Box<str>>,
    /// Assessments of the uploaded files, if an upload was refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>)]
    capture: Option<Box<Value>>,
    /// The header `Retry-After`, seconds.
    #[serde(skip)]
    retry_after: Option<u32>,
}

impl Problem {
    /// A problem with this status, code and detail.
    pub fn new(status: StatusCode, code: &'static str, detail: impl Into<String>) -> Self {
        Self {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Error"),
            status: status.as_u16(),
            code,
            detail: detail.into().into(),
            hint: None,
            pointer: None,
            capture: None,
            retry_after: None,
        }
    }

    /// Sets a hint for the client.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into().into());
        self
    }

    /// Sets the JSON pointer to the part of the request at fault.
    #[must_use]
    pub fn pointer(mut self, pointer: impl Into<String>) -> Self {
        self.pointer = Some(pointer.into().into());
        self
    }

    /// Sets the seconds after which a retry may succeed.
    #[must_use]
    pub fn retry_after(mut self, seconds: u32) -> Self {
        self.retry_after = Some(seconds);
        self
    }

    /// Adds the assessments of an upload.
    #[must_use]
    pub fn capture(mut self, capture: Value) -> Self {
        self.capture = Some(Box::new(capture));
        self
    }

    /// 404: it does not exist.
    pub fn not_found(what: &str) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not_found", format!("No such {what} exists."))
    }

    /// 409: not allowed in this state.
    pub fn conflict(code: &'static str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, code, detail)
    }

    /// 422: understood, but not usable.
    pub fn unprocessable(code: &'static str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, code, detail)
    }

    /// 500: an internal error; only the log contains the details.
    pub fn internal() -> Self {
        Self::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "internal",
            "The server failed. Its log has the details.",
        )
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let retry_after = self.retry_after;
        let mut response = (status, Json(self)).into_response();
        if let Some(seconds) = retry_after {
            response.headers_mut().insert(header::RETRY_AFTER, seconds.into());
        }
        if status == StatusCode::UNAUTHORIZED {
            // How to authenticate.
            let challenge = HeaderValue::from_static("Bearer realm=\"fled\"");
            response.headers_mut().insert(header::WWW_AUTHENTICATE, challenge);
        }
        let media_type = HeaderValue::from_static("application/problem+json");
        response.headers_mut().insert(header::CONTENT_TYPE, media_type);
        response
    }
}

impl From<ServerError> for Problem {
    fn from(error: ServerError) -> Self {
        tracing::error!(%error, "a request failed");
        let full = matches!(
            &error,
            ServerError::Io { source, .. } if source.kind() == std::io::ErrorKind::StorageFull
        );
        if full {
            disk_full()
        } else if error.passes() || error.is_of_the_store() {
            away()
        } else {
            Self::internal()
        }
    }
}

/// 413: more than the limit.
pub fn too_large(detail: &str) -> Problem {
    Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", detail)
}

/// 503: the shared database or blob store does not answer.
fn away() -> Problem {
    Problem::new(
        StatusCode::SERVICE_UNAVAILABLE,
        "unavailable",
        "The server's database or file store does not respond.",
    )
    .hint("Try again in a few seconds. /readyz shows what is missing.")
    .retry_after(5)
}

/// 507: the disk is (nearly) full.
pub fn disk_full() -> Problem {
    Problem::new(StatusCode::INSUFFICIENT_STORAGE, "disk_full", "The server's disk is full.")
        .hint("Delete captures and jobs that are no longer needed, or give the data directory more space.")
}
