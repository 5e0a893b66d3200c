//! Extractors whose rejections are problem documents.

use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::StatusCode;
use axum::http::header::{self, HeaderMap};
use axum::http::request::Parts;
use fled_core::reading::{Fault, below, read, read_pairs};
use serde::de::DeserializeOwned;
use serde_json::Value;
use serde_json::error::Category;

use super::problem::{Problem, too_large};
use super::texts::{check_text, check_value};

/// A JSON body.
#[derive(Debug)]
pub struct Json<T>(pub T);

/// The query string.
#[derive(Debug)]
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Json<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        if !is_json(request.headers()) {
            return Err(Problem::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "unsupported_media_type",
                "The body is not JSON.",
            )
            .hint("Send it with `Content-Type: application/json`."));
        }
        let body = Bytes::from_request(request, state).await;
        let body = body.map_err(|rejection| match rejection.status() {
            StatusCode::PAYLOAD_TOO_LARGE => too_large("The JSON body is too large."),
            _ => bad_request("The body was interrupted."),
        })?;
        let body = parsed(&body).map_err(|words| bad_request(format!("The body {words}.")))?;
        check_value(&body, "")?;
        typed(body).map(Self)
    }
}

/// Returns whether the content type is JSON.
pub fn is_json(headers: &HeaderMap) -> bool {
    is_of_type(headers, "application/json")
}

/// Returns whether the body has this media type, ignoring case.
pub fn is_of_type(headers: &HeaderMap, media_type: &str) -> bool {
    let value = headers.get(header::CONTENT_TYPE);
    let kind =
        value.and_then(|value| value.to_str().ok()).and_then(|value| value.split(';').next());
    kind.is_some_and(|kind| kind.trim().eq_ignore_ascii_case(media_type))
}

/// Parses JSON, or describes the error as the rest of a sentence.
pub fn parsed(text: &[u8]) -> Result<Value, String> {
    serde_json::from_slice(text).map_err(|error| match error.classify() {
        Category::Eof => "is not JSON: it ends too early".to_owned(),
        _ => {
            let (line, column) = (error.line(), error.column());
            format!("is not JSON: see line {line}, column {column}")
        }
    })
}

/// Reads a JSON body.
///
/// # Errors
/// 422 if it does not match the type.
pub fn typed<T: DeserializeOwned>(body: Value) -> Result<T, Problem> {
    read(body).map_err(|fault| unfit(&fault, "The body"))
}

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Query<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let pairs = axum::extract::Query::<Vec<(String, String)>>::from_request_parts(parts, state);
        let axum::extract::Query(pairs) =
            pairs.await.map_err(|_| bad_request("The query cannot be read."))?;
        for (key, text) in &pairs {
            let pointer = below(key, "");
            check_text(key, &pointer)?;
            check_text(text, &pointer)?;
        }
        let query = read_pairs(pairs).map_err(|fault| unfit(&fault, "The query"))?;
        Ok(Self(query))
    }
}

fn bad_request(detail: impl Into<String>) -> Problem {
    Problem::new(StatusCode::BAD_REQUEST, "bad_request", detail)
}

fn unfit(fault: &Fault, whole: &str) -> Problem {
    let hint = "See /openapi.yaml for what the server reads.";
    match fault.pointer.as_str() {
        "" => Problem::unprocessable("bad_input", format!("{whole} {}.", fault.words)).hint(hint),
        pointer => {
            Problem::unprocessable("bad_input", format!("{fault}.")).pointer(pointer).hint(hint)
        }
    }
}
