//! Leases and the time of day.

use std::time::Duration;

use super::{create, store};
use crate::store::clock::step;

const HOUR_MS: i64 = 3_600_000;

#[tokio::test]
async fn a_job_running_here_is_not_taken_over() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let claim = store.claim("one", -1, &[]).await.expect("claim");
    let claim = claim.expect("the job");
    let running = ["j".to_owned()];
    let stolen = store.claim("two", -1, &running).await.expect("claim");
    assert!(stolen.is_none(), "its lease has run out, but it runs");
    store.heartbeat(&claim.lease, 60_000).await.expect("it goes on");
}

#[tokio::test]
async fn setting_the_clock_forward_ends_no_lease() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let claim = store.claim("one", 30_000, &[]).await.expect("claim");
    let claim = claim.expect("the job");
    step(HOUR_MS);
    // The other worker does not know yet that the first one runs the job.
    let stolen = store.claim("two", 30_000, &[]).await.expect("claim");
    assert!(stolen.is_none(), "taken from who has it");
    store.heartbeat(&claim.lease, 30_000).await.expect("it goes on");
}

#[tokio::test]
async fn setting_the_clock_back_keeps_no_expired_lease() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let dropped = store.claim("one", 1, &[]).await.expect("claim");
    dropped.expect("the job");
    step(-HOUR_MS);
    tokio::time::sleep(Duration::from_millis(20)).await;
    let taken = store.claim("two", 30_000, &[]).await.expect("claim");
    assert_eq!(taken.expect("its lease has run out").lease.epoch, 2);
}
