// Tests of databases shared by several machines, included once per database.

#[tokio::test]
async fn a_repeated_report_is_applied_once() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let claim = store.claim("w", 60_000, &[]).await.expect("claim");
    let lease = claim.expect("job").lease;
    let warning = Event::Warning {
        code: "dark".to_owned(),
        message: "dark".to_owned(),
    };
    // Like `report`: the first transaction commits, but its answer is lost.
    let mut before = None;
    let report = report::Report::Event(&warning);
    store.report_once(&lease, report, &mut before).await.expect("reported");
    store.report_once(&lease, report, &mut before).await.expect("known");
    let events = store.events_after("j", 0, 9).await.expect("events");
    assert_eq!(events.iter().filter(|event| event.kind == "warning").count(), 1);
    let settled = store.settle(&lease, &Settlement::Finished { best_round: 1 }).await;
    assert_eq!(settled.expect("settled"), JobState::Succeeded);
    let again = store.settle(&lease, &Settlement::Finished { best_round: 1 }).await;
    assert_eq!(again.expect("known"), JobState::Succeeded);
    let events = store.events_after("j", 0, 9).await.expect("events");
    assert_eq!(events.last().map(|event| event.seq), Some(4), "{events:?}");
}

#[tokio::test]
async fn jobs_wait_for_a_fitting_machine_and_owners_take_turns() {
    let (_dir, store) = store().await;
    for owner in ["anna", "ben"] {
        keep_capture(&store, owner, Some(owner), &[]).await;
    }
    let job = |id: &str, capture: &str, gpu, priority| NewJob {
        capture_id: capture.to_owned(),
        needs: Needs { gpu, memory: 1000 },
        priority,
        ..new_job(id)
    };
    for job in [
        job("a1", "anna", true, 0),
        job("a2", "anna", false, 0),
        job("a3", "anna", false, 0),
        job("b1", "ben", false, 0),
        job("b2", "ben", false, 1),
    ] {
        let made = store.create_job(&job, None, "", room(9)).await;
        assert!(matches!(made.expect("made"), Creation::Created(_)));
    }
    let take = async |has_gpu, memory| {
        let machine = Machine { has_gpu, memory };
        let claim = store.claim_fit(JobKind::Scene, "w", 60_000, &[], machine).await;
        claim.expect("claim").map(|claim| claim.job.id)
    };
    assert_eq!(take(true, 999).await, None, "too little memory");
    assert_eq!(take(false, 1000).await.as_deref(), Some("b2"), "it has priority");
    assert_eq!(take(false, 1000).await.as_deref(), Some("a2"), "none of hers runs");
    assert_eq!(take(false, 1000).await.as_deref(), Some("a3"), "older than b1");
    assert_eq!(take(true, 1000).await.as_deref(), Some("b1"), "more of hers run");
    assert_eq!(take(false, 1000).await, None, "it wants a GPU");
    assert_eq!(take(true, 1000).await.as_deref(), Some("a1"));
}

#[tokio::test]
async fn only_the_lease_holder_names_files_until_the_job_is_deleted() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let file = |path: &str, digest: &str| Kept {
        path: path.to_owned(),
        blob: fled_blobs::Blob {
            digest: digest.repeat(64),
            bytes: 5,
        },
    };
    let old = store.claim("w", -1, &[]).await.expect("claim").expect("job").lease;
    store.keep_files(&old, &[file("output/a", "1")], &[]).await.expect("kept");
    let new = store.claim("v", 60_000, &[]).await.expect("claim").expect("job").lease;
    let late = store.keep_files(&old, &[file("output/a", "2")], &[]).await;
    assert!(matches!(late, Err(ServerError::LeaseLost(_))), "{late:?}");
    let files = async || store.job_files("j").await.expect("read").expect("is there");
    assert_eq!(files().await, (1, vec![file("output/a", "1")]));
    let kept = [file("output/b", "3"), file("output/c", "1")];
    store.keep_files(&new, &kept, &["output/a".to_owned()]).await.expect("kept");
    assert_eq!(files().await.0, 2);
    let named = store.named(&["1", "2", "3"].map(|digit| digit.repeat(64))).await;
    let mut named = named.expect("answered");
    named.sort();
    assert_eq!(named, ["1".repeat(64), "3".repeat(64)]);
    store.settle(&new, &Settlement::Stopped).await.expect("settled");
    assert!(store.delete_job("j").await.expect("deleted"));
    let named = store.named(&["1".repeat(64)]).await;
    assert!(named.expect("answered").is_empty());
}

#[tokio::test]
async fn only_the_leases_of_the_restarted_worker_are_released() {
    let (_dir, store) = store().await;
    for id in ["a", "b"] {
        create(&store, id).await;
    }
    let dead = store.claim("one/0", -1, &[]).await.expect("claim").expect("job").lease;
    let lives = store.claim("two/0", 60_000, &["a".to_owned()]).await.expect("claim");
    let lives = lives.expect("job").lease;
    tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    let of = store.release_of("three", |_| failed(None)).await.expect("none");
    assert!(of.is_empty());
    let late = store.release_of("two", |deaths| {
        assert_eq!(deaths, 1);
        failed(Some(0))
    });
    assert_eq!(late.await.expect("released"), ["b"]);
    assert!(matches!(store.heartbeat(&lives, 9).await, Err(ServerError::LeaseLost(_))));
    assert!(matches!(store.heartbeat(&dead, -1).await, Ok(false)), "no worker has it yet");
}

#[tokio::test]
async fn workers_are_listed_with_their_jobs_until_they_leave() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let about = About {
        host: "machine".to_owned(),
        cores: 4,
        ..About::default()
    };
    for (id, draining) in [("one", false), ("two", false), ("one", true)] {
        store.see_worker(id, &about, draining).await.expect("seen");
    }
    store.claim("one/0", 60_000, &[]).await.expect("claim").expect("job");
    let workers = store.workers().await.expect("workers");
    let listed = workers.iter().map(|w| (w.id.as_str(), w.draining, w.running.len()));
    let listed: Vec<_> = listed.collect();
    assert_eq!(listed, [("one", true, 1), ("two", false, 0)]);
    assert_eq!(workers[0].about, about);
    store.forget_workers(Some("two"), 0).await.expect("gone");
    assert_eq!(store.workers().await.expect("workers").len(), 1);
}
