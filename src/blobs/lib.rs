//! Content-addressed storage of files, in a directory that all machines share or in an S3 bucket. A
//! separate database, unknown to this crate, records the purpose of each blob. The files of a
//! machine are a cache of both, which [`push`] and [`pull`] synchronise.

mod blob;
mod error;
mod fetch;
mod folder;
mod mark;
mod pull;
mod push;
mod put;
mod seen;
mod store;
#[cfg(test)]
mod tests;

pub use blob::Blob;
pub use error::{BlobError, Result};
pub use folder::Kept;
pub use pull::{Pulled, pull};
pub use push::{Pushed, push};
pub use seen::Seen;
pub use store::Blobs;
