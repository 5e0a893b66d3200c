// Tests for every database, included once per database.

#[tokio::test]
async fn a_worker_that_lost_its_lease_writes_nothing() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let old = store
        .claim("one", -1, &[])
        .await
        .expect("claim")
        .expect("job");
    let new = store
        .claim("two", 60_000, &[])
        .await
        .expect("claim")
        .expect("its lease has run out");
    assert_eq!(new.job.attempts, 2);
    let before = store.events_after("j", 0, 100).await.expect("events");
    let event = Event::StageStarted {
        stage: Stage::Poses,
        round: 0,
    };
    let lost = |r: Result<()>| assert!(matches!(r, Err(ServerError::LeaseLost(_))), "{r:?}");
    lost(store.record(&old.lease, &event).await);
    lost(store.advance(&old.lease, &Progress::default()).await);
    lost(
        store
            .settle(&old.lease, &Settlement::Stopped)
            .await
            .map(drop),
    );
    lost(store.heartbeat(&old.lease, 1000).await.map(drop));
    assert_eq!(
        store.events_after("j", 0, 100).await.expect("events"),
        before
    );
    assert_eq!(
        store.job("j").await.expect("read").expect("job").state,
        JobState::Running
    );
    store
        .record(&new.lease, &event)
        .await
        .expect("the new lease writes");
}

#[tokio::test]
async fn two_workers_never_claim_one_job_and_the_oldest_goes_first() {
    let (_dir, store) = store().await;
    let mut expected = Vec::new();
    for i in 0..20 {
        create(&store, &format!("j{i:02}")).await;
        expected.push(format!("j{i:02}"));
    }
    let mut claims = tokio::task::JoinSet::new();
    for worker in 0..4 {
        let store = store.clone();
        claims.spawn(async move {
            let mut mine = Vec::new();
            while let Some(claim) = store
                .claim(&worker.to_string(), 60_000, &[])
                .await
                .expect("claim")
            {
                mine.push(claim.job.id);
            }
            mine
        });
    }
    let all = claims.join_all().await;
    assert!(
        all.iter().all(|mine| mine.is_sorted()),
        "oldest first: {all:?}"
    );
    let mut all: Vec<String> = all.into_iter().flatten().collect();
    all.sort();
    assert_eq!(all, expected);
}

#[tokio::test]
async fn a_restart_requeues_running_jobs_and_finishes_cancellations() {
    let (_dir, store) = store().await;
    create(&store, "a").await;
    create(&store, "b").await;
    let a = store
        .claim("one", 60_000, &[])
        .await
        .expect("claim")
        .expect("a");
    store
        .claim("one", 60_000, &[])
        .await
        .expect("claim")
        .expect("b");
    store.request_cancel("b").await.expect("cancel");
    assert_eq!(
        store
            .release_all(|_| Settlement::Released)
            .await
            .expect("release"),
        ["a", "b"]
    );
    assert_eq!(
        store.job("a").await.expect("read").expect("a").state,
        JobState::Queued
    );
    assert_eq!(
        store.job("b").await.expect("read").expect("b").state,
        JobState::Cancelled
    );
    assert!(
        store.settle(&a.lease, &Settlement::Stopped).await.is_err(),
        "the old worker is fenced off"
    );
}

#[tokio::test]
async fn a_key_creates_one_job_and_refuses_another_request() {
    let (_dir, store) = store().await;
    let create = |id: &'static str, print: &'static str| {
        let store = store.clone();
        async move {
            store
                .create_job(&new_job(id), Some("key"), print, room(100))
                .await
                .expect("create")
        }
    };
    assert!(matches!(create("a", "x").await, Creation::Created(job) if job.id == "a"));
    assert!(matches!(create("b", "x").await, Creation::Replayed(job) if job.id == "a"));
    assert!(matches!(create("c", "y").await, Creation::KeyReused));
    assert_eq!(
        store
            .jobs(JobFilter::default(), 10, None)
            .await
            .expect("list")
            .len(),
        1
    );
}

