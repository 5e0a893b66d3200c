//! Servers that are slow, break off, or do not exist.

use std::fs;
use std::time::{Duration, Instant};

use super::server::{Fault, Server};
use super::{names, noise, object, older_than};
use crate::{BlobError, Blobs};

const PATIENCE: Duration = Duration::from_secs(20);
const MIB: usize = 1 << 20;

/// At this size, every attempt to fetch meets one fault.
const SIZE: usize = 3 * MIB;

#[tokio::test]
async fn refused_requests_are_retried() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    let data = noise(8, 17 * MIB);
    for begin in ["HEAD ", "POST ", "PUT ", "GET "] {
        server.misbehave_first(3, begin, Fault::Status(503));
        let blob = blobs.put_bytes(data.clone()).await.unwrap();
        blobs.fetch(&blob, &to).await.unwrap();
        assert!(server.count(begin) > 3);
        assert!(fs::read(&to).unwrap() == data);
        blobs.delete(&blob.digest).await.unwrap();
    }
}

#[tokio::test]
async fn a_cut_transfer_is_resumed() {
    let server = Server::start();
    let blob = server.blobs(PATIENCE).put_bytes(noise(9, SIZE)).await;
    let (blob, blobs) = (blob.unwrap(), server.hasty_blobs(PATIENCE));
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    for fault in [Fault::CutAfter(MIB), Fault::StallAfter(MIB)] {
        let before = server.count("GET ");
        server.misbehave_first(1, "GET ", fault);
        blobs.fetch(&blob, &to).await.unwrap();
        assert!(fs::read(&to).unwrap() == noise(9, SIZE));
        assert_eq!(server.count("GET ") - before, 2);
    }
}

#[tokio::test]
async fn a_broken_transfer_is_restarted() {
    let server = Server::start();
    let blob = server.blobs(PATIENCE).put_bytes(noise(10, SIZE)).await;
    // With zero patience, `object_store` does not resume.
    let (blob, blobs) = (blob.unwrap(), server.hasty_blobs(Duration::ZERO));
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    for fault in [Fault::CutAfter(SIZE - 1), Fault::StallAfter(1)] {
        let before = server.count("GET ");
        server.misbehave_first(2, "GET ", fault);
        let began = Instant::now();
        blobs.fetch(&blob, &to).await.unwrap();
        assert!(began.elapsed() < Duration::from_secs(20));
        assert!(fs::read(&to).unwrap() == noise(10, SIZE));
        assert_eq!(server.count("GET ") - before, 3);
    }
}

#[tokio::test]
async fn a_failed_transfer_leaves_no_file() {
    let server = Server::start();
    let blobs = server.blobs(Duration::ZERO);
    let blob = blobs.put_bytes(noise(11, SIZE)).await.unwrap();
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    fs::write(&to, "before").unwrap();
    server.misbehave_first(100, "GET ", Fault::CutAfter(2 * MIB));
    let error = blobs.fetch(&blob, &to).await.unwrap_err();
    assert!(matches!(error, BlobError::BrokenOff { attempts: 4, .. }), "{error}");
    assert!(error.to_string().contains("broke off 4 times"), "{error}");
    assert_eq!(fs::read(&to).unwrap(), b"before");
    assert_eq!(names(work.path()), ["to"]);
}

#[tokio::test]
async fn a_cancelled_fetch_leaves_no_file() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let blob = blobs.put_bytes(noise(12, SIZE)).await.unwrap();
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    server.misbehave_first(100, "GET ", Fault::StallAfter(2 * MIB));
    let mut fetching = Box::pin(blobs.fetch(&blob, &to));
    let wait = Duration::from_millis(500);
    tokio::time::timeout(wait, &mut fetching).await.unwrap_err();
    assert_eq!(names(work.path()).len(), 1);
    drop(fetching);
    assert!(names(work.path()).is_empty());
}

#[tokio::test]
async fn a_refused_part_aborts_the_upload() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    server.misbehave(|request| {
        if request.starts_with("PUT ") && request.contains("partNumber=3") {
            Fault::Status(403)
        } else {
            Fault::None
        }
    });
    let error = blobs.put_bytes(noise(13, 40 * MIB)).await.unwrap_err();
    assert!(matches!(error, BlobError::Store { .. }), "{error}");
    assert!(error.to_string().contains("403"), "{error}");
    // A part in flight may still arrive and stay: only the request to abort is certain.
    assert_eq!(server.count("DELETE "), 1);
    assert_eq!(older_than(&blobs, Duration::ZERO).await, []);
}

#[tokio::test]
async fn slow_answers_are_waited_for() {
    let server = Server::start();
    let blobs = server.hasty_blobs(PATIENCE);
    let work = tempfile::tempdir().unwrap();
    let to = work.path().join("to");
    // Within the allowed stall, a second here, and beyond it.
    for wait in [Duration::from_millis(600), Duration::from_millis(1_500)] {
        server.misbehave_first(1, "PUT ", Fault::Late(wait));
        let blob = blobs.put_bytes(noise(wait.as_millis() as u64, 1000)).await;
        let blob = blob.unwrap();
        assert_eq!(object(&server.objects(), &blob).metadata().unwrap().len(), blob.bytes);
        server.misbehave_first(1, "GET ", Fault::Late(wait));
        blobs.fetch(&blob, &to).await.unwrap();
    }
}

#[tokio::test]
async fn a_missing_server_is_reported() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    drop(listener);
    let settings = [
        ("AWS_ENDPOINT", address.as_str()),
        ("AWS_ALLOW_HTTP", "true"),
        ("AWS_ACCESS_KEY_ID", "name"),
        ("AWS_SECRET_ACCESS_KEY", "password"),
    ];
    let settings = settings.map(|(name, value)| (name.to_owned(), value.to_owned()));
    let patience = Duration::from_secs(2);
    let blobs = Blobs::bucket("bucket", settings, patience).unwrap();
    let began = Instant::now();
    let error = blobs.check().await.unwrap_err();
    assert!(matches!(error, BlobError::Store { .. }), "{error}");
    assert!(began.elapsed() > patience / 2 && began.elapsed() < 6 * patience);
    assert!(error.to_string().contains("check that it can be reached"), "{error}");
    assert!(!error.to_string().contains("password"), "{error}");
}

#[tokio::test]
async fn a_silent_server_is_not_ready() {
    let server = Server::start();
    let blobs = server.blobs(Duration::from_secs(60));
    server.misbehave(|_| Fault::Late(Duration::from_secs(60)));
    let began = Instant::now();
    let error = blobs.check().await.unwrap_err();
    assert!(matches!(error, BlobError::NotReady { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_secs(15));
}

#[tokio::test]
async fn wrong_credentials_and_buckets_are_reported() {
    let server = Server::start();
    let wrong = [("AWS_SECRET_ACCESS_KEY", "wrong password")];
    let stranger = server.blobs_with("bucket", &wrong, PATIENCE);
    // This server creates a bucket on the first write: only listing shows that it did not exist.
    let nowhere = server.blobs_with("nowhere", &[], PATIENCE);
    for (blobs, error) in [
        (&stranger, stranger.check().await.unwrap_err()),
        (&stranger, stranger.put_bytes(vec![1]).await.unwrap_err()),
        (&stranger, stranger.older_than(0, Duration::ZERO).await.unwrap_err()),
        (&nowhere, nowhere.older_than(0, Duration::ZERO).await.unwrap_err()),
    ] {
        assert!(matches!(error, BlobError::Store { .. }), "{error}");
        assert!(error.to_string().contains(blobs.location()), "{error}");
        assert!(!error.to_string().contains("password"), "{error}");
    }
}
