//! The common behaviour of both kinds of store, and their locations.

use std::fs;
use std::path::Path;
use std::time::Duration;

use super::server::Server;
use super::{HOUR, age, directory, names, noise, object, older_than, set_age};
use crate::{Blob, BlobError, Blobs};

const PATIENCE: Duration = Duration::from_secs(5);

/// Puts a file of this size, and fetches it to another path.
async fn round_trip(blobs: &Blobs, bytes: usize) {
    let work = tempfile::tempdir().unwrap();
    let written = noise(bytes as u64, bytes);
    let from = work.path().join("from");
    fs::write(&from, &written).unwrap();
    let blob = blobs.put(&from).await.unwrap();
    assert_eq!(blob, Blob::of(&written));
    let to = work.path().join("new/folders/to");
    blobs.fetch(&blob, &to).await.unwrap();
    assert!(fs::read(&to).unwrap() == written, "{bytes} bytes differ");
    assert_eq!(names(to.parent().unwrap()), ["to"]);
}

/// Runs a test on both kinds of store, with the folder of their objects.
async fn each_kind(test: impl AsyncFn(Blobs, &Path)) {
    let (dir, blobs) = directory();
    test(blobs, dir.path()).await;
    let server = Server::start();
    test(server.blobs(PATIENCE), &server.objects()).await;
}

#[tokio::test]
async fn fetched_files_equal_the_stored_ones() {
    each_kind(async |blobs, _| {
        // Empty, small, around one chunk, and around the largest size that fits into one request.
        for bytes in [0, 1, (1 << 20) - 1, 1 << 20, 16 << 20, (16 << 20) + 1] {
            round_trip(&blobs, bytes).await;
        }
    })
    .await;
}

#[tokio::test]
async fn large_files_are_sent_in_parts() {
    let (_dir, blobs) = directory();
    round_trip(&blobs, 40 << 20).await;
    let server = Server::start();
    round_trip(&server.blobs(PATIENCE), 40 << 20).await;
    assert_eq!(server.count("POST "), 2);
    assert_eq!(server.count("PUT "), 5);
    assert!(server.unfinished().is_empty());
}

#[tokio::test]
async fn the_last_written_mark_is_read() {
    each_kind(async |blobs, _| {
        assert_eq!(blobs.mark().await.unwrap(), None);
        for mark in ["one", "another"] {
            blobs.set_mark(mark).await.unwrap();
            assert_eq!(blobs.mark().await.unwrap().as_deref(), Some(mark));
        }
        // The mark is neither a blob nor the remains of an upload.
        assert_eq!(older_than(&blobs, Duration::ZERO).await, []);
        assert!(blobs.is_empty().await.unwrap());
        assert_eq!(blobs.delete_unfinished(Duration::ZERO).await.unwrap(), 0);
        assert_eq!(blobs.mark().await.unwrap().as_deref(), Some("another"));
        blobs.put_bytes(b"one".to_vec()).await.unwrap();
        assert!(!blobs.is_empty().await.unwrap());
    })
    .await;
}

#[tokio::test]
async fn bytes_are_stored_like_files() {
    each_kind(async |blobs, objects| {
        for bytes in [0, 5, 20 << 20] {
            let blob = blobs.put_bytes(noise(1, bytes)).await.unwrap();
            assert_eq!(blob, Blob::of(&noise(1, bytes)));
            let kept = fs::read(object(objects, &blob)).unwrap();
            assert!(kept == noise(1, bytes), "{bytes} bytes differ");
        }
    })
    .await;
}

#[tokio::test]
async fn only_old_blobs_are_listed() {
    each_kind(async |blobs, objects| {
        assert_eq!(older_than(&blobs, Duration::ZERO).await, []);
        let old = blobs.put_bytes(b"old".to_vec()).await.unwrap();
        let new = blobs.put_bytes(b"new".to_vec()).await.unwrap();
        set_age(&object(objects, &old), 25 * HOUR);
        set_age(&object(objects, &new), 23 * HOUR);
        // Neither is a blob: a name that is not a digest, and a digest in the wrong folder.
        let folder = object(objects, &old);
        let folder = folder.parent().unwrap();
        for stray in [folder.join("notes"), folder.join("0".repeat(64))] {
            fs::write(&stray, "stray").unwrap();
            set_age(&stray, 25 * HOUR);
        }
        assert_eq!(older_than(&blobs, 24 * HOUR).await, std::slice::from_ref(&old));
        let mut all = older_than(&blobs, 22 * HOUR).await;
        all.sort();
        let mut both = [old, new];
        both.sort();
        assert_eq!(all, both);
    })
    .await;
}

#[tokio::test]
async fn old_blobs_are_listed_by_prefix() {
    each_kind(async |blobs, objects| {
        let mut old = Vec::new();
        for seed in 0..200 {
            let blob = blobs.put_bytes(noise(seed, 9)).await.unwrap();
            if seed % 4 > 0 {
                set_age(&object(objects, &blob), 25 * HOUR);
                old.push(blob);
            }
        }
        let mut found = Vec::new();
        for first in 0..=u8::MAX {
            let some = blobs.older_than(first, 24 * HOUR).await.unwrap();
            let begins = format!("{first:02x}");
            let fits = |blob: &Blob| blob.digest.starts_with(&begins);
            assert!(some.iter().all(fits), "{some:?} for {begins}");
            found.extend(some);
        }
        found.sort();
        old.sort();
        assert_eq!(found, old, "all that are old, once, and no other");
    })
    .await;
}