#[tokio::test]
async fn progress_resets_the_count_of_failures() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    for (progress, expected) in [(0.0, 1), (0.0, 2), (0.4, 1), (0.4, 2), (0.4, 3)] {
        let claim = store
            .claim("one", 60_000, &[])
            .await
            .expect("claim")
            .expect("job");
        let step = Progress {
            progress: Some(progress),
            ..Default::default()
        };
        store.advance(&claim.lease, &step).await.expect("advance");
        let failures = store.count_failure(&claim.lease).await.expect("count");
        assert_eq!(failures, expected, "at {progress}");
        let Settlement::Failed { error, .. } = failed(None) else {
            unreachable!()
        };
        let settlement = Settlement::Failed {
            error,
            retry_in_ms: Some(-1),
            failures,
        };
        assert_eq!(
            store
                .settle(&claim.lease, &settlement)
                .await
                .expect("settle"),
            JobState::Queued
        );
    }
}

#[tokio::test]
async fn an_unknown_time_left_replaces_a_known_one() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let claim = store.claim("one", 60_000, &[]).await.expect("claim");
    let lease = claim.expect("job").lease;
    for (progress, eta_seconds, expected) in [
        (Some(0.1), Some(60.0), Some(60.0)),
        // Only the stage advances.
        (None, None, Some(60.0)),
        (Some(0.2), None, None),
    ] {
        let step = Progress {
            progress,
            eta_seconds,
            ..Default::default()
        };
        store.advance(&lease, &step).await.expect("advance");
        let job = store.job("j").await.expect("read").expect("job");
        assert_eq!(job.eta_seconds, expected);
    }
}

#[tokio::test]
async fn a_time_left_runs_out_while_nothing_is_reported() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    let claim = store.claim("one", 60_000, &[]).await.expect("claim");
    let lease = claim.expect("job").lease;
    let left = async || {
        store
            .job_details("j")
            .await
            .expect("read")
            .expect("job")
            .row
            .eta_seconds
    };
    for (estimate, is_left) in [(60.0, true), (0.2, false)] {
        let step = Progress {
            progress: Some(0.1),
            eta_seconds: Some(estimate),
            ..Default::default()
        };
        store.advance(&lease, &step).await.expect("advance");
        tokio::time::sleep(std::time::Duration::from_millis(300)).await;
        let left = left().await;
        assert_eq!(left.is_some(), is_left, "{left:?}");
        assert!(left.is_none_or(|left| left < estimate - 0.2), "{left:?}");
    }
}

#[tokio::test]
async fn deleting_a_job_deletes_its_rows_but_a_used_capture_stays() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    assert!(!store.delete_capture("c").await.expect("refused"));
    let claim = store
        .claim("one", 60_000, &[])
        .await
        .expect("claim")
        .expect("job");
    assert!(!store.delete_job("j").await.expect("a running job stays"));
    store
        .settle(&claim.lease, &Settlement::Finished { best_round: 2 })
        .await
        .expect("settle");
    assert!(store.delete_job("j").await.expect("delete"));
    assert!(
        store
            .events_after("j", 0, 10)
            .await
            .expect("events")
            .is_empty()
    );
    // A listing of its files that began earlier may end after the deletion.
    let file = ("scene.ply", 3, 7);
    store.remember_digest("j", file, "d").await.expect("no fault");
    assert_eq!(store.digest("j", "scene.ply", 3, 7).await.expect("read"), None);
    assert!(store.delete_capture("c").await.expect("free now"));
}

