//! Storing blobs.

use std::fs::File;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

use object_store::{MultipartUpload, ObjectStoreExt, PutPayload};
use tokio::sync::OwnedSemaphorePermit;
use tokio::task::{JoinError, JoinSet};

use crate::blob::{Blob, Stamp, blocking, hash_file};
use crate::error::{BlobError, Result};
use crate::store::{Blobs, UPLOADING_MIB, age_of};

/// Maximum size of content sent in one request, from memory.
const SMALL: u64 = 16 << 20;

/// Minimum size of a part of larger content.
const PART: u64 = 8 << 20;

/// Maximum parts of an upload; S3 accepts 10 000.
const PARTS: u64 = 9_000;

/// Maximum age of a blob that is not sent again. The janitor deletes blobs that have been unnamed
/// for 24 hours, and a blob is named only after it was put: that leaves half a day.
const FRESH: Duration = Duration::from_secs(12 * 60 * 60);

impl Blobs {
    /// Stores the current content of a file. Sends nothing if the store received it less than
    /// twelve hours ago. Reads a large file twice, and holds little of it in memory.
    ///
    /// # Errors
    /// [`BlobError::Changed`] if the file was written to meanwhile, in which case nothing is
    /// stored; [`BlobError::Io`] if it cannot be read or is not a regular file;
    /// [`BlobError::Store`].
    pub async fn put(&self, path: &Path) -> Result<Blob> {
        let file = path.to_owned();
        let bytes = blocking(move || length(&file)).await?;
        let file = path.to_owned();
        if bytes <= SMALL {
            let _room = self.room(bytes).await?;
            let (read, blob) = blocking(move || read_small(&file)).await?;
            if !self.has_fresh(&blob).await? {
                self.send_whole(&blob, read).await?;
            }
            return Ok(blob);
        }
        let blob = blocking(move || hash_file(&file)).await?;
        if self.has_fresh(&blob).await? {
            return Ok(blob);
        }
        let source = File::open(path).map_err(BlobError::io(path))?;
        self.send_parts(Reading::of(source, path), &blob).await?;
        Ok(blob)
    }

    /// Stores `bytes` like [`Blobs::put`].
    ///
    /// # Errors
    /// [`BlobError::Store`].
    pub async fn put_bytes(&self, bytes: Vec<u8>) -> Result<Blob> {
        let named = blocking(move || Ok((Blob::of(&bytes), bytes)));
        let (blob, bytes) = named.await?;
        if self.has_fresh(&blob).await? {
            return Ok(blob);
        }
        if blob.bytes <= SMALL {
            let _room = self.room(blob.bytes).await?;
            self.send_whole(&blob, bytes).await?;
        } else {
            let reading = Reading::of(Cursor::new(bytes), Path::new("memory"));
            self.send_parts(reading, &blob).await?;
        }
        Ok(blob)
    }

    /// Waits until this many bytes may be held in memory and sent.
    async fn room(&self, bytes: u64) -> Result<OwnedSemaphorePermit> {
        let mib = u32::try_from(bytes.div_ceil(1 << 20)).unwrap_or(u32::MAX);
        let mib = mib.clamp(1, UPLOADING_MIB);
        let room = self.uploading().acquire_many_owned(mib).await;
        room.map_err(|_| BlobError::Stopping)
    }

    /// Returns whether the store has the blob, and recently enough not to send it again.
    async fn has_fresh(&self, blob: &Blob) -> Result<bool> {
        let found = self.look(&blob.digest).await?;
        Ok(found.is_some_and(|object| object.size == blob.bytes && age_of(&object) < FRESH))
    }

    async fn send_whole(&self, blob: &Blob, bytes: Vec<u8>) -> Result<()> {
        let key = self.key(&blob.digest);
        let sent = self.store().put(&key, PutPayload::from(bytes)).await;
        sent.map_err(|error| self.failed("write a blob", error))?;
        Ok(())
    }

