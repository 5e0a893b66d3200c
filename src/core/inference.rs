//! ONNX Runtime: finding and starting the library, and sessions of networks on one provider.

mod error;
mod file;
mod network;
pub mod runtime;
mod session;
mod wire;

use std::fmt::Write as _;

use sha2::{Digest, Sha256};

pub use error::RuntimeError;
pub use file::{OnnxFile, OnnxFileError};
pub use network::{Input, Network, Output};
pub use runtime::Runtime;
pub use session::{Graph, Provider, session};

/// SHA-256, lower-case hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    digest_of(std::iter::once(bytes))
}

/// SHA-256 of parts that follow each other, lower-case hexadecimal.
fn digest_of<'a>(parts: impl Iterator<Item = &'a [u8]>) -> String {
    let mut hash = Sha256::new();
    parts.for_each(|part| hash.update(part));
    hash.finalize().iter().fold(String::with_capacity(64), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}
