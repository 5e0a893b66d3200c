//! The host names of the server.
//!
//! A page of another site can make its own name resolve to this machine (DNS rebinding): the
//! browser then treats its requests as same-origin, and no origin rule stops them. They still carry
//! that name.

use std::net::{Ipv4Addr, Ipv6Addr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, StatusCode, Uri, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::problem::Problem;
use crate::app::App;

/// Refuses requests whose host name is not the server's own.
pub(super) async fn check(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    if !is_named_once(request.version(), request.headers()) {
        return Problem::new(
            StatusCode::BAD_REQUEST,
            "bad_request",
            "An HTTP/1.1 request must have one `Host` header.",
        )
        .into_response();
    }
    if is_known(request.uri(), request.headers(), &app.config.hosts) {
        return next.run(request).await;
    }
    Problem::new(
        StatusCode::MISDIRECTED_REQUEST,
        "unknown_host",
        "The request uses a host name that this server does not have.",
    )
    .hint("Use its address or localhost. Its administrator can allow a name with --host NAME.")
    .into_response()
}

/// Returns whether a request has one host name, as HTTP/1.1 demands (RFC 9112, 3.2).
fn is_named_once(version: Version, headers: &HeaderMap) -> bool {
    let names = headers.get_all(header::HOST).iter().count();
    names == 1 || (names == 0 && version < Version::HTTP_11)
}

/// Returns whether every host name of a request belongs to the server. IP addresses do, since no
/// other site can use one as its name. A request without a host name does not come from a browser.
fn is_known(uri: &Uri, headers: &HeaderMap, hosts: &[String]) -> bool {
    let named = headers.get_all(header::HOST).iter();
    let named = named.map(|value| value.to_str().ok()?.parse::<Authority>().ok());
    named
        .chain(uri.authority().cloned().map(Some))
        .all(|authority| authority.is_some_and(|authority| is_own(authority.host(), hosts)))
}

fn is_own(host: &str, hosts: &[String]) -> bool {
    let host = host.strip_suffix('.').unwrap_or(host);
    let in_brackets = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    host.parse::<Ipv4Addr>().is_ok()
        || in_brackets.is_some_and(|host| host.parse::<Ipv6Addr>().is_ok())
        || host.eq_ignore_ascii_case("localhost")
        || hosts.iter().any(|own| own.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_http_1_0_needs_no_host() {
        let named = |version, names: &[&str]| {
            let mut headers = HeaderMap::new();
            for name in names {
                headers.append(header::HOST, name.parse().expect("header"));
            }
            is_named_once(version, &headers)
        };
        assert!(named(Version::HTTP_11, &["localhost"]));
        assert!(named(Version::HTTP_10, &[]));
        assert!(!named(Version::HTTP_11, &[]));
        assert!(!named(Version::HTTP_11, &["localhost", "127.0.0.1"]));
        assert!(!named(Version::HTTP_10, &["localhost", "127.0.0.1"]));
    }

    #[test]
    fn only_addresses_localhost_and_given_names_are_known() {
        let hosts = ["fled.example.org".to_owned()];
        let known = |host: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().expect("header"));
            is_known(&Uri::from_static("/v1/jobs"), &headers, &hosts)
        };
        for own in [
            "127.0.0.1:8080",
            "192.168.1.7",
            "[::1]:8080",
            "localhost:8080",
            "LocalHost.",
            "fled.example.org",
            "FLED.example.org:443",
        ] {
            assert!(known(own), "{own}");
        }
        for foreign in [
            "evil",
            "evil:8080",
            "127.0.0.1.evil.example",
            "localhost.evil.example",
            "evil.fled.example.org",
            "127.0.0.1@evil",
            "2130706433",
            "",
            "a b",
        ] {
            assert!(!known(foreign), "{foreign}");
        }
        let uri = Uri::from_static("http://evil/v1/jobs");
        assert!(!is_known(&uri, &HeaderMap::new(), &hosts));
    }
}