/// Applies `transition` through the store as a worker and the API would. The stored state must
/// match that of the pure function.
async fn drive(store: &Store, leases: &mut BTreeMap<&str, Lease>, transition: Transition) {
    let settle = |settlement| {
        let (store, lease) = (store.clone(), leases.get("j").cloned());
        async move {
            if let Some(lease) = lease {
                drop(store.settle(&lease, &settlement).await);
            }
        }
    };
    match transition {
        // A negative lease expires at once, so that `Claimed` can happen to a running job.
        Transition::Claimed => {
            if let Some(claim) = store.claim("w", -1, &[]).await.expect("claim") {
                leases.insert("j", claim.lease);
            }
        }
        Transition::Released => settle(Settlement::Released).await,
        Transition::Finished => settle(Settlement::Finished { best_round: 1 }).await,
        Transition::Failed { retry } => settle(failed(retry.then_some(-1))).await,
        Transition::Stopped => settle(Settlement::Stopped).await,
        Transition::CancelRequested => drop(store.request_cancel("j").await.expect("cancel")),
        Transition::Retried => drop(store.retry("j", room(9), None).await.expect("retry")),
        Transition::Changed => {
            let other = Change {
                options: json!({}),
                rounds: 1,
                needs: Needs::default(),
            };
            store
                .retry("j", room(9), Some(&other))
                .await
                .expect("retry");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn the_database_follows_the_state_machine(
        transitions in proptest::collection::vec(state::any_transition(), 1..16),
    ) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
        runtime.block_on(async {
            let (_dir, store) = store().await;
            create(&store, "j").await;
            let (mut model, mut leases) = (JobState::Queued, BTreeMap::new());
            for transition in transitions {
                drive(&store, &mut leases, transition).await;
                model = model.after(transition).unwrap_or(model);
                let stored = store.job("j").await.expect("read").expect("job").state;
                assert_eq!(stored, model, "after {transition:?}");
            }
        });
    }
}

#[tokio::test]
async fn the_queue_refuses_jobs_beyond_its_limit() {
    let (_dir, store) = store().await;
    for (id, expected) in [("a", true), ("b", true), ("c", false)] {
        let outcome = store.create_job(&new_job(id), None, "", room(2)).await;
        let created = matches!(outcome.expect("answered"), Creation::Created(_));
        assert_eq!(created, expected, "{id}");
    }
    assert_eq!(store.waiting().await.expect("count"), 2);
}

#[tokio::test]
async fn progress_resets_the_count_of_server_deaths() {
    let (_dir, store) = store().await;
    create(&store, "j").await;
    for (progress, expected) in [(0.0, 1), (0.0, 2), (0.5, 1), (0.5, 2)] {
        let claim = store.claim("one", 60_000, &[]).await.expect("claim");
        let step = Progress {
            progress: Some(progress),
            ..Default::default()
        };
        let lease = claim.expect("the job").lease;
        store.advance(&lease, &step).await.expect("advance");
        let settle = |deaths| {
            assert_eq!(deaths, expected, "at {progress}");
            let Settlement::Failed { error, .. } = failed(None) else {
                unreachable!()
            };
            Settlement::Failed {
                error,
                retry_in_ms: Some(-1),
                failures: deaths,
            }
        };
        store.release_all(settle).await.expect("released");
    }
}

#[tokio::test]
async fn a_job_knows_its_queue_position_and_when_its_stage_began() {
    let (_dir, store) = store().await;
    for id in ["a", "b", "c"] {
        create(&store, id).await;
    }
    let claim = store.claim("w", 60_000, &[]).await.expect("claim");
    let lease = claim.expect("job").lease;
    let job = async |id| store.job_details(id).await.expect("read").expect("job");
    let places = [job("a").await, job("b").await, job("c").await];
    assert_eq!(places.map(|j| j.queue_position), [None, Some(1), Some(2)]);
    let (stage, round) = (Stage::Poses, 0);
    let began = Event::StageStarted { stage, round };
    store.record(&lease, &began).await.expect("record");
    let at = job("a").await.stage_started_at;
    assert!(at.is_some_and(|at| at <= now_ms()));
    let settled = store.settle(&lease, &Settlement::Released).await;
    settled.expect("settle");
    store.claim("w", 60_000, &[]).await.expect("claim");
    // The new attempt has not begun a stage.
    assert_eq!(job("a").await.stage_started_at, None);
}

#[tokio::test]
async fn a_job_keeps_the_detail_that_its_machine_chose() {
    let (_dir, store) = store().await;
    create(&store, "a").await;
    let detail = async || store.job("a").await.expect("read").expect("job").detail;
    assert_eq!(detail().await, None);
    // The next attempt may run on another machine.
    for level in [DetailLevel::High, DetailLevel::Standard] {
        let lease = store.claim("w", 60_000, &[]).await.expect("claim").expect("job").lease;
        let chosen = ChosenDetail { level, because: "of its memory".to_owned() };
        let event = Event::DetailChosen { detail: chosen.clone() };
        store.record(&lease, &event).await.expect("record");
        assert_eq!(detail().await, Some(chosen));
        store.settle(&lease, &Settlement::Released).await.expect("settle");
    }
    // A retry may have other options, and a job without files begins anew.
    store.request_cancel("a").await.expect("cancel");
    store.retry("a", room(9), None).await.expect("retry");
    assert_eq!(detail().await, None);
    let lease = store.claim("w", 60_000, &[]).await.expect("claim").expect("job").lease;
    let because = "of its memory".to_owned();
    let detail_chosen = ChosenDetail { level: DetailLevel::High, because };
    let event = Event::DetailChosen { detail: detail_chosen };
    store.record(&lease, &event).await.expect("record");
    assert!(store.begin_anew("a").await.expect("queued") && detail().await.is_none());
}
