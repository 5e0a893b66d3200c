//! Files as blobs: named by what is in them, kept in a directory that all machines share or in an
//! S3 bucket. What a blob is for, a database says that this crate knows nothing of; the files of a
//! machine are a cache of both, and [`push`] and [`pull`] keep the two alike.

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
