//! Servers by scheme, name and port.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

use ureq::http::Uri;

use super::check_url;

/// A server that captures may be fetched from: `https://photographs.example.org`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    scheme: String,
    host: String,
    port: u16,
}

impl Origin {
    /// The server of an address that [`check_url`] has taken.
    pub fn of(uri: &Uri) -> Option<Self> {
        let scheme = uri.scheme_str()?.to_ascii_lowercase();
        let usual = if scheme == "https" { 443 } else { 80 };
        Some(Self {
            host: uri.host()?.to_ascii_lowercase(),
            port: uri.port_u16().unwrap_or(usual),
            scheme,
        })
    }

    /// Whether it is named by its address, so that no name can come to stand for another.
    pub fn is_address(&self) -> bool {
        let host = self.host.trim_start_matches('[').trim_end_matches(']');
        host.parse::<IpAddr>().is_ok()
    }
}

impl FromStr for Origin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let uri = check_url(text)?;
        let has_more = uri
            .path_and_query()
            .is_some_and(|path| path.as_str() != "/");
        if has_more || text.contains('#') {
            return Err("a server is named without a path, as https://example.org".to_owned());
        }
        Self::of(&uri).ok_or_else(|| "it names no host".to_owned())
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}://{}:{}", self.scheme, self.host, self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn origin(text: &str) -> Origin {
        text.parse().expect(text)
    }

    #[test]
    fn a_server_is_its_scheme_its_name_and_its_port() {
        let server = origin("https://Example.org");
        for same in ["https://example.org:443/", "HTTPS://EXAMPLE.ORG"] {
            assert_eq!(origin(same), server, "{same}");
        }
        for other in [
            "http://example.org",
            "https://example.org:8443",
            "https://example.org.evil.test",
            "https://a.example.org",
            "https://example.org.",
        ] {
            assert_ne!(origin(other), server, "{other}");
        }
        for bad in [
            "example.org",
            "https://example.org/captures",
            "https://example.org/?a",
            "ftp://a",
        ] {
            assert!(bad.parse::<Origin>().is_err(), "{bad}");
        }
    }

    #[test]
    fn only_an_address_is_an_address() {
        for address in ["http://127.0.0.1:9000", "http://[::1]:9000"] {
            assert!(origin(address).is_address(), "{address}");
        }
        for name in ["http://localhost", "http://2130706433", "http://0x7f.1"] {
            assert!(!origin(name).is_address(), "{name}");
        }
    }
}
