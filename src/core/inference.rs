//! ONNX Runtime: finding and starting the library, and sessions of networks on one provider.

mod error;
mod network;
pub mod runtime;
mod session;

use std::fmt::Write as _;

use sha2::{Digest, Sha256};

pub use error::RuntimeError;
pub use network::{Input, Network, Output};
pub use runtime::Runtime;
pub use session::{Graph, Provider, session};

/// SHA-256, lower-case hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::with_capacity(64), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}
