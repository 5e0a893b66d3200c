//! Fetching blobs.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use futures::StreamExt;
use futures::stream::BoxStream;
use object_store::{GetResultPayload, ObjectStoreExt};
use uuid::Uuid;

use crate::blob::{Blob, Stamp, blocking, expect_digest};
use crate::error::{BlobError, Result};
use crate::folder::UNFINISHED;
use crate::store::Blobs;

/// Attempts to fetch a blob whose transfer breaks off. `object_store` itself retries requests, and
/// resumes them where possible.
const ATTEMPTS: u32 = 4;

/// Wait before the second attempt; it doubles with each further one.
const WAIT: Duration = Duration::from_millis(500);

/// Attempts to fetch a blob that arrives damaged.
const DAMAGED_ATTEMPTS: u32 = 2;

/// Bytes per write.
const WRITE: usize = 1 << 20;

/// Why an attempt failed.
enum Failed {
    Damaged(String),
    BrokenOff(object_store::Error),
    /// Further attempts would fail too.
    Finally(BlobError),
}

impl From<BlobError> for Failed {
    fn from(error: BlobError) -> Self {
        Self::Finally(error)
    }
}

impl Blobs {
    /// Fetches a blob into the file `to`, and creates its parent directories. An existing file
    /// stays in place until the whole blob is on disk and verified against its digest. Returns the
    /// stamp of the written file.
    ///
    /// # Errors
    /// [`BlobError::Missing`] if the blob does not exist, [`BlobError::Damaged`] if its content
    /// does not match its digest, [`BlobError::BrokenOff`] if every transfer breaks off,
    /// [`BlobError::Store`], [`BlobError::Digest`], or [`BlobError::Io`] if the file cannot be
    /// written.
    pub(crate) async fn fetch(&self, blob: &Blob, to: &Path) -> Result<Stamp> {
        expect_digest(&blob.digest)?;
        let (mut broken, mut damaged) = (0, 0);
        loop {
            match self.attempt(blob, to).await {
                Ok(stamp) => return Ok(stamp),
                Err(Failed::Finally(error)) => return Err(error),
                Err(Failed::Damaged(detail)) => {
                    damaged += 1;
                    if damaged == DAMAGED_ATTEMPTS {
                        let what = format!("blob {} in {}", blob.digest, self.location());
                        return Err(BlobError::Damaged { what, detail });
                    }
                }
                Err(Failed::BrokenOff(source)) => {
                    broken += 1;
                    if broken == ATTEMPTS {
                        return Err(BlobError::BrokenOff {
                            location: self.location().to_owned(),
                            digest: blob.digest.clone(),
                            attempts: ATTEMPTS,
                            source,
                        });
                    }
                    tracing::info!(%source, digest = blob.digest, "a blob broke off");
                    tokio::time::sleep(WAIT * (1 << (broken - 1))).await;
                }
            }
        }
    }

    async fn attempt(&self, blob: &Blob, to: &Path) -> Result<Stamp, Failed> {
        let got = match self.store().get(&self.key(&blob.digest)).await {
            Ok(got) => got,
            Err(object_store::Error::NotFound { .. }) => {
                let (digest, location) = (blob.digest.clone(), self.location().to_owned());
                return Err(BlobError::Missing { digest, location }.into());
            }
            Err(error) => return Err(self.failed("fetch a blob", error).into()),
        };
        if got.meta.size != blob.bytes {
            return Err(Failed::Damaged(lengths(got.meta.size, blob)));
        }
        let (target, limit) = (to.to_owned(), blob.bytes);
        let arriving = blocking(move || Arriving::beside(&target, limit)).await?;
        let arrived = match got.payload {
            GetResultPayload::File(file, _) => {
                blocking(move || arriving.take_all(file)).await.map_err(Failed::from)
            }
            GetResultPayload::Stream(stream) => take_stream(arriving, stream).await,
        }?;
        let got = Blob::named(arrived.hasher.finalize(), arrived.bytes);
        if got.bytes != blob.bytes {
            return Err(Failed::Damaged(lengths(got.bytes, blob)));
        }
        if got.digest != blob.digest {
            let detail = format!("its digest is {}", got.digest);
            return Err(Failed::Damaged(detail));
        }
        let target = to.to_owned();
        Ok(blocking(move || arrived.rename(&target)).await?)
    }
}

fn lengths(bytes: u64, blob: &Blob) -> String {
    if bytes > blob.bytes {
        return format!("it has more than its {} bytes", blob.bytes);
    }
    format!("it has {bytes} bytes instead of {}", blob.bytes)
}

async fn take_stream<B: AsRef<[u8]>>(
    mut arriving: Arriving,
    mut stream: BoxStream<'static, object_store::Result<B>>,
) -> Result<Arriving, Failed> {
    let mut buffer = Vec::with_capacity(WRITE);
    while let Some(chunk) = stream.next().await {
        buffer.extend_from_slice(chunk.map_err(Failed::BrokenOff)?.as_ref());
        if buffer.len() >= WRITE {
            (arriving, buffer) = blocking(move || arriving.take(buffer)).await?;
        }
        if arriving.bytes > arriving.limit {
            break;
        }
    }
    let (arriving, _) = blocking(move || arriving.take(buffer)).await?;
    Ok(arriving)
}

/// An incomplete file, removed unless it is renamed.
struct Arriving {
    file: File,
    path: PathBuf,
    renamed: bool,
    hasher: blake3::Hasher,
    bytes: u64,
    /// Expected bytes.
    limit: u64,
}

impl Arriving {
    fn beside(target: &Path, limit: u64) -> Result<Self> {
        let folder = match target.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        std::fs::create_dir_all(folder).map_err(BlobError::io(folder))?;
        let path = folder.join(format!("{UNFINISHED}{}", Uuid::now_v7()));
        let file = File::create_new(&path).map_err(BlobError::io(&path))?;
        Ok(Self { file, path, renamed: false, hasher: blake3::Hasher::new(), bytes: 0, limit })
    }

    /// Writes the buffer and returns it empty.
    fn take(mut self, mut buffer: Vec<u8>) -> Result<(Self, Vec<u8>)> {
        self.write(&buffer)?;
        buffer.clear();
        Ok((self, buffer))
    }

    fn take_all(mut self, mut source: File) -> Result<Self> {
        let mut buffer = vec![0; WRITE];
        loop {
            match source.read(&mut buffer) {
                Ok(0) => return Ok(self),
                Ok(read) => self.write(&buffer[..read])?,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(BlobError::io(&self.path)(error)),
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        let written = self.file.write_all(bytes);
        written.map_err(BlobError::io(&self.path))?;
        self.hasher.update(bytes);
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    fn rename(mut self, target: &Path) -> Result<Stamp> {
        self.file.sync_all().map_err(BlobError::io(&self.path))?;
        let metadata = self.file.metadata().map_err(BlobError::io(&self.path))?;
        std::fs::rename(&self.path, target).map_err(BlobError::io(target))?;
        self.renamed = true;
        Ok(Stamp::of(&metadata))
    }
}

impl Drop for Arriving {
    fn drop(&mut self) {
        if !self.renamed
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::warn!(%error, path = %self.path.display(), "an unfinished file remains");
        }
    }
}
