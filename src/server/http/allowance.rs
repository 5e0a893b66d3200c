//! Rate limit headers of an answer, and 429 if the limit is exceeded.
//!
//! Implements draft-ietf-httpapi-ratelimit-headers-10.

use std::num::NonZeroU32;
use std::time::Duration;

use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse, Response};

use super::paths;
use super::problem::Problem;
use crate::rate::{Allowance, PIECE, READ, WRITE};

const POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");
const LIMIT: HeaderName = HeaderName::from_static("ratelimit");

/// The cost of a request.
pub(super) fn cost(path: Option<&str>, method: &Method) -> NonZeroU32 {
    match path {
        _ if is_reading(method) => READ,
        Some(paths::UPLOADS | paths::UPLOAD) => PIECE,
        _ => WRITE,
    }
}

/// Returns whether a method is read-only.
pub(super) fn is_reading(method: &Method) -> bool {
    matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS)
}

/// Adds the remaining allowance to the headers of an answer.
pub(super) fn tell(allowance: &Allowance, headers: &mut HeaderMap) {
    let (most, window) = (allowance.most, seconds(allowance.window));
    let (left, whole_in) = (allowance.left, seconds(allowance.whole_in));
    let fields = [
        (POLICY, format!("\"client\";q={most};w={window}")),
        (LIMIT, format!("\"client\";r={left};t={whole_in}")),
    ];
    for (name, value) in fields {
        if let Ok(value) = HeaderValue::try_from(value) {
            headers.insert(name, value);
        }
    }
}

/// 429: retry after `wait`.
pub(super) fn used_up(wait: Duration) -> Response {
    Problem::new(
        StatusCode::TOO_MANY_REQUESTS,
        "too_many_requests",
        "Too many requests in a short time.",
    )
    .hint("Wait as long as `Retry-After` says. `RateLimit` in every response shows what is left.")
    .retry_after(seconds(wait))
    .into_response()
}

/// Whole seconds, rounded up.
fn seconds(time: Duration) -> u32 {
    time.as_secs_f64().ceil() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remaining_allowance_is_reported_in_whole_seconds() {
        let allowance = Allowance {
            most: 1000,
            left: 7,
            whole_in: Duration::from_millis(19_860),
            window: Duration::from_secs(20),
            wait: None,
        };
        let mut headers = HeaderMap::new();
        tell(&allowance, &mut headers);
        assert_eq!(headers["ratelimit-policy"], "\"client\";q=1000;w=20");
        assert_eq!(headers["ratelimit"], "\"client\";r=7;t=20");
        let refused = used_up(Duration::from_millis(40));
        assert_eq!(refused.status(), StatusCode::TOO_MANY_REQUESTS);
        assert_eq!(refused.headers()["retry-after"], "1");
        let job = Some("/v1/jobs/{id}");
        assert!(cost(job, &Method::DELETE) > cost(job, &Method::HEAD));
        let piece = cost(Some(paths::UPLOAD), &Method::PATCH);
        assert!(piece > READ && piece < WRITE, "{piece}");
    }
}
