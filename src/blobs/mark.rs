//! The mark of a store, which names its owner.

use object_store::{ObjectStoreExt, PutPayload};

use crate::error::Result;
use crate::store::Blobs;

/// Maximum bytes read; a longer mark is not one of ours.
const LONGEST: usize = 200;

impl Blobs {
    /// Returns the mark last written by [`Blobs::set_mark`], if any.
    ///
    /// # Errors
    /// [`BlobError::Store`](crate::BlobError::Store) if it cannot be read.
    pub async fn mark(&self) -> Result<Option<String>> {
        let failed = |error| self.failed("read the mark", error);
        let got = match self.store().get(&self.below("mark")).await {
            Err(object_store::Error::NotFound { .. }) => return Ok(None),
            got => got.map_err(failed)?,
        };
        let bytes = got.bytes().await.map_err(failed)?;
        let words = bytes.get(..LONGEST).unwrap_or(&bytes);
        Ok(Some(String::from_utf8_lossy(words).into_owned()))
    }

    /// Writes a mark of up to 200 bytes, replacing an existing one.
    ///
    /// # Errors
    /// [`BlobError::Store`](crate::BlobError::Store) if it cannot be written.
    pub async fn set_mark(&self, mark: &str) -> Result<()> {
        let words = PutPayload::from(mark.to_owned());
        let put = self.store().put(&self.below("mark"), words).await;
        put.map_err(|error| self.failed("write the mark", error))?;
        Ok(())
    }
}
