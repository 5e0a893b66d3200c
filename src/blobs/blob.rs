//! Blob names, and hashing of files.

use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use crate::error::{BlobError, Result};

/// Hexadecimal digits of a digest.
const DIGITS: usize = 64;

/// Bytes per read.
const READ: usize = 1 << 20;

/// The digest and size of some content.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Blob {
    /// BLAKE3 digest of the content, as 64 lowercase hexadecimal digits.
    pub digest: String,
    /// Size of the content.
    pub bytes: u64,
}

impl Blob {
    /// Hashes `bytes`.
    pub fn of(bytes: &[u8]) -> Self {
        Self::named(blake3::hash(bytes), bytes.len() as u64)
    }

    pub(crate) fn named(hash: blake3::Hash, bytes: u64) -> Self {
        Self { digest: hash.to_hex().to_string(), bytes }
    }
}

/// Rejects anything but a digest, such as a path.
pub(crate) fn expect_digest(digest: &str) -> Result<()> {
    if is_digest(digest) {
        return Ok(());
    }
    Err(BlobError::Digest(digest.chars().take(2 * DIGITS).collect()))
}

pub(crate) fn is_digest(text: &str) -> bool {
    let digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    text.len() == DIGITS && text.bytes().all(digit)
}

/// Metadata by which a file is recognised as unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    pub bytes: u64,
    /// Nanoseconds since 1970.
    pub modified_ns: i128,
    pub inode: u64,
}

impl Stamp {
    pub(crate) fn of(metadata: &Metadata) -> Self {
        let seconds = i128::from(metadata.mtime()) * 1_000_000_000;
        Self {
            bytes: metadata.len(),
            modified_ns: seconds + i128::from(metadata.mtime_nsec()),
            inode: metadata.ino(),
        }
    }
}

/// Hashes the current content of a file. Blocks.
///
/// # Errors
/// [`BlobError::Changed`] if the file was written to meanwhile; [`BlobError::Io`].
pub(crate) fn hash_file(path: &Path) -> Result<Blob> {
    let mut file = File::open(path).map_err(BlobError::io(path))?;
    let before = file.metadata().map_err(BlobError::io(path))?;
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0; READ];
    let mut bytes = 0;
    loop {
        match file.read(&mut buffer) {
            Ok(0) => break,
            Ok(read) => {
                hasher.update(&buffer[..read]);
                bytes += read as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(BlobError::io(path)(error)),
        }
    }
    let after = file.metadata().map_err(BlobError::io(path))?;
    if Stamp::of(&before) != Stamp::of(&after) || bytes != after.len() {
        return Err(BlobError::Changed(path.to_owned()));
    }
    Ok(Blob::named(hasher.finalize(), bytes))
}

/// Runs blocking work on a thread meant for it.
///
/// # Errors
/// Those of `work`; [`BlobError::Stopping`] at the end of the process.
pub(crate) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<T> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => Err(BlobError::Stopping),
        },
    }
}
