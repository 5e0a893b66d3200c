//! The rule for blobs in the shared blob store that no row names.
//!
//! If two databases used one blob store, each would delete blobs that only the other names. Hence a
//! blob store carries the identity of the first database that used it, and refuses servers of any
//! other.

use std::collections::HashSet;
use std::time::Duration;

use fled_blobs::Blobs;

use crate::app::App;
use crate::error::{Result, ServerError};
use crate::store::Store;

/// How long a blob must have been unnamed before it is deleted.
const UNNAMED: Duration = super::DAY;

/// Digests per query.
const ASKED: usize = 500;

/// Applies the rule if there is a blob store.
pub(super) async fn follow(app: &App) -> Result<usize> {
    match app.blob_cache.blobs() {
        Some(blobs) => collect(&app.store, blobs).await,
        None => Ok(0),
    }
}

/// Deletes blobs that have not belonged to any file for a day, and remains of interrupted uploads
/// to the blob store. Returns their number. Does nothing while another process collects, since both
/// would list the whole store.
///
/// # Errors
/// As [`claim`].
async fn collect(store: &Store, blobs: &Blobs) -> Result<usize> {
    claim(store, blobs).await?;
    let Some(alone) = store.collecting().await? else {
        tracing::debug!("another process looks for blobs that no file has");
        return Ok(0);
    };
    let deleted = collect_all(store, blobs).await;
    alone.end().await;
    deleted
}

/// Checks that the blob store belongs to this database, and marks a store without an owner.
///
/// # Errors
/// [`ServerError::StoreOfAnother`] if it belongs to another; when the database or the blob store
/// fails.
pub async fn claim(store: &Store, blobs: &Blobs) -> Result<()> {
    match blobs.mark().await? {
        Some(mark) if store.is_known_as(&mark).await? => Ok(()),
        Some(_) => Err(ServerError::StoreOfAnother(blobs.location().to_owned())),
        None => Ok(blobs.set_mark(&store.identity().await?).await?),
    }
}

async fn collect_all(store: &Store, blobs: &Blobs) -> Result<usize> {
    let mut deleted = blobs.delete_unfinished(UNNAMED).await?;
    for first in 0..=u8::MAX {
        let old = blobs.older_than(first, UNNAMED).await?;
        for some in old.chunks(ASKED) {
            let digests: Vec<String> = some.iter().map(|blob| blob.digest.clone()).collect();
            let named: HashSet<String> = store.named(&digests).await?.into_iter().collect();
            for digest in digests.iter().filter(|digest| !named.contains(*digest)) {
                // The blob may have been put again since it was listed, and be named in a moment.
                deleted += usize::from(blobs.delete_older(digest, UNNAMED).await?);
            }
        }
    }
    Ok(deleted)
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::path::{Path, PathBuf};
    use std::time::SystemTime;

    use fled_blobs::{Blob, Kept};

    use super::*;
    use crate::store::tests::{keep_capture, of_a_server, of_each};

    const HOUR: Duration = Duration::from_secs(3600);

    struct Place {
        dir: tempfile::TempDir,
        blobs: Blobs,
    }

    impl Place {
        fn new() -> Self {
            let dir = tempfile::tempdir().expect("temporary directory");
            let blobs = Blobs::open(dir.path().to_str().expect("UTF-8")).expect("a store");
            Self { dir, blobs }
        }

        fn file(&self, blob: &Blob) -> PathBuf {
            let folder = self.dir.path().join("blobs").join(&blob.digest[..2]);
            folder.join(&blob.digest)
        }

        /// Puts a blob of this age.
        async fn put(&self, content: String, age: Duration) -> Blob {
            let blob = self.blobs.put_bytes(content.into_bytes()).await;
            let blob = blob.expect("put");
            set_age(&self.file(&blob), age);
            blob
        }
    }

    fn set_age(file: &Path, age: Duration) {
        let file = File::options().write(true).open(file).expect("is there");
        file.set_modified(SystemTime::now() - age).expect("set");
    }

    #[tokio::test]
    async fn only_old_unnamed_blobs_are_deleted() {
        for (_dir, store) in of_each().await {
            let place = Place::new();
            let mut stay = Vec::new();
            stay.push(place.put("named".to_owned(), 25 * HOUR).await);
            let kept = [Kept { path: "a.jpg".to_owned(), blob: stay[0].clone() }];
            keep_capture(&store, "c", None, &kept).await;
            let mut go = Vec::new();
            for number in 0..40 {
                stay.push(place.put(format!("young {number}"), 23 * HOUR).await);
                go.push(place.put(format!("old {number}"), 25 * HOUR).await);
            }
            // The remains of an interrupted upload.
            let part = format!("{}#1", stay[0].digest);
            let part = place.file(&stay[0]).with_file_name(part);
            std::fs::write(&part, "part").expect("written");
            set_age(&part, 25 * HOUR);
            assert_eq!(collect(&store, &place.blobs).await.expect("collected"), 41);
            assert!(stay.iter().all(|blob| place.file(blob).exists()));
            assert!(!go.iter().any(|blob| place.file(blob).exists()));
            assert!(!part.exists());
            assert_eq!(collect(&store, &place.blobs).await.expect("collected"), 0);
        }
    }

    #[tokio::test]
    async fn nothing_is_deleted_in_another_databases_store() {
        let [(_file, file), (_server, server)] = of_each().await;
        let place = Place::new();
        let blob = place.put("old".to_owned(), 25 * HOUR).await;
        for _ in 0..2 {
            claim(&file, &place.blobs).await.expect("unclaimed, or its own");
        }
        let refused = collect(&server, &place.blobs).await;
        assert!(matches!(refused, Err(ServerError::StoreOfAnother(_))), "{refused:?}");
        assert!(place.file(&blob).exists());
        assert_eq!(collect(&file, &place.blobs).await.expect("its own"), 1);
    }

    #[tokio::test]
    async fn only_one_of_two_processes_collects() {
        let (_dir, store) = of_a_server().await;
        let place = Place::new();
        let blob = place.put("old".to_owned(), 25 * HOUR).await;
        let collected = async || collect(&store, &place.blobs).await.expect("collected");
        let other = store.collecting().await.expect("asked").expect("free");
        assert_eq!(collected().await, 0, "the other one does it");
        assert!(place.file(&blob).exists());
        other.end().await;
        assert_eq!(collected().await, 1);
        // The turn was returned at the end.
        let other = store.collecting().await.expect("asked").expect("free");
        // A process that stops halfway does not block others: the database notices the lost
        // connection.
        drop(other);
        place.put("old".to_owned(), 25 * HOUR).await;
        let began = std::time::Instant::now();
        while collected().await == 0 {
            assert!(began.elapsed() < Duration::from_secs(10), "no other may collect");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}
