//! The blob store: a directory that all machines share, or a bucket.
//!
//! ```text
//! <prefix>/blobs/ab/<64 digits that begin with ab>   <prefix>/probes/<id>   <prefix>/mark
//! ```
//! An interrupted upload leaves no blob: an object appears completely or not at all. In a directory
//! it may leave files, which [`Blobs::delete_unfinished`] removes. In a bucket it may leave
//! unlisted parts, which a lifecycle rule with `AbortIncompleteMultipartUpload` removes.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use futures::StreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{BackoffConfig, ClientOptions, ObjectMeta, ObjectStore, ObjectStoreExt};
use object_store::{PutPayload, RetryConfig};
use tokio::sync::{Mutex, Semaphore};
use uuid::Uuid;

use crate::blob::{Blob, blocking, expect_digest, is_digest};
use crate::error::{BlobError, Result};

/// How long a request may stall.
const SILENCE: Duration = Duration::from_secs(30);

/// How long a failing request is retried.
const PATIENCE: Duration = Duration::from_secs(60);

/// How long a probe may take.
const PROBE: Duration = Duration::from_secs(10);

/// MiB that uploads hold in memory and have in flight. A slow line must carry them all within
/// [`SILENCE`].
pub(crate) const UPLOADING_MIB: u32 = 32;

/// A blob store. Cheap to clone; clones share their limits.
#[derive(Clone)]
pub struct Blobs {
    shared: Arc<Shared>,
}

struct Shared {
    store: Arc<dyn ObjectStore>,
    prefix: Key,
    location: String,
    /// Its path, if it is a directory.
    directory: Option<PathBuf>,
    uploading: Arc<Semaphore>,
    /// The name of this process's probe, reused so that interrupted probes leave one object, not
    /// thousands.
    probe: Mutex<Uuid>,
}

impl fmt::Debug for Blobs {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Blobs({})", self.location())
    }
}

impl Blobs {
    /// Opens `s3://bucket/prefix`, configured by `object_store`'s `AWS_*` variables (among them
    /// `AWS_ENDPOINT`, `AWS_REGION`, `AWS_ALLOW_HTTP`), or a directory, also as `file://` and an
    /// absolute path, which is created. Does not contact the bucket: see [`Blobs::check`].
    ///
    /// # Errors
    /// [`BlobError::Location`] or [`BlobError::Io`] if no store can be opened there.
    pub fn open(location: &str) -> Result<Self> {
        let location = location.trim();
        if let Some(place) = location.strip_prefix("s3://") {
            let variables = std::env::vars_os()
                .filter_map(|(name, value)| Some((name.into_string().ok()?, value)))
                .filter_map(|(name, value)| Some((name, value.into_string().ok()?)));
            return Self::bucket(place, variables, PATIENCE);
        }
        let path = location.strip_prefix("file://").unwrap_or(location);
        if path.is_empty() {
            return Err(BlobError::Location("it is empty".into()));
        }
        if path.contains("://") || (path.len() < location.len() && !path.starts_with('/')) {
            // Not repeated: URLs may contain passwords.
            return Err(BlobError::Location("it is neither s3:// nor a path".into()));
        }
        Self::directory(Path::new(path))
    }

    fn directory(path: &Path) -> Result<Self> {
        std::fs::create_dir_all(path).map_err(BlobError::io(path))?;
        let path = path.canonicalize().map_err(BlobError::io(path))?;
        let store = LocalFileSystem::new_with_prefix(&path)
            .map_err(|error| BlobError::Location(error.to_string()))?
            .with_fsync(true);
        let location = path.display().to_string();
        let blobs = Self::of(Arc::new(store), Key::default(), location, Some(path));
        Ok(blobs)
    }

    /// Opens `bucket/prefix` with settings named like the `AWS_*` variables; failing requests are
    /// retried for `patience`.
    pub(crate) fn bucket(
        place: &str,
        settings: impl IntoIterator<Item = (String, String)>,
        patience: Duration,
    ) -> Result<Self> {
        let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
        let letter = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        if bucket.is_empty() || !bucket.chars().all(letter) {
            // Not repeated: it may be a password.
            return Err(BlobError::Location("its bucket has no valid name".into()));
        }
        let refused = |error: &dyn fmt::Display| BlobError::Location(error.to_string());
        let prefix = Key::parse(prefix).map_err(|error| refused(&error))?;
        choose_tls();
        let mut builder = AmazonS3Builder::new()
            .with_retry(retries(patience))
            .with_client_options(timeouts())
            // Blobs are deleted one at a time, which every server supports.
            .with_disable_bulk_delete(true);
        for (name, value) in settings {
            if let Some(key) = setting(&name) {
                builder = builder.with_config(key, value);
            }
        }
        let store = builder.with_bucket_name(bucket).build().map_err(|error| refused(&error))?;
        let location = format!("s3://{bucket}/{prefix}");
        let location = location.trim_end_matches('/').to_owned();
        Ok(Self::of(Arc::new(store), prefix, location, None))
    }

