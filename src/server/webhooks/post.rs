//! One attempt to tell an address.

use std::fmt::Debug;
use std::time::Duration;

use tokio::sync::oneshot;
use ureq::config::Config;
use ureq::http::Uri;
use ureq::unversioned::resolver::{DefaultResolver, ResolvedSocketAddrs, Resolver};
use ureq::unversioned::transport::{DefaultConnector, NextTimeout};
use ureq::{Agent, Error};

use super::address::is_outer;
use super::sign::Signed;

/// How long an address may take to answer.
const PATIENCE: Duration = Duration::from_secs(15);
/// Longest address.
const LONGEST: usize = 2000;
/// What an inner address is refused with.
const INNER: &str = "the name stands for an address of an inner network";

/// Whether an address is one that can be told anything, by its looks.
///
/// # Errors
/// What is wrong with it.
pub fn check_url(url: &str) -> Result<(), &'static str> {
    if url.len() > LONGEST {
        return Err("it is longer than 2,000 characters");
    }
    let uri: Uri = url.parse().map_err(|_| "it is no URL")?;
    if !matches!(uri.scheme_str(), Some("http" | "https")) {
        return Err("it begins with neither https:// nor http://");
    }
    let authority = uri.authority().ok_or("it names no host")?;
    if authority.as_str().contains('@') {
        return Err("it holds a user's name or password");
    }
    if authority.host().is_empty() {
        return Err("it names no host");
    }
    Ok(())
}

/// Sends a delivery; the status of the answer, or why there is none. `inner`: whether addresses of
/// inner networks are told, too.
pub(super) async fn post(
    url: String,
    signed: Signed,
    body: String,
    inner: bool,
) -> Result<u16, String> {
    let (sender, receiver) = oneshot::channel();
    // A thread of its own: one that waits for a slow address keeps no server from stopping.
    let send = move || {
        // Nobody listens any more where the server stops.
        let _ = sender.send(send(&url, &signed, &body, inner));
    };
    let thread = std::thread::Builder::new().name("webhook".to_owned());
    thread.spawn(send).map_err(|error| error.to_string())?;
    receiver
        .await
        .map_err(|_| "the attempt was lost".to_owned())?
}

fn send(url: &str, signed: &Signed, body: &str, inner: bool) -> Result<u16, String> {
    let config = Agent::config_builder()
        .timeout_global(Some(PATIENCE))
        .http_status_as_error(false)
        // Another address would be another question to ask.
        .max_redirects(0)
        .proxy(None)
        .user_agent(concat!("fled/", env!("CARGO_PKG_VERSION")))
        .build();
    let agent = Agent::with_parts(config, DefaultConnector::default(), Outer { inner });
    let answer = agent
        .post(url)
        .header("content-type", "application/json")
        .header("webhook-id", &signed.id)
        .header("webhook-timestamp", signed.timestamp.to_string())
        .header("webhook-signature", &signed.signature)
        .send(body);
    answer
        .map(|answer| answer.status().as_u16())
        .map_err(|error| match error {
            Error::Other(error) => error.to_string(),
            error => error.to_string(),
        })
}

/// Finds addresses as everybody does, and leaves out those of inner networks: what is connected to
/// is what was looked at.
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
    fn only_plain_addresses_of_the_web_are_taken() {
        for good in [
            "https://example.org/hook?a=b",
            "http://example.org:8080/",
            "https://[2606:4700::1]/",
        ] {
            assert_eq!(check_url(good), Ok(()), "{good}");
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
            assert!(check_url(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn names_and_numbers_of_inner_networks_are_refused_however_they_are_written() {
        let signed = || Signed::new(&[0; 32], "msg_1", 1, "{}");
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
        for url in inner {
            let reason = send(url, &signed(), "{}", false).expect_err(url);
            assert_eq!(reason, INNER, "{url}");
        }
    }
}
