//! Deletes what the shared store of files has and no row names.
//!
//! Two databases that use one store, one of them a copy of the other for example, would each delete
//! what only the other names. So each look leaves its id in the store and finds there the id of the
//! last, which must have been this database's own. Else neither deletes any more, until somebody
//! says which of them the store belongs to. That holds as long as servers of both run: one that is
//! stopped cannot say that it is still there.

use std::collections::HashSet;
use std::time::Duration;

use fled_blobs::Blobs;
use uuid::Uuid;

use crate::error::{Result, ServerError};
use crate::store::Store;

/// Blobs that no file has had for so long are deleted.
const UNNAMED: Duration = Duration::from_secs(24 * 3600);

/// Digests that the database is asked about at once.
const ASKED: usize = 500;

/// What stands in a store in which nothing is deleted.
const DISPUTED: &str = "disputed";

/// Deletes blobs that no file has had for a day, and what uploads of blobs left that broke off.
/// Returns how many. Does nothing while another process does so: each would list the whole store
/// for what the other deletes.
///
/// # Errors
/// As [`claim`]; also when it turns out halfway.
pub async fn collect(store: &Store, blobs: &Blobs) -> Result<usize> {
    claim(store, blobs).await?;
    let Some(alone) = store.collecting().await? else {
        tracing::debug!("another process looks for blobs that no file has");
        return Ok(0);
    };
    let deleted = collect_all(store, blobs).await;
    alone.end().await;
    deleted
}

/// Sees that no other database deletes what is in the store, and says there that this one does.
///
/// # Errors
/// [`ServerError::Disputed`] where another does; when the database or the store refuses.
pub async fn claim(store: &Store, blobs: &Blobs) -> Result<()> {
    let mark = expect_own(store, blobs).await?;
    mark_as_own(store, blobs, mark.as_deref()).await
}

/// The mark in the store, which is this database's own or not there; another one is disputed.
async fn expect_own(store: &Store, blobs: &Blobs) -> Result<Option<String>> {
    let mark = blobs.mark().await?;
    if let Some(mark) = &mark
        && !store.has_collected(mark).await?
    {
        if mark != DISPUTED {
            blobs.set_mark(DISPUTED).await?;
        }
        return Err(ServerError::Disputed(blobs.location().to_owned()));
    }
    Ok(mark)
}

/// Says in the store that it belongs to this database, whatever stands there.
///
/// # Errors
/// When the database or the store refuses.
pub async fn own(store: &Store, blobs: &Blobs) -> Result<()> {
    let mark = blobs.mark().await?;
    mark_as_own(store, blobs, mark.as_deref()).await
}

async fn mark_as_own(store: &Store, blobs: &Blobs, found: Option<&str>) -> Result<()> {
    let id = Uuid::now_v7().to_string();
    // Here first: wherever this breaks off, and whoever else of this database does the same now,
    // what stands in the store is known here.
    store.note_collection(&id, found).await?;
    Ok(blobs.set_mark(&id).await?)
}

