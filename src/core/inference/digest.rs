//! Checksums of networks and their weights.

use std::fmt::Write as _;

use sha2::{Digest, Sha256};

/// SHA-256, lower-case hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .fold(String::with_capacity(64), |mut text, byte| {
            let _ = write!(text, "{byte:02x}");
            text
        })
}
