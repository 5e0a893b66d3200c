//! Tokens: their format, scopes and expiry.

use std::fmt;
use std::str::FromStr;

use jiff::{Span, Timestamp, Zoned};
use sha2::{Digest as _, Sha256};

/// The prefix of every token, by which secret scanners recognise a leaked one.
const PREFIX: &str = "fled_";
/// Random bytes of a token.
const BYTES: usize = 32;
/// Random bytes of a token's id.
const ID_BYTES: usize = 6;

/// The SHA-256 of a token, the only part that is stored. 256 random bits need no slow hash.
pub type Digest = [u8; 32];

/// A permission of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// See captures, jobs and results.
    JobsRead,
    /// Upload, and start, cancel, retry and delete jobs.
    JobsWrite,
    /// Render novel views.
    Renders,
    /// Everything, for all owners.
    Admin,
}

impl Scope {
    const ALL: [Self; 4] = [Self::JobsRead, Self::JobsWrite, Self::Renders, Self::Admin];

    /// The name in lists of scopes.
    pub fn name(self) -> &'static str {
        match self {
            Self::JobsRead => "jobs:read",
            Self::JobsWrite => "jobs:write",
            Self::Renders => "renders",
            Self::Admin => "admin",
        }
    }
}

/// The scopes of a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scopes(Vec<Scope>);

impl Scopes {
    /// Parses the scopes of a stored token; unknown ones allow nothing.
    pub fn stored(names: &str) -> Self {
        let of_name = |name| Scope::ALL.into_iter().find(|scope| scope.name() == name);
        Self(names.split(',').filter_map(of_name).collect())
    }

    /// Returns whether `scope` is allowed; `admin` allows everything.
    pub fn allow(&self, scope: Scope) -> bool {
        self.0.contains(&scope) || self.0.contains(&Scope::Admin)
    }
}

impl fmt::Display for Scopes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("nothing");
        }
        let names: Vec<_> = self.0.iter().map(|scope| scope.name()).collect();
        f.write_str(&names.join(","))
    }
}

impl FromStr for Scopes {
    type Err = TokenError;

    fn from_str(text: &str) -> Result<Self, TokenError> {
        let named = |name: &str| {
            let scope = Scope::ALL.into_iter().find(|scope| scope.name() == name);
            scope.ok_or_else(|| TokenError::UnknownScope(name.to_owned()))
        };
        let mut scopes = Vec::new();
        for name in text.split(',') {
            let scope = named(name.trim())?;
            if !scopes.contains(&scope) {
                scopes.push(scope);
            }
        }
        Ok(Self(scopes))
    }
}

/// Why a token cannot be created.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    /// There is no such scope.
    #[error("`{0}` is not a scope; use jobs:read, jobs:write, renders or admin")]
    UnknownScope(String),
    /// Not a duration into the future.
    #[error("`{0}` is not a duration; use, for example, 90d, 12h or 1y")]
    BadExpiry(String),
    /// Not a size in bytes.
    #[error("`{0}` is not a size; use 20G, 500M or a number of bytes")]
    BadSize(String),
    /// The operating system provides no randomness.
    #[error("the system provides no random numbers: {0}")]
    NoRandomness(String),
}

/// The plain text of a token. It is shown once and never stored.
#[derive(Clone)]
pub struct Secret(String);

impl Secret {
    /// Generates a new token.
    ///
    /// # Errors
    /// [`TokenError::NoRandomness`].
    pub fn new() -> Result<Self, TokenError> {
        Ok(Self(format!("{PREFIX}{}", hex(&random::<BYTES>()?))))
    }

    /// The digest to store.
    pub fn digest(&self) -> Digest {
        digest(&self.0)
    }

