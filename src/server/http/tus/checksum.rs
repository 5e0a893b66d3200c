//! `Upload-Checksum`: whether a piece came as it was sent.

use axum::http::HeaderMap;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use sha1::{Digest as _, Sha1};
use sha2::{Digest as _, Sha256};

use super::fields::{CHECKSUM, bad, text};
use crate::http::problem::Problem;

/// Those that are known.
pub(super) const ALGORITHMS: &str = "sha1,sha256";

/// What a piece is to hash to, and what it has hashed to so far.
#[derive(Debug)]
pub(super) struct Checksum {
    hasher: Hasher,
    expected: Vec<u8>,
}

#[derive(Debug)]
enum Hasher {
    Sha1(Sha1),
    Sha256(Sha256),
}

impl Checksum {
    /// The checksum that a request promises, if it does.
    ///
    /// # Errors
    /// 400 where it cannot be read or its algorithm is not known.
    pub(super) fn of(headers: &HeaderMap) -> Result<Option<Self>, Problem> {
        let Some(sent) = text(headers, &CHECKSUM)? else {
            return Ok(None);
        };
        let (algorithm, digest) = sent.split_once(' ').unwrap_or((sent, ""));
        let (hasher, bytes) = match algorithm {
            "sha1" => (Hasher::Sha1(Sha1::new()), 20),
            "sha256" => (Hasher::Sha256(Sha256::new()), 32),
            _ => {
                let detail = format!("`Upload-Checksum` is of none of: {ALGORITHMS}.");
                return Err(bad(detail));
            }
        };
        match STANDARD.decode(digest) {
            Ok(expected) if expected.len() == bytes => Ok(Some(Self { hasher, expected })),
            _ => Err(bad("`Upload-Checksum` has no digest in base64.")),
        }
    }

    /// More of the piece.
    pub(super) fn update(&mut self, bytes: &[u8]) {
        match &mut self.hasher {
            Hasher::Sha1(hasher) => hasher.update(bytes),
            Hasher::Sha256(hasher) => hasher.update(bytes),
        }
    }

    /// Whether the piece is what was sent.
    pub(super) fn holds(self) -> bool {
        match self.hasher {
            Hasher::Sha1(hasher) => hasher.finalize()[..] == self.expected[..],
            Hasher::Sha256(hasher) => hasher.finalize()[..] == self.expected[..],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(sent: &str) -> Result<Option<Checksum>, Problem> {
        let mut headers = HeaderMap::new();
        headers.insert(CHECKSUM, sent.parse().expect("header"));
        Checksum::of(&headers)
    }

    #[test]
    fn a_piece_holds_if_it_is_what_was_promised() {
        // printf 'hello world' | openssl dgst -sha1 -binary | base64, and the same with -sha256.
        for sent in [
            "sha1 Kq5sNclPz7QV2+lfQIuc6R7oRu0=",
            "sha256 uU0nuZNNPgilLlLX2n2r+sSE7+N6U4DukIj3rOLvzek=",
        ] {
            for (text, holds) in [("hello world", true), ("hello worle", false)] {
                let mut sum = of(sent).expect("read").expect("there");
                let (first, rest) = text.split_at(4);
                sum.update(first.as_bytes());
                sum.update(rest.as_bytes());
                assert_eq!(sum.holds(), holds, "{sent}: {text}");
            }
        }
    }

    #[test]
    fn what_is_no_checksum_is_refused() {
        for wrong in [
            "",
            "sha1",
            "sha1 ",
            "sha1 YQ==",
            "sha1 Kq5sNclPz7QV2+lfQIuc6R7oRu0",
            "md5 XrY7u+Ae7tCTyyK7j1rNww==",
            "SHA1 Kq5sNclPz7QV2+lfQIuc6R7oRu0=",
        ] {
            assert!(of(wrong).is_err(), "{wrong}");
        }
        assert!(matches!(Checksum::of(&HeaderMap::new()), Ok(None)));
    }
}
