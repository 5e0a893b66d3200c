mod clocks;

use std::collections::BTreeMap;

use fled_blobs::Kept;
use fled_core::event::{Event, Stage};
use fled_core::metrics::{ChosenDetail, DetailLevel};
use proptest::prelude::*;
use serde_json::json;

use super::engine::CONNECTIONS;
use super::*;
use crate::error::ServerError;
use crate::store::state::{JobState, Transition};

/// A database file, and the guard that removes it.
pub(crate) async fn in_a_file() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().expect("temporary directory");
    let store = Store::open(&dir.path().join("fled.db")).await.expect("fresh database");
    (dir, store)
}

/// Holds the lock of writers until dropped.
pub(crate) async fn lock(store: &Store) -> impl Sized + use<> {
    store.write().await.expect("the lock of writers")
}

/// A database on a server.
pub(crate) async fn of_a_server() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().expect("temporary directory");
    let url = fled_tests::Postgres::shared().database();
    (dir, Store::at(&url).await.expect("fresh database"))
}

/// One database of each engine.
pub(crate) async fn of_each() -> [(tempfile::TempDir, Store); 2] {
    [in_a_file().await, of_a_server().await]
}

async fn store() -> (tempfile::TempDir, Store) {
    with_capture(in_a_file().await).await
}

async fn with_capture(fresh: (tempfile::TempDir, Store)) -> (tempfile::TempDir, Store) {
    let (dir, store) = fresh;
    keep_capture(&store, "c", None, &[]).await;
    (dir, store)
}

/// Stores a capture of an owner.
pub(crate) async fn keep_capture(store: &Store, id: &str, owner: Option<&str>, files: &[Kept]) {
    let capture = CaptureRow {
        id: id.to_owned(),
        name: id.to_owned(),
        accepted: 3,
        report: json!({}),
        created_at: now_ms(),
        owner: owner.map(str::to_owned),
        expires_at: None,
    };
    store.insert_capture(&capture, files).await.expect("kept");
}

pub(crate) fn room(queue: u32) -> Room<'static> {
    Room { queue, of_owner: None }
}

/// A job of the capture `c`.
pub(crate) fn new_job(id: &str) -> NewJob {
    NewJob {
        id: id.to_owned(),
        name: id.to_owned(),
        capture_id: "c".to_owned(),
        preset: "preview".to_owned(),
        options: json!({}),
        rounds: 2,
        needs: Needs::default(),
        priority: 0,
    }
}

pub(crate) async fn create(store: &Store, id: &str) {
    let outcome = store.create_job(&new_job(id), None, "", room(100)).await.expect("create");
    assert!(matches!(outcome, Creation::Created(_)));
}

fn failed(retry_in_ms: Option<i64>) -> Settlement {
    let error = JobError { code: "internal".into(), detail: "d".into(), hint: "h".into() };
    Settlement::Failed { error, retry_in_ms, failures: 1 }
}

/// Tests that every database must pass.
mod sqlite {
    use super::*;

    async fn store() -> (tempfile::TempDir, Store) {
        with_capture(in_a_file().await).await
    }

    include!("tests/suite.rs");
    include!("tests/machines.rs");
    include!("tests/videos.rs");
}

mod postgres {
    use super::*;

    async fn store() -> (tempfile::TempDir, Store) {
        with_capture(of_a_server().await).await
    }

    include!("tests/suite.rs");
    include!("tests/machines.rs");
    include!("tests/videos.rs");
}

#[tokio::test]
async fn deleting_a_capture_waits_for_the_creation_of_its_job() {
    let (_dir, store) = with_capture(of_a_server().await).await;
    // A job has been created but not committed.
    let mut tx = store.write().await.expect("begun");
    jobs::insert(&mut tx, &new_job("j")).await.expect("made");
    let (deleting, copy) = (store.clone(), store.clone());
    let deleted = tokio::spawn(async move { deleting.delete_capture("c").await });
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    assert!(!deleted.is_finished(), "it waits for the job");
    tx.commit().await.expect("true");
    assert!(!deleted.await.expect("ended").expect("answered"));
    assert!(store.delete_job("j").await.expect("deleted"));
    // The other way round.
    let mut tx = store.begin().await.expect("begun");
    sqlx::query("DELETE FROM captures WHERE id = 'c'").execute(&mut *tx).await.expect("deleted");
    let made = tokio::spawn(async move {
        let made = copy.create_job(&new_job("k"), None, "", room(9)).await;
        made.map(drop)
    });
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    assert!(!made.is_finished(), "it waits for the capture");
    tx.commit().await.expect("true");
    let refused = made.await.expect("ended").expect_err("no capture");
    assert!(refused.is_of_a_name(), "{refused}");
}

/// Limits the database to `pages` pages on every connection of the pool.
async fn allow_pages(store: &Store, pages: u32) {
    let mut all = Vec::new();
    for _ in 0..CONNECTIONS {
        let mut connection = store.pool.acquire().await.expect("a connection");
        let limit = format!("PRAGMA max_page_count = {pages}");
        sqlx::query(sqlx::AssertSqlSafe(limit)).execute(&mut *connection).await.expect("a limit");
        all.push(connection);
    }
}

#[tokio::test]
async fn a_full_disk_disables_no_connection() {
    let (_dir, store) = store().await;
    create(&store, "waits").await;
    // SQLite fails at this page as on a full disk: it rolls back by itself.
    allow_pages(&store, 1).await;
    let large = NewJob { options: json!({ "deblur": "x".repeat(1 << 20) }), ..new_job("large") };
    let refused = store.create_job(&large, None, "", room(100)).await;
    assert!(refused.is_err(), "1 MiB into no free page");
    // On every connection; a replaced one has no limit, and a job's id is used only once.
    for _ in 0..CONNECTIONS {
        drop(store.create_job(&large, None, "", room(100)).await);
    }
    allow_pages(&store, 1 << 20).await;
    for _ in 0..CONNECTIONS + 2 {
        store.check().await.expect("the database can be written");
    }
    create(&store, "after").await;
    let claim = store.claim("one", 60_000, &[]).await.expect("claim");
    let claim = claim.expect("the job that waits");
    let step = Progress { progress: Some(0.5), ..Default::default() };
    store.advance(&claim.lease, &step).await.expect("advance");
    // On other connections, to show that it was not a savepoint of an open transaction.
    for _ in 0..CONNECTIONS {
        let job = store.job("waits").await.expect("read").expect("job");
        assert_eq!(job.progress, 0.5);
    }
}
