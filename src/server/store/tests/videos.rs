// Tests of videos as jobs, included once per database.

const VIDEO_ROOM: VideoRoom = VideoRoom {
    of_job: 3,
    unfinished: 4,
};

async fn film(store: &Store, id: &str, job: &str) -> VideoCreation {
    let made = store.create_video(id, job, &json!({ "kind": "orbit" }), VIDEO_ROOM).await;
    made.expect("asked")
}

/// The lease that a slot of this kind gets.
async fn next(store: &Store, kind: JobKind) -> Option<Lease> {
    let claim = store.claim_fit(kind, "w/0", 60_000, &[], Machine::ANY).await;
    claim.expect("asked").map(|claim| claim.lease)
}

#[tokio::test]
async fn videos_and_scenes_are_claimed_separately_and_in_order() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    for id in ["v1", "v2", "v3"] {
        assert_eq!(film(&store, id, "j").await, VideoCreation::Created);
    }
    assert_eq!(film(&store, "v4", "j").await, VideoCreation::JobFull(3));
    assert_eq!(film(&store, "v4", "none").await, VideoCreation::Gone);
    assert_eq!(film(&store, "v4", "v1").await, VideoCreation::Gone, "of a video");
    create(&store, "k").await;
    assert_eq!(film(&store, "w1", "k").await, VideoCreation::Created);
    assert_eq!(film(&store, "w2", "k").await, VideoCreation::QueueFull);

    let first = next(&store, JobKind::Video).await.expect("a video");
    assert_eq!(first.job, "v1");
    assert_eq!(next(&store, JobKind::Scene).await.expect("a scene").job, "j");
    assert_eq!(next(&store, JobKind::Scene).await.expect("a scene").job, "k");
    assert_eq!(next(&store, JobKind::Scene).await, None);
    let ahead = async |id| store.video("j", id).await.expect("read").expect("there").ahead;
    assert_eq!((ahead("v1").await, ahead("v2").await, ahead("v3").await), (None, Some(1), Some(2)));
    assert!(store.delete_video("j", "v2").await.expect("deleted"));
    assert_eq!(ahead("v3").await, Some(1));
    store.settle(&first, &Settlement::Filmed { bytes: 7 }).await.expect("settled");
    let shown = store.videos("j").await.expect("read");
    let shown = shown.iter().map(|video| (video.job.id.as_str(), video.job.state, video.bytes));
    let expected = [("v3", JobState::Queued, None), ("v1", JobState::Succeeded, Some(7))];
    assert_eq!(shown.collect::<Vec<_>>(), expected);
    assert_eq!(ahead("v3").await, Some(0));
    assert_eq!(store.video("k", "v3").await.expect("read"), None);
}

#[tokio::test]
async fn deleting_a_job_deletes_its_video_and_ends_the_lease() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    film(&store, "v", "j").await;
    let lease = next(&store, JobKind::Video).await.expect("a video");
    assert!(store.delete_job("j").await.expect("deleted"));
    let heard = store.heartbeat(&lease, 60_000).await;
    assert!(matches!(heard, Err(ServerError::LeaseLost(_))), "{heard:?}");
    assert!(store.ids("jobs").await.expect("read").is_empty());
}

#[tokio::test]
async fn a_video_is_not_counted_as_a_job_and_outlives_its_worker() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    store.request_cancel("j").await.expect("cancelled");
    film(&store, "v", "j").await;
    assert_eq!(store.job("v").await.expect("read"), None);
    assert_eq!(store.job_details("v").await.expect("read"), None);
    assert_eq!(store.jobs(JobFilter::default(), 9, None).await.expect("read").len(), 1);
    assert_eq!(store.waiting().await.expect("read"), 0);
    let counts = store.jobs_by_state().await.expect("read");
    assert_eq!(counts.iter().map(|(_, count)| count).sum::<i64>(), 1);
    next(&store, JobKind::Video).await.expect("a video");
    let left = store.release_all(|_| failed(Some(0))).await.expect("released");
    assert_eq!(left, ["v"]);
    assert_eq!(next(&store, JobKind::Video).await.expect("again").job, "v");
}