    async fn send_parts<R>(&self, reading: Reading<R>, blob: &Blob) -> Result<()>
    where
        R: Read + Send + 'static,
    {
        let key = self.key(&blob.digest);
        let upload = self.store().put_multipart(&key).await;
        let mut upload = upload.map_err(|error| self.failed("begin a blob", error))?;
        let mut parts = JoinSet::new();
        let mut sent = self.read_and_send(upload.as_mut(), &mut parts, reading, blob).await;
        if sent.is_ok() {
            let completed = upload.complete().await;
            sent = completed.map(|_| ()).map_err(|error| self.failed("complete a blob", error));
        }
        if sent.is_err() {
            parts.shutdown().await;
            if let Err(error) = upload.abort().await {
                tracing::warn!(%error, location = self.location(), "parts of a blob remain");
            }
        }
        sent
    }

    /// Sends all parts. Fails with [`BlobError::Changed`], before anything is visible, if the
    /// content differs from the first reading.
    async fn read_and_send<R>(
        &self,
        upload: &mut dyn MultipartUpload,
        parts: &mut JoinSet<object_store::Result<()>>,
        mut reading: Reading<R>,
        blob: &Blob,
    ) -> Result<()>
    where
        R: Read + Send + 'static,
    {
        let size = PART.max(blob.bytes / PARTS + 1);
        while reading.bytes <= blob.bytes {
            let room = self.room(size).await?;
            let (so_far, part) = blocking(move || reading.next(size)).await?;
            reading = so_far;
            if part.is_empty() {
                break;
            }
            let sending = upload.put_part(PutPayload::from(part));
            // In separate tasks: they must progress while this one waits for room.
            parts.spawn(async move {
                let sent = sending.await;
                drop(room);
                sent
            });
            while let Some(part) = parts.try_join_next() {
                self.arrived(part)?;
            }
        }
        while let Some(part) = parts.join_next().await {
            self.arrived(part)?;
        }
        if reading.named() == *blob { Ok(()) } else { Err(BlobError::Changed(reading.path)) }
    }

    fn arrived(&self, part: Result<object_store::Result<()>, JoinError>) -> Result<()> {
        match part {
            Ok(sent) => sent.map_err(|error| self.failed("write a part of a blob", error)),
            Err(error) => match error.try_into_panic() {
                Ok(panic) => std::panic::resume_unwind(panic),
                Err(_) => Err(BlobError::Stopping),
            },
        }
    }
}

/// Returns the size of a regular file. Reading any other file, such as a pipe, could continue
/// forever.
fn length(path: &Path) -> Result<u64> {
    let metadata = std::fs::metadata(path).map_err(BlobError::io(path))?;
    if !metadata.is_file() {
        let error = std::io::Error::other("it is no regular file");
        return Err(BlobError::io(path)(error));
    }
    Ok(metadata.len())
}

/// Reads and hashes a small file.
fn read_small(path: &Path) -> Result<(Vec<u8>, Blob)> {
    let mut file = File::open(path).map_err(BlobError::io(path))?;
    let before = file.metadata().map_err(BlobError::io(path))?;
    let mut bytes = Vec::with_capacity(usize::try_from(before.len().min(SMALL)).unwrap_or(0));
    let mut limited = (&mut file).take(SMALL + 1);
    let read = limited.read_to_end(&mut bytes);
    read.map_err(BlobError::io(path))?;
    let after = file.metadata().map_err(BlobError::io(path))?;
    if Stamp::of(&before) != Stamp::of(&after) || bytes.len() as u64 != after.len() {
        return Err(BlobError::Changed(path.to_owned()));
    }
    let blob = Blob::of(&bytes);
    Ok((bytes, blob))
}

/// A source that is read in parts, with the hash of the part read so far.
struct Reading<R> {
    source: R,
    path: PathBuf,
    hasher: blake3::Hasher,
    bytes: u64,
}

impl<R: Read> Reading<R> {
    fn of(source: R, path: &Path) -> Self {
        Self { source, path: path.to_owned(), hasher: blake3::Hasher::new(), bytes: 0 }
    }

    /// Reads the next part, which is short only at the end. Blocks.
    fn next(mut self, size: u64) -> Result<(Self, Vec<u8>)> {
        let mut part = Vec::with_capacity(usize::try_from(size).unwrap_or(0));
        let mut limited = (&mut self.source).take(size);
        let read = limited.read_to_end(&mut part);
        read.map_err(BlobError::io(&self.path))?;
        self.hasher.update(&part);
        self.bytes += part.len() as u64;
        Ok((self, part))
    }

    fn named(&self) -> Blob {
        Blob::named(self.hasher.finalize(), self.bytes)
    }
}
