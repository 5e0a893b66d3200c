//! Addresses that hold below the path of a proxy.
//!
//! A proxy that serves fled at `/fled/` removes that path before a request arrives, so the server
//! does not know it. Therefore every address in an answer is relative to that of its request, as
//! RFC 9110 allows for `Location` (10.2.2). The pages use relative addresses for the same reason.

use axum::extract::Request;
use axum::http::{HeaderValue, header};
use axum::middleware::Next;
use axum::response::Response;

/// Makes the `Location` of an answer relative.
pub(super) async fn relate(request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let mut answer = next.run(request).await;
    let location = answer.headers().get(header::LOCATION).and_then(|value| value.to_str().ok());
    let relative = location.and_then(|location| relative(&path, location));
    if let Some(Ok(relative)) = relative.map(HeaderValue::try_from) {
        answer.headers_mut().insert(header::LOCATION, relative);
    }
    answer
}

/// The absolute path `to` as seen from the path `from`; `None` if it is not absolute.
fn relative(from: &str, to: &str) -> Option<String> {
    let to = to.strip_prefix('/')?;
    let from = from.strip_prefix('/')?;
    let (folder, _) = from.rsplit_once('/').unwrap_or_default();
    if folder.is_empty() {
        return Some(format!("./{to}"));
    }
    let beside = to.strip_prefix(folder).and_then(|rest| rest.strip_prefix('/'));
    Some(beside.map_or_else(|| format!("{}{to}", top(&format!("/{from}"))), str::to_owned))
}

/// The server's own top as seen from this path: `./`, or `../` once for each folder.
pub(super) fn top(path: &str) -> String {
    match path.matches('/').count() {
        0 | 1 => "./".to_owned(),
        slashes => "../".repeat(slashes - 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_seen_from_the_request() {
        let seen = |from: &str, to: &str| relative(from, to).unwrap_or_default();
        assert_eq!(seen("/v1/jobs", "/v1/jobs/7"), "jobs/7");
        assert_eq!(seen("/v1/jobs/7/videos", "/v1/jobs/7/videos/1"), "videos/1");
        assert_eq!(seen("/v1/captures/sample", "/v1/captures/7"), "7");
        assert_eq!(seen("/docs", "/#/api"), "./#/api");
        assert_eq!(seen("/v1/jobs/7/retry", "/v1/captures/1"), "../../../v1/captures/1");
        assert_eq!(seen("/v1/jobs", "../jobs/7"), "", "relative already");
    }

    #[test]
    fn the_top_is_as_far_as_the_path_is_deep() {
        assert_eq!([top("/"), top("/a"), top("/a/"), top("/a/b/c")], ["./", "./", "../", "../../"]);
    }
}
