//! When content is sent, and when it is not.

use std::fs::{self, File};
use std::io::{Seek, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::server::{Fault, Server};
use super::{HOUR, age, directory, noise, object, older_than, set_age};
use crate::{Blob, BlobError};

const PATIENCE: Duration = Duration::from_secs(5);
const MIB: usize = 1 << 20;

#[tokio::test]
async fn an_existing_blob_is_not_sent_again() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    for (bytes, requests) in [(100, 1), (17 * MIB, 3)] {
        let before = server.count("PUT ");
        let blob = blobs.put_bytes(noise(2, bytes)).await.unwrap();
        assert_eq!(server.count("PUT ") - before, requests);
        let at = object(&server.objects(), &blob);
        set_age(&at, 11 * HOUR);
        blobs.put_bytes(noise(2, bytes)).await.unwrap();
        assert_eq!(server.count("PUT ") - before, requests);
        assert!(age(&at) > 10 * HOUR);
    }
}

#[tokio::test]
async fn a_blob_near_its_deletion_is_sent_again() {
    let (dir, blobs) = directory();
    let file = dir.path().join("file");
    for bytes in [100, 17 * MIB] {
        fs::write(&file, noise(3, bytes)).unwrap();
        let blob = blobs.put(&file).await.unwrap();
        let at = object(dir.path(), &blob);
        set_age(&at, 13 * HOUR);
        blobs.put(&file).await.unwrap();
        assert!(age(&at) < HOUR);
    }
}

#[tokio::test]
async fn an_object_of_the_wrong_size_is_replaced() {
    let (dir, blobs) = directory();
    let blob = blobs.put_bytes(b"right".to_vec()).await.unwrap();
    fs::write(object(dir.path(), &blob), "wrong one").unwrap();
    blobs.put_bytes(b"right".to_vec()).await.unwrap();
    assert_eq!(fs::read(object(dir.path(), &blob)).unwrap(), b"right");
}

#[tokio::test]
async fn only_regular_files_are_put() {
    let (dir, blobs) = directory();
    let error = blobs.put(dir.path()).await.unwrap_err();
    assert!(matches!(error, BlobError::Io { .. }), "{error}");
    let error = blobs.put(&dir.path().join("none")).await.unwrap_err();
    assert!(error.is_gone(), "{error}");
}

/// A file that is written to between its two readings.
#[tokio::test]
async fn a_changing_large_file_is_not_stored() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let dir = tempfile::tempdir().unwrap();
    // Changed inside, longer, shorter.
    for change in 0..3 {
        let path = dir.path().join("file");
        fs::write(&path, noise(4, 40 * MIB)).unwrap();
        let changed = path.clone();
        server.misbehave(move |request| {
            // When the upload begins, the digest is already known.
            if request.starts_with("POST ") && request.contains("?uploads") {
                let mut file = File::options().write(true).open(&changed).unwrap();
                match change {
                    0 => file.write_all(b"changed").unwrap(),
                    1 => file.set_len(41 << 20).unwrap(),
                    _ => file.set_len(17 << 20).unwrap(),
                }
            }
            Fault::None
        });
        let error = blobs.put(&path).await.unwrap_err();
        assert!(matches!(error, BlobError::Changed(_)), "{change}: {error}");
        let blob = Blob::of(&noise(4, 40 * MIB));
        assert!(!object(&server.objects(), &blob).exists(), "{change}");
        assert!(server.unfinished().is_empty(), "{change}");
        assert_eq!(server.count("DELETE "), change + 1);
    }
    assert_eq!(older_than(&blobs, Duration::ZERO).await, []);
}

/// Files that are written to all the time: no content may have a wrong digest.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_content_has_a_wrong_digest() {
    let (dir, blobs) = directory();
    let work = tempfile::tempdir().unwrap();
    let (mut kept, mut changed) = (0, 0);
    for bytes in [MIB, 18 * MIB] {
        let path = work.path().join(format!("file{bytes}"));
        fs::write(&path, noise(5, bytes)).unwrap();
        let stop = AtomicBool::new(false);
        let written = path.clone();
        let writing = || {
            let mut file = File::options().write(true).open(&written).unwrap();
            for turn in (0_u64..).take_while(|_| !stop.load(Ordering::Relaxed)) {
                file.seek(std::io::SeekFrom::Start(turn * 4096 % bytes as u64)).unwrap();
                file.write_all(&turn.to_le_bytes()).unwrap();
            }
        };
        let handle = tokio::runtime::Handle::current();
        std::thread::scope(|scope| {
            scope.spawn(writing);
            for _ in 0..20 {
                match tokio::task::block_in_place(|| handle.block_on(blobs.put(&path))) {
                    Ok(_) => kept += 1,
                    Err(BlobError::Changed(_)) => changed += 1,
                    Err(error) => panic!("{error}"),
                }
            }
            stop.store(true, Ordering::Relaxed);
        });
        // Once it is no longer written to, it is accepted.
        blobs.put(&path).await.unwrap();
    }
    assert!(changed > 0, "the files were never caught, but {kept} kept");
    for blob in older_than(&blobs, Duration::ZERO).await {
        let lies = fs::read(object(dir.path(), &blob)).unwrap();
        assert_eq!(Blob::of(&lies), blob);
    }
}
