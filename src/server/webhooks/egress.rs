//! Outgoing requests to addresses given by users.
//!
//! Users must not reach addresses through the server that they cannot reach themselves: addresses
//! in internal networks are refused after name resolution, and the connection goes to the checked
//! address.

mod address;

use std::fmt::Debug;
use std::time::Duration;

use ureq::config::Config;
use ureq::http::Uri;
use ureq::unversioned::resolver::{DefaultResolver, ResolvedSocketAddrs, Resolver};
use ureq::unversioned::transport::{DefaultConnector, NextTimeout};
use ureq::{Agent, Error};

use self::address::is_outer;

/// Maximum length of a URL, in characters.
const LONGEST: usize = 2000;
/// The reason why an inner address is refused.
pub const INNER: &str = "the name resolves to an address in an internal network";

/// Parses a URL. Checks its form and, unless `inner` is set, that it names no address in an
/// internal network. A name may resolve to such an address later, and is then refused too.
///
/// # Errors
/// A description of what is wrong.
pub fn check_url(url: &str, inner: bool) -> Result<Uri, &'static str> {
    if url.len() > LONGEST {
        return Err("it is longer than 2,000 characters");
    }
    let uri: Uri = url.parse().map_err(|_| "it is not a URL")?;
    if !matches!(uri.scheme_str(), Some("http" | "https")) {
        return Err("it does not start with https:// or http://");
    }
    let authority = uri.authority().ok_or("it has no host")?;
    if authority.as_str().contains('@') {
        return Err("it contains a user name or password");
    }
    if authority.host().is_empty() {
        return Err("it has no host");
    }
    if !inner && is_inner(authority.host()) {
        return Err("it is in an internal network");
    }
    Ok(uri)
}

/// Whether a host is this machine or an address that is not public. A host that ends in a number is
/// an address, in whatever notation (WHATWG URL, 3.5); a public address is only written in four
/// decimal parts.
fn is_inner(host: &str) -> bool {
    let host = host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase();
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    if let Ok(address) = bare.parse() {
        return !is_outer(address);
    }
    let last = host.rsplit('.').next().unwrap_or_default();
    let is_number = |digits: &str, radix| {
        !digits.is_empty() && digits.chars().all(|digit| digit.is_digit(radix))
    };
    let hexadecimal = last.strip_prefix("0x");
    last == "localhost"
        || is_number(last, 10)
        || hexadecimal.is_some_and(|digits| digits.is_empty() || is_number(digits, 16))
}

/// An HTTP agent that allows each request `patience`, and addresses in internal networks if `inner`
/// is set. It does not follow redirects: a new address would need a new check.
pub fn agent(patience: Duration, inner: bool) -> Agent {
    let config = Agent::config_builder()
        .http_status_as_error(false)
        .max_redirects(0)
        .proxy(None)
        .user_agent(concat!("fled/", env!("CARGO_PKG_VERSION")))
        .timeout_global(Some(patience))
        .build();
    Agent::with_parts(config, DefaultConnector::default(), Outer { inner })
}

/// The reason why a request failed.
pub fn reason(error: &Error) -> String {
    match error {
        Error::Other(error) => error.to_string(),
        error => error.to_string(),
    }
}

/// Resolves names as usual and drops addresses in internal networks.
#[derive(Debug)]
struct Outer {
    inner: bool,
}

impl Resolver for Outer {
    fn resolve(
        &self,
        uri: &Uri,
        config: &Config,
        timeout: NextTimeout,
    ) -> Result<ResolvedSocketAddrs, Error> {
        let found = DefaultResolver::default().resolve(uri, config, timeout)?;
        if self.inner {
            return Ok(found);
        }
        let mut outer = self.empty();
        for &address in found.iter().filter(|address| is_outer(address.ip())) {
            outer.push(address);
        }
        if outer.is_empty() {
            return Err(Error::Other(INNER.into()));
        }
        Ok(outer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_plain_web_urls_are_accepted() {
        for good in [
            "https://example.org/hook?a=b",
            "http://example.org:8080/",
            "https://[2606:4700::1]/",
            "https://1.1.1.1/",
            "https://0x.example.org/",
        ] {
            assert!(check_url(good, false).is_ok(), "{good}");
        }
        let long = format!("https://example.org/{}", "a".repeat(LONGEST));
        for bad in [
            "",
            "/hook",
            "example.org",
            "ftp://example.org/",
            "file:///etc/passwd",
            "https://user:secret@example.org/",
            "https://",
            "not a url",
            &long,
        ] {
            assert!(check_url(bad, true).is_err(), "{bad}");
        }
    }

    #[test]
    fn inner_networks_are_refused_in_every_notation() {
        let inner = [
            "http://localhost:1/",
            "http://127.0.0.1:1/",
            "http://[::1]:1/",
            "http://0.0.0.0:1/",
            "http://2130706433:1/",
            "http://0x7f.1:1/",
            "http://[::ffff:127.0.0.1]:1/",
            "http://169.254.169.254/latest",
        ];
        // Not every resolver knows these.
        for url in ["http://hook.localhost/", "http://127.0.0.1./", "http://a.0X7F/"] {
            assert!(check_url(url, false).is_err(), "{url}");
        }
        let agent = agent(Duration::from_secs(5), false);
        for url in inner {
            assert!(check_url(url, false).is_err() && check_url(url, true).is_ok(), "{url}");
            let error = agent.get(url).call().expect_err(url);
            assert_eq!(reason(&error), INNER, "{url}");
        }
    }
}