async fn collect_all(store: &Store, blobs: &Blobs) -> Result<usize> {
    let mut deleted = blobs.sweep_unfinished(UNNAMED).await?;
    for first in 0..=u8::MAX {
        // It takes as long as it takes, and another database may have begun meanwhile.
        expect_own(store, blobs).await?;
        let old = blobs.older_than(first, UNNAMED).await?;
        for some in old.chunks(ASKED) {
            let digests: Vec<String> = some.iter().map(|blob| blob.digest.clone()).collect();
            let named: HashSet<String> = store.named(&digests).await?.into_iter().collect();
            for digest in digests.iter().filter(|digest| !named.contains(*digest)) {
                // It may have been put again since it was listed, and is named in a moment.
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
    use serde_json::json;

    use super::*;
    use crate::store::CaptureRow;
    use crate::store::tests::{of_a_server, of_each};

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

        /// A blob that is so old.
        async fn put(&self, content: String, age: Duration) -> Blob {
            let blob = self
                .blobs
                .put_bytes(content.into_bytes())
                .await
                .expect("put");
            set_age(&self.file(&blob), age);
            blob
        }
    }

    fn set_age(file: &Path, age: Duration) {
        let file = File::options().write(true).open(file).expect("is there");
        file.set_modified(SystemTime::now() - age).expect("set");
    }

    #[tokio::test]
    async fn what_is_old_and_has_no_name_goes_and_nothing_else() {
        for (_dir, store) in of_each().await {
            let place = Place::new();
            let mut stay = Vec::new();
            for number in 0..3 {
                let named = place.put(format!("named {number}"), 25 * HOUR).await;
                stay.push(named);
            }
            let kept = |blob: &Blob| Kept {
                path: blob.digest.clone(),
                blob: blob.clone(),
            };
            let kept: Vec<Kept> = stay.iter().map(kept).collect();
            let capture = CaptureRow {
                id: "c".to_owned(),
                name: "a capture".to_owned(),
                accepted: 3,
                report: json!({}),
                created_at: 1,
                owner: None,
                expires_at: None,
            };
            store.insert_capture(&capture, &kept).await.expect("kept");
            let mut go = Vec::new();
            for number in 0..40 {
                stay.push(place.put(format!("young {number}"), 23 * HOUR).await);
                go.push(place.put(format!("old {number}"), 25 * HOUR).await);
            }
            // What an upload left that broke off.
            let part = place
                .file(&stay[0])
                .with_file_name(format!("{}#1", stay[0].digest));
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
    async fn of_two_databases_neither_deletes_what_the_other_names() {
        let [(_file, file), (_server, server)] = of_each().await;
        let place = Place::new();
        let old = async || place.put("old".to_owned(), 25 * HOUR).await;
        let blob = old().await;
        let is_there = || place.file(&blob).exists();
        let refused = async |store: &Store| {
            let refused = collect(store, &place.blobs).await;
            assert!(
                matches!(refused, Err(ServerError::Disputed(_))),
                "{refused:?}"
            );
        };
        // It knows its own marks, also of looks that did not come so far as to leave theirs.
        claim(&file, &place.blobs).await.expect("nobody's");
        for _ in 0..40 {
            let mark = place.blobs.mark().await.expect("read");
            let id = Uuid::now_v7().to_string();
            let noted = file.note_collection(&id, mark.as_deref()).await;
            noted.expect("noted");
        }
        claim(&file, &place.blobs).await.expect("its own");
        refused(&server).await;
        assert!(is_there());
        // The first learns of it, too.
        refused(&file).await;
        refused(&server).await;
        assert!(is_there());
        own(&server, &place.blobs).await.expect("said so");
        assert_eq!(collect(&server, &place.blobs).await.expect("its own"), 1);
        assert!(!is_there());
        old().await;
        refused(&file).await;
        refused(&server).await;
        assert!(is_there());
    }

    #[tokio::test]
    async fn a_copy_of_a_database_is_another_database() {
        let (dir, store) = crate::store::tests::in_a_file().await;
        let place = Place::new();
        let blob = place.put("old".to_owned(), 25 * HOUR).await;
        claim(&store, &place.blobs).await.expect("nobody's");
        store.close().await;
        let [first, copy] = ["fled.db", "copy.db"].map(|name| dir.path().join(name));
        std::fs::copy(&first, &copy).expect("copied");
        let [first, copy] = [Store::open(&first).await, Store::open(&copy).await];
        let [first, copy] = [first.expect("open"), copy.expect("open")];
        // Whoever looks second sees that the other did.
        for [one, other] in [[&first, &copy], [&copy, &first]] {
            own(&first, &place.blobs).await.expect("said so");
            let mark = place.blobs.mark().await.expect("read").expect("a mark");
            if !copy.has_collected(&mark).await.expect("asked") {
                copy.note_collection(&mark, None).await.expect("copied");
            }
            claim(one, &place.blobs).await.expect("as far as it knows");
            for store in [other, one] {
                let refused = collect(store, &place.blobs).await;
                assert!(
                    matches!(refused, Err(ServerError::Disputed(_))),
                    "{refused:?}"
                );
            }
            // Also one that is in the middle of it.
            let refused = collect_all(one, &place.blobs).await;
            assert!(
                matches!(refused, Err(ServerError::Disputed(_))),
                "{refused:?}"
            );
            assert!(place.file(&blob).exists());
        }
    }

    #[tokio::test]
    async fn of_two_processes_one_collects() {
        let (_dir, store) = of_a_server().await;
        let place = Place::new();
        let blob = place.put("old".to_owned(), 25 * HOUR).await;
        let collected = async || collect(&store, &place.blobs).await.expect("collected");
        let other = store.collecting().await.expect("asked").expect("free");
        assert_eq!(collected().await, 0, "the other one does it");
        assert!(place.file(&blob).exists());
        other.end().await;
        assert_eq!(collected().await, 1);
        // Given back at its end.
        let other = store.collecting().await.expect("asked").expect("free");
        // One that breaks off halfway holds nobody up: the database sees its connection go.
        drop(other);
        place.put("old".to_owned(), 25 * HOUR).await;
        let began = std::time::Instant::now();
        while collected().await == 0 {
            assert!(
                began.elapsed() < Duration::from_secs(10),
                "nobody may collect"
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}