    fn of(
        store: Arc<dyn ObjectStore>,
        prefix: Key,
        location: String,
        directory: Option<PathBuf>,
    ) -> Self {
        let shared = Shared {
            store,
            prefix,
            location,
            directory,
            uploading: Arc::new(Semaphore::new(UPLOADING_MIB as usize)),
            probe: Mutex::new(Uuid::now_v7()),
        };
        Self { shared: Arc::new(shared) }
    }

    /// The location without secrets, for messages.
    pub fn location(&self) -> &str {
        &self.shared.location
    }

    /// Writes, reads back and deletes a small probe to check that blobs can be stored. Takes at
    /// most ten seconds.
    ///
    /// # Errors
    /// [`BlobError::NotReady`] or [`BlobError::Store`] if they cannot be stored.
    pub async fn check(&self) -> Result<()> {
        tokio::time::timeout(PROBE, self.probe()).await.unwrap_or_else(|_| {
            let detail = format!("no answer within {} s", PROBE.as_secs());
            Err(self.not_ready(detail))
        })
    }

    async fn probe(&self) -> Result<()> {
        // One at a time, since probes share a name.
        let name = self.shared.probe.lock().await;
        let key = self.below("probes").join(name.to_string());
        let written = Uuid::now_v7().to_string();
        let payload = PutPayload::from(written.clone());
        let put = self.store().put(&key, payload).await;
        put.map_err(|error| self.failed("write a probe", error))?;
        let got = self.store().get(&key).await;
        let got = got.map_err(|error| self.failed("read a probe", error))?;
        let read = got.bytes().await;
        let read = read.map_err(|error| self.failed("read a probe", error))?;
        let deleted = self.store().delete(&key).await;
        deleted.map_err(|error| self.failed("delete a probe", error))?;
        if read != written.as_bytes() {
            return Err(self.not_ready("a probe was read back with other bytes".into()));
        }
        Ok(())
    }

    /// Returns every blob whose digest begins with this byte and that was last written more than
    /// `age` ago, comparing this machine's clock with the store's. One byte at a time, because a
    /// store may have more blobs than fit into memory.
    ///
    /// # Errors
    /// [`BlobError::Store`] if they cannot be listed.
    pub async fn older_than(&self, first: u8, age: Duration) -> Result<Vec<Blob>> {
        let folder = self.below("blobs").join(format!("{first:02x}"));
        let mut listed = self.store().list(Some(&folder));
        let mut old = Vec::new();
        while let Some(object) = listed.next().await {
            let object = object.map_err(|error| self.failed("list the blobs", error))?;
            let name = object.location.filename().unwrap_or_default();
            let is_blob = is_digest(name) && object.location == self.key(name);
            if is_blob && age_of(&object) > age {
                old.push(Blob { digest: name.to_owned(), bytes: object.size });
            }
        }
        Ok(old)
    }

    /// Returns whether the store has no blob.
    ///
    /// # Errors
    /// [`BlobError::Store`] if they cannot be listed.
    pub async fn is_empty(&self) -> Result<bool> {
        let first = self.store().list(Some(&self.below("blobs"))).next().await;
        let first = first.transpose();
        let first = first.map_err(|error| self.failed("list the blobs", error))?;
        Ok(first.is_none())
    }

    /// Removes a blob, if it exists.
    pub(crate) async fn delete(&self, digest: &str) -> Result<()> {
        expect_digest(digest)?;
        match self.store().delete(&self.key(digest)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(self.failed("delete a blob", error)),
        }
    }

    /// Removes a blob if it is still older than `age`, and returns whether it did. The check
    /// protects blobs that were put again since they were listed. Code that names blobs must itself
    /// exclude the short interval between check and removal.
    ///
    /// # Errors
    /// [`BlobError::Digest`] or [`BlobError::Store`].
    pub async fn delete_older(&self, digest: &str, age: Duration) -> Result<bool> {
        expect_digest(digest)?;
        match self.look(digest).await? {
            Some(object) if age_of(&object) > age => self.delete(digest).await.map(|()| true),
            _ => Ok(false),
        }
    }

