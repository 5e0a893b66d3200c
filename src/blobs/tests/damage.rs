//! Objects that were changed externally.

use std::fs;
use std::path::Path;

use super::server::{Fault, Server};
use super::{directory, names, noise, object};
use crate::{Blob, BlobError, Blobs};

const PATIENCE: std::time::Duration = std::time::Duration::from_secs(5);

/// Expects that a damaged blob is refused and an existing file stays.
async fn expect_refused(blobs: &Blobs, blob: &Blob) {
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    let error = blobs.fetch(blob, &to).await.unwrap_err();
    assert!(matches!(error, BlobError::Damaged { .. }), "{error}");
    assert!(error.to_string().contains(&blob.digest), "{error}");
    assert!(names(work.path()).is_empty());
    fs::write(&to, "before").unwrap();
    blobs.fetch(blob, &to).await.unwrap_err();
    assert_eq!(fs::read(&to).unwrap(), b"before");
    assert_eq!(names(work.path()), ["to"]);
}

async fn damage(blobs: &Blobs, objects: &Path) {
    let whole = noise(6, 3 << 20);
    let blob = blobs.put_bytes(whole.clone()).await.unwrap();
    let at = object(objects, &blob);
    let mut flipped = whole.clone();
    flipped[2 << 20] ^= 1;
    let mut longer = whole.clone();
    longer.push(0);
    for damaged in [&flipped[..], &whole[..1 << 20], &longer, b""] {
        fs::write(&at, damaged).unwrap();
        expect_refused(blobs, &blob).await;
    }
    fs::write(&at, &whole).unwrap();
    let work = tempfile::tempdir().unwrap();
    blobs.fetch(&blob, &work.path().join("to")).await.unwrap();
    let mistaken = Blob { bytes: blob.bytes - 1, ..blob };
    expect_refused(blobs, &mistaken).await;
}

#[tokio::test]
async fn damaged_blobs_in_a_directory_are_refused() {
    let (dir, blobs) = directory();
    damage(&blobs, dir.path()).await;
}

#[tokio::test]
async fn damaged_blobs_in_a_bucket_are_refused() {
    let server = Server::start();
    damage(&server.blobs(PATIENCE), &server.objects()).await;
}

#[tokio::test]
async fn a_blob_damaged_in_transit_is_fetched_again_once() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let blob = blobs.put_bytes(noise(7, 2 << 20)).await.unwrap();
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    for fault in [Fault::Flip, Fault::ShortenTo(1 << 20)] {
        server.misbehave_first(1, "GET ", fault);
        blobs.fetch(&blob, &to).await.unwrap();
        assert!(fs::read(&to).unwrap() == noise(7, 2 << 20));
        server.misbehave_first(usize::MAX, "GET ", fault);
        let before = server.count("GET ");
        expect_refused(&blobs, &blob).await;
        // Two fetches, each attempted twice.
        assert_eq!(server.count("GET ") - before, 4);
    }
}