#[tokio::test]
async fn a_deleted_blob_is_missing() {
    each_kind(async |blobs, objects| {
        let blob = blobs.put_bytes(b"gone".to_vec()).await.unwrap();
        blobs.delete(&blob.digest).await.unwrap();
        assert!(!object(objects, &blob).exists());
        blobs.delete(&blob.digest).await.unwrap();
        let work = tempfile::tempdir().unwrap();
        let fetched = blobs.fetch(&blob, &work.path().join("to")).await;
        let error = fetched.unwrap_err();
        assert!(matches!(error, BlobError::Missing { .. }), "{error}");
        assert!(names(work.path()).is_empty());
    })
    .await;
}

#[tokio::test]
async fn a_blob_that_was_put_again_is_not_deleted() {
    each_kind(async |blobs, objects| {
        let blob = blobs.put_bytes(b"wanted".to_vec()).await.unwrap();
        let at = object(objects, &blob);
        assert!(!blobs.delete_older(&blob.digest, 24 * HOUR).await.unwrap());
        assert!(at.exists());
        set_age(&at, 25 * HOUR);
        assert!(blobs.delete_older(&blob.digest, 24 * HOUR).await.unwrap());
        assert!(!at.exists());
        assert!(!blobs.delete_older(&blob.digest, 24 * HOUR).await.unwrap());
    })
    .await;
}

#[tokio::test]
async fn a_probe_leaves_nothing() {
    each_kind(async |blobs, objects| {
        blobs.check().await.unwrap();
        blobs.check().await.unwrap();
        assert!(names(&objects.join("probes")).is_empty());
    })
    .await;
}

#[tokio::test]
async fn anything_but_a_digest_is_refused() {
    let (dir, blobs) = directory();
    fs::create_dir_all(dir.path().join("blobs")).unwrap();
    fs::write(dir.path().join("secret"), "secret").unwrap();
    let upper = "A".repeat(64);
    let long = "a".repeat(65);
    let path = format!("..{}", "/../secret".repeat(7).split_at(62).0);
    for digest in ["", "ab", "../../secret", &upper, &long, &path, "é"] {
        let blob = Blob { digest: digest.to_owned(), bytes: 6 };
        let work = tempfile::tempdir().unwrap();
        let fetched = blobs.fetch(&blob, &work.path().join("to")).await;
        assert!(matches!(fetched, Err(BlobError::Digest(_))), "{digest:?}");
        let deleted = blobs.delete(digest).await;
        assert!(matches!(deleted, Err(BlobError::Digest(_))), "{digest:?}");
        let deleted = blobs.delete_older(digest, Duration::ZERO).await;
        assert!(matches!(deleted, Err(BlobError::Digest(_))), "{digest:?}");
    }
    assert!(dir.path().join("secret").exists());
}

#[test]
fn locations_are_parsed() {
    let dir = tempfile::tempdir().unwrap();
    let new = dir.path().join("a/b");
    let blobs = Blobs::open(&format!("file://{}", new.display())).unwrap();
    assert!(new.is_dir());
    let canonical = new.canonicalize().unwrap();
    assert_eq!(blobs.location(), canonical.to_str().unwrap());
    let bucket = Blobs::open("s3://bucket/a/b/").unwrap();
    assert_eq!(bucket.location(), "s3://bucket/a/b");
    assert_eq!(Blobs::open("s3://bucket").unwrap().location(), "s3://bucket");
    let refused = [
        "",
        "  ",
        "s3://",
        "s3:///a",
        "s3://bucket/../other",
        "s3://name:password@bucket/a",
        "https://name:password@host/a",
        "file://relative",
    ];
    for location in refused {
        let error = Blobs::open(location).unwrap_err();
        assert!(matches!(error, BlobError::Location(_)), "{location:?}");
        assert!(!error.to_string().contains("password"), "{error}");
    }
}

#[tokio::test]
async fn remains_of_uploads_to_a_directory_are_deleted() {
    let (dir, blobs) = directory();
    let blob = blobs.put_bytes(b"whole".to_vec()).await.unwrap();
    let whole = object(dir.path(), &blob);
    let old = whole.with_file_name(format!("{}#1", blob.digest));
    let new = whole.with_file_name(format!("{}#2", blob.digest));
    for file in [&old, &new] {
        fs::write(file, "part").unwrap();
    }
    set_age(&whole, 25 * HOUR);
    set_age(&old, 25 * HOUR);
    assert_eq!(older_than(&blobs, Duration::ZERO).await, [blob]);
    assert_eq!(blobs.delete_unfinished(24 * HOUR).await.unwrap(), 1);
    assert!(whole.exists() && new.exists() && !old.exists());
    assert!(age(&whole) > 24 * HOUR);
    let (_dir, fresh) = directory();
    assert_eq!(fresh.delete_unfinished(Duration::ZERO).await.unwrap(), 0);
}
