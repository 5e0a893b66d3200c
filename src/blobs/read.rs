//! Handing bytes on, to who compares them with their digest.

use std::fs::File;
use std::io::{self, Read};
use std::time::Duration;

use bytes::Bytes;
use futures::stream::{self, BoxStream};
use futures::{StreamExt, TryStreamExt};
use object_store::{GetResultPayload, ObjectStoreExt};

use crate::blob::{blocking, expect_digest};
use crate::error::Result;
use crate::store::{Blobs, age_of};

/// Bytes that are read at once.
const READ: usize = 256 << 10;

/// What the store says of a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// How many bytes it has.
    pub bytes: u64,
    /// How long ago it was written.
    pub age: Duration,
}

/// Bytes of a blob, piece by piece.
pub type Pieces = BoxStream<'static, io::Result<Bytes>>;

impl Blobs {
    /// What the store says of a blob, if it is there.
    ///
    /// # Errors
    /// [`crate::BlobError::Digest`] or [`crate::BlobError::Store`].
    pub async fn find(&self, digest: &str) -> Result<Option<Found>> {
        expect_digest(digest)?;
        let found = self.look(digest).await?;
        Ok(found.map(|object| Found {
            bytes: object.size,
            age: age_of(&object),
        }))
    }

    /// The bytes of a blob as the store has them, if it is there: nobody has compared them with
    /// its digest.
    ///
    /// # Errors
    /// [`crate::BlobError::Digest`] or [`crate::BlobError::Store`].
    pub async fn read(&self, digest: &str) -> Result<Option<(Found, Pieces)>> {
        expect_digest(digest)?;
        let got = match self.store().get(&self.key(digest)).await {
            Ok(got) => got,
            Err(object_store::Error::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(self.failed("read a blob", error)),
        };
        let found = Found {
            bytes: got.meta.size,
            age: age_of(&got.meta),
        };
        let pieces = match got.payload {
            GetResultPayload::File(file, _) => stream::try_unfold(file, next).boxed(),
            GetResultPayload::Stream(stream) => stream.map_err(io::Error::from).boxed(),
        };
        Ok(Some((found, pieces)))
    }
}

async fn next(mut file: File) -> io::Result<Option<(Bytes, File)>> {
    let read = blocking(move || {
        let mut piece = vec![0; READ];
        let read = file.read(&mut piece);
        Ok(read.map(|read| {
            piece.truncate(read);
            (read > 0).then(|| (Bytes::from(piece), file))
        }))
    });
    read.await
        .unwrap_or_else(|error| Err(io::Error::other(error)))
}
