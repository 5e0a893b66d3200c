//! ONNX Runtime: finding and starting the library, and sessions of networks on one provider.

mod digest;
mod error;
mod network;
pub mod runtime;
mod session;

pub use digest::digest;
pub use error::RuntimeError;
pub use network::{Input, Network, Output};
pub use runtime::Runtime;
pub use session::{Graph, Provider, session};