    /// Removes the remains of uploads to a directory that broke off more than `age` ago, and
    /// returns the number of files. In a bucket there is nothing to delete; see the top of this
    /// file.
    ///
    /// # Errors
    /// [`BlobError::Io`] if the directory cannot be read.
    pub async fn delete_unfinished(&self, age: Duration) -> Result<usize> {
        let Some(directory) = self.shared.directory.clone() else {
            return Ok(0);
        };
        blocking(move || delete_unfinished(&directory.join("blobs"), age)).await
    }

    pub(crate) fn store(&self) -> &dyn ObjectStore {
        self.shared.store.as_ref()
    }

    pub(crate) fn uploading(&self) -> Arc<Semaphore> {
        self.shared.uploading.clone()
    }

    /// The key of a blob; `digest` must be a valid digest.
    pub(crate) fn key(&self, digest: &str) -> Key {
        let folder = digest.get(..2).unwrap_or_default().to_owned();
        self.below("blobs").join(folder).join(digest.to_owned())
    }

    pub(crate) fn below(&self, name: &'static str) -> Key {
        self.shared.prefix.clone().join(name)
    }

    /// Returns the metadata of a blob, if it exists.
    pub(crate) async fn look(&self, digest: &str) -> Result<Option<ObjectMeta>> {
        match self.store().head(&self.key(digest)).await {
            Ok(object) => Ok(Some(object)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.failed("look for a blob", error)),
        }
    }

    pub(crate) fn failed(&self, doing: &'static str, source: object_store::Error) -> BlobError {
        BlobError::Store { location: self.location().to_owned(), doing, source }
    }

    fn not_ready(&self, detail: String) -> BlobError {
        BlobError::NotReady { location: self.location().to_owned(), detail }
    }
}

/// A TLS client needs a cryptography provider to be chosen; fled's other clients use the same one.
fn choose_tls() {
    let _already_chosen = rustls::crypto::ring::default_provider().install_default();
}

/// The age of an object; zero if the store's clock is ahead.
pub(crate) fn age_of(object: &ObjectMeta) -> Duration {
    let written = SystemTime::from(object.last_modified);
    written.elapsed().unwrap_or_default()
}

fn setting(variable: &str) -> Option<AmazonS3ConfigKey> {
    if !variable.starts_with("AWS_") {
        return None;
    }
    variable.to_ascii_lowercase().parse().ok()
}

fn retries(patience: Duration) -> RetryConfig {
    RetryConfig {
        backoff: BackoffConfig {
            init_backoff: Duration::from_millis(200),
            max_backoff: Duration::from_secs(8),
            base: 3.0,
        },
        // The waits are random and may all be short: the time limit ends the retries, not their
        // number.
        max_retries: 100,
        retry_timeout: patience,
    }
}

fn timeouts() -> ClientOptions {
    // No limit for a whole request, whose time depends on the size of the blob.
    ClientOptions::new().with_timeout_disabled().with_read_timeout(SILENCE)
}

/// Removes old `<name>#<number>` files: `object_store` uses such names before it renames files.
fn delete_unfinished(blobs: &Path, age: Duration) -> Result<usize> {
    let mut deleted = 0;
    for folder in entries(blobs)? {
        for path in entries(&folder)? {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let unfinished = name.split_once('#').is_some_and(|(digest, number)| {
                is_digest(digest) && number.bytes().all(|byte| byte.is_ascii_digit())
            });
            // If the file is just being renamed, it no longer exists, and the rename is not
            // disturbed.
            let old = || {
                let written = path.metadata().and_then(|metadata| metadata.modified());
                written.is_ok_and(|time| time.elapsed().is_ok_and(|elapsed| elapsed > age))
            };
            if unfinished && old() && std::fs::remove_file(&path).is_ok() {
                deleted += 1;
            }
        }
    }
    Ok(deleted)
}

/// Lists a directory; empty if it does not exist.
fn entries(directory: &Path) -> Result<Vec<PathBuf>> {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    let entries = match std::fs::read_dir(directory) {
        Err(error) if matches!(error.kind(), NotFound | NotADirectory) => return Ok(Vec::new()),
        entries => entries.map_err(BlobError::io(directory))?,
    };
    let paths = entries.map(|entry| entry.map(|entry| entry.path()));
    let paths: std::io::Result<Vec<PathBuf>> = paths.collect();
    paths.map_err(BlobError::io(directory))
}