    /// The plain text, for its owner.
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

/// The digest of a presented token.
pub fn digest(token: &str) -> Digest {
    Sha256::digest(token.as_bytes()).into()
}

/// Generates a public id by which a token is listed and revoked.
///
/// # Errors
/// [`TokenError::NoRandomness`].
pub fn new_id() -> Result<String, TokenError> {
    Ok(hex(&random::<ID_BYTES>()?))
}

/// Expiry of a token created now, in milliseconds since 1970.
///
/// # Errors
/// [`TokenError::BadExpiry`] if `text` is not a duration into the future.
pub fn expiry(text: &str) -> Result<i64, TokenError> {
    let bad = || TokenError::BadExpiry(text.to_owned());
    let span: Span = text.parse().map_err(|_| bad())?;
    let now = Zoned::now();
    let end = now.checked_add(span).map_err(|_| bad())?;
    if end <= now {
        return Err(bad());
    }
    Ok(end.timestamp().as_millisecond())
}

/// Parses a number of bytes such as `20G`, `500M`, `1.5T` (powers of 1,000) or `1000000`.
///
/// # Errors
/// [`TokenError::BadSize`].
pub fn size(text: &str) -> Result<u64, TokenError> {
    let bad = || TokenError::BadSize(text.to_owned());
    let unit = match text.chars().last().map(|unit| unit.to_ascii_uppercase()) {
        Some('K') => 1e3,
        Some('M') => 1e6,
        Some('G') => 1e9,
        Some('T') => 1e12,
        _ => return text.parse().map_err(|_| bad()),
    };
    let number: f64 = text[..text.len() - 1].parse().map_err(|_| bad())?;
    if !(0.0..1e6).contains(&number) {
        return Err(bad());
    }
    Ok((number * unit) as u64)
}

/// Formats a time for lists, in UTC.
pub fn shown(milliseconds: i64) -> String {
    let time = Timestamp::from_millisecond(milliseconds).unwrap_or_default();
    time.strftime("%Y-%m-%d %H:%M").to_string()
}

fn random<const N: usize>() -> Result<[u8; N], TokenError> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|error| TokenError::NoRandomness(error.to_string()))?;
    Ok(bytes)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_token_is_unique_and_hidden_from_debug_output() {
        let (one, other) = (Secret::new().expect("random"), Secret::new().expect("random"));
        assert_ne!(one.reveal(), other.reveal());
        assert_eq!(one.reveal().len(), PREFIX.len() + 2 * BYTES);
        assert!(one.reveal().starts_with("fled_"));
        assert_eq!(one.digest(), digest(one.reveal()));
        assert_eq!(format!("{one:?}"), "Secret");
    }

    #[test]
    fn a_scope_allows_itself_and_admin_allows_all() {
        let scopes: Scopes = "jobs:read, renders,jobs:read".parse().expect("scopes");
        assert_eq!(scopes.to_string(), "jobs:read,renders");
        assert!(scopes.allow(Scope::JobsRead) && scopes.allow(Scope::Renders));
        assert!(!scopes.allow(Scope::JobsWrite) && !scopes.allow(Scope::Admin));
        let admin: Scopes = "admin".parse().expect("scopes");
        assert!(Scope::ALL.into_iter().all(|scope| admin.allow(scope)));
        for none in ["", "jobs", "jobs:read,", "Admin"] {
            assert!(none.parse::<Scopes>().is_err(), "{none:?}");
        }
        let stored = Scopes::stored("worker,renders");
        assert_eq!(stored.to_string(), "renders");
        assert_eq!(Scopes::stored("worker").to_string(), "nothing");
    }

    #[test]
    fn a_size_is_a_number_with_a_unit() {
        let sizes = ["20G", "1.5t", "500m", "10k", "123"].map(|text| size(text).expect(text));
        assert_eq!(sizes, [20_000_000_000, 1_500_000_000_000, 500_000_000, 10_000, 123]);
        for none in ["", "G", "-1G", "1e9G", "NaNG", "20 GB", "ä", "1.5"] {
            assert!(size(none).is_err(), "{none:?}");
        }
    }

    #[test]
    fn an_expiry_is_a_duration_from_now() {
        let day = 24 * 3600 * 1000;
        let left = expiry("2d").expect("two days") - Timestamp::now().as_millisecond();
        assert!((left - 2 * day).abs() < day / 10, "{left}");
        assert!(expiry("12h").is_ok() && expiry("1y").is_ok());
        for none in ["", "0s", "-1d", "tomorrow", "2020-01-01"] {
            assert!(expiry(none).is_err(), "{none:?}");
        }
    }
}
