//! Views and videos that a replica, which works on nothing, lets workers make: by the database and
//! by HTTP, and what may happen to who makes them.

mod support;

use std::path::Path;
use std::time::{Duration, Instant};

use fled_tests::{Client, Reply};
use serde_json::{Value, json};
use support::Server;
use support::farm::{Farm, Machine, PATIENCE, about, begin, order};

/// Says who has rendered a picture.
const BY: &str = "fled-rendered-by";

/// A job that has ended well.
fn result(api: &Client) -> String {
    let job = order(api, "ok");
    api.wait_state(&job, "succeeded");
    job
}

fn view(api: &Client, job: &str, azimuth: u32) -> Reply {
    let path = format!("/v1/jobs/{job}/render?azimuth={azimuth}&format=png");
    api.get(&path, &[]).expect(200)
}

/// Orders a video of so many pictures a second, which say what becomes of it; its address.
fn film(api: &Client, job: &str, fps: u32, seconds: f64) -> String {
    let order = json!({ "kind": "orbit", "fps": fps, "seconds": seconds, "width": 128 });
    let videos = format!("/v1/jobs/{job}/videos");
    let made = api.post_json(&videos, &order, &[]).expect(202);
    made.header("location").to_owned()
}

fn wait(api: &Client, path: &str, what: &str, is: impl Fn(&Value) -> bool) -> Value {
    let begun = Instant::now();
    loop {
        let shown = api.get(path, &[]).expect(200).json();
        if is(&shown) {
            return shown;
        }
        assert!(begun.elapsed() < PATIENCE, "not {what}: {shown:#}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn ended(api: &Client, video: &str) -> Value {
    let over = |shown: &Value| shown["state"] == "succeeded" || shown["state"] == "failed";
    wait(api, video, "over", over)
}

fn under_way(api: &Client, video: &str) -> Value {
    wait(api, video, "under way", |shown| {
        shown["progress"].as_f64().is_some_and(|done| done > 0.01) && shown["state"] == "running"
    })
}

/// What a worker makes besides jobs lies here meanwhile.
fn makes(worker: &Machine) -> usize {
    let folder = worker.folder.join("data/errands");
    std::fs::read_dir(folder).map_or(0, Iterator::count)
}

/// The same picture as a server's that works alone, without a second copy of the scene here.
fn is_made_by_workers(api: &Client, worker: &Machine) {
    let alone = Server::start();
    let calm = alone.job("ok");
    alone.wait_state(&calm, "succeeded");
    let job = result(api);
    let first = view(api, &job, 30);
    assert_eq!(first.header(BY), "worker");
    assert!(
        first.body == view(&alone, &calm, 30).body,
        "another picture"
    );
    // It is kept where it was asked for.
    assert!(view(api, &job, 30).body == first.body);
    let scenes = worker.folder.join("data/scenes").join(&job);
    assert!(scenes.join("output/scene.ply").is_file());

    let video = film(api, &job, 10, 1.0);
    let shown = ended(api, &video);
    assert_eq!(shown["state"], "succeeded", "{shown:#}");
    assert_eq!(shown["made_by"], "worker");
    let file = api.get(&format!("{video}/file"), &[]).expect(200);
    assert_eq!(&file.body[4..8], b"ftyp");
    // One that a worker cannot make the replica tries itself, and says why it cannot be made.
    let shown = ended(api, &film(api, &job, 7, 1.0));
    assert_eq!(
        (&shown["state"], &shown["made_by"]),
        (&json!("failed"), &json!("server"))
    );
    let detail = shown["error"]["detail"].as_str().expect("words");
    assert!(
        detail.contains("planned") && !detail.contains('/'),
        "{detail}"
    );
    assert_eq!(makes(worker), 0, "what was made is in the store");
}

#[test]
fn workers_by_the_database_make_views_and_videos() {
    let farm = Farm::new();
    let (_api, api) = farm.replica("api");
    let worker = farm.worker("worker");
    is_made_by_workers(&api, &worker);
}

/// A service with a file for a database, and a worker that reaches it by HTTP.
fn far(root: &Path) -> (Machine, Client, Machine) {
    let store = root.join("store");
    let store = store.to_str().expect("UTF-8");
    let more = [("FLED_FAKE_STORE", store), ("FLED_FAKE_WORKERS", "0")];
    let (service, base) = begin(root, "api", &more);
    let told = about("far");
    let worker = [
        ("FLED_FAKE_WORKER", "1"),
        ("FLED_FAKE_WORKERS", "1"),
        ("FLED_FAKE_ABOUT", told.as_str()),
        ("FLED_FAKE_API", base.as_str()),
    ];
    let worker = begin(root, "far", &worker).0;
    (service, Client::new(base, PATIENCE), worker)
}

#[test]
fn workers_by_http_make_views_and_videos() {
    let root = tempfile::tempdir().expect("temporary directory");
    let (_service, api, worker) = far(root.path());
    is_made_by_workers(&api, &worker);
    // A question reaches a worker that waits for one, and not at its next look.
    let job = result(&api);
    view(&api, &job, 1);
    let mut waits: Vec<Duration> = (2..12)
        .map(|azimuth| {
            let begun = Instant::now();
            assert_eq!(view(&api, &job, azimuth).header(BY), "worker");
            begun.elapsed()
        })
        .collect();
    waits.sort();
    assert!(waits[5] < Duration::from_millis(350), "{waits:?}");
}

#[test]
fn who_takes_nothing_up_is_not_waited_for_and_not_asked_again_for_a_while() {
    let farm = Farm::new();
    let (_api, api) = farm.replica("api");
    let first = farm.worker("first");
    let job = result(&api);
    first.signal("-STOP");
    let begun = Instant::now();
    assert_eq!(view(&api, &job, 10).header(BY), "server");
    let waited = begun.elapsed();
    let patience = Duration::from_millis(500)..Duration::from_secs(6);
    assert!(patience.contains(&waited), "{waited:?}");
    let waits = [20, 21, 22].map(|azimuth| {
        let begun = Instant::now();
        assert_eq!(view(&api, &job, azimuth).header(BY), "server");
        begun.elapsed()
    });
    // One may meet a machine that is busy; who asked in vain would wait each time.
    let least = waits.iter().min().expect("three");
    assert!(*least < Duration::from_millis(500), "{waits:?}");
    // Another is.
    let _second = farm.worker("second");
    wait(&api, "/v1/workers", "seen", |shown| {
        shown["workers"].as_array().map(Vec::len) == Some(2)
    });
    assert_eq!(view(&api, &job, 30).header(BY), "worker");
    first.signal("-CONT");
}

#[test]
fn a_video_outlives_its_worker_and_ends_with_who_wants_it() {
    let farm = Farm::new();
    let (_api, api) = farm.replica("api");
    let mut worker = farm.worker("worker");
    let job = result(&api);
    // 5 a second take a tenth of a second each.
    let video = film(&api, &job, 5, 4.0);
    under_way(&api, &video);
    worker.kill();
    let shown = ended(&api, &video);
    assert_eq!(
        (&shown["state"], &shown["made_by"]),
        (&json!("succeeded"), &json!("server"))
    );

    let worker = farm.worker("worker");
    let begun = Instant::now();
    let video = loop {
        let video = film(&api, &job, 5, 30.0);
        under_way(&api, &video);
        if makes(&worker) == 1 {
            break video;
        }
        // It is not asked as long as it is taken for lost.
        api.delete(&video).expect(204);
        assert!(begun.elapsed() < PATIENCE, "it is never asked again");
        std::thread::sleep(Duration::from_millis(500));
    };
    api.delete(&video).expect(204);
    stops(&worker);
}

/// Waits until a worker makes nothing any more, long before all pictures are there.
fn stops(worker: &Machine) {
    let begun = Instant::now();
    while makes(worker) > 0 {
        assert!(
            begun.elapsed() < Duration::from_secs(10),
            "it is still made"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_replica_that_dies_leaves_nothing_to_be_made() {
    let farm = Farm::new();
    let (mut replica, api) = farm.replica("api");
    let worker = farm.worker("worker");
    let job = result(&api);
    let video = film(&api, &job, 5, 60.0);
    under_way(&api, &video);
    // Longer than it may be silent: it says that it waits.
    std::thread::sleep(Duration::from_secs(5));
    assert_eq!(makes(&worker), 1);
    replica.kill();
    stops(&worker);
    // Begun again, it does not wait for what it asked before.
    let (_replica, api) = farm.replica("api");
    under_way(&api, &video);
    assert_eq!(makes(&worker), 1);
}

#[test]
fn a_service_that_dies_leaves_nothing_to_be_made() {
    let root = tempfile::tempdir().expect("temporary directory");
    let (mut service, api, worker) = far(root.path());
    let job = result(&api);
    under_way(&api, &film(&api, &job, 5, 60.0));
    assert_eq!(makes(&worker), 1);
    service.kill();
    stops(&worker);
}

#[test]
fn a_video_is_shown_by_every_replica_and_deleted_by_any() {
    let farm = Farm::new();
    let (_one, one) = farm.replica("one");
    let (_two, two) = farm.replica("two");
    let _worker = farm.worker("worker");
    let job = result(&one);
    let video = film(&one, &job, 10, 1.0);
    let shown = ended(&one, &video);
    assert_eq!(shown["state"], "succeeded", "{shown:#}");
    let file = format!("{video}/file");
    let begun = Instant::now();
    // It is named a moment after it is finished.
    while two.get(&video, &[]).status == 404 {
        assert!(begun.elapsed() < Duration::from_secs(5), "never seen");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(two.get(&video, &[]).expect(200).json(), shown);
    let at_two = two.get(&file, &[]).expect(200).body;
    assert!(at_two == one.get(&file, &[]).expect(200).body);
    two.delete(&video).expect(204);
    two.get(&video, &[]).expect(404);
    let (_three, three) = farm.replica("three");
    three.get(&file, &[]).expect(404);
}

#[test]
fn workers_keep_nothing_alive_that_is_kept_no_longer() {
    let farm = Farm::new();
    let (api, at) = farm.replica("api");
    let _worker = farm.worker("worker");
    let job = result(&at);
    assert_eq!(view(&at, &job, 10).header(BY), "worker");
    drop(api);
    // It marks what will go when it starts, and deletes what was marked at the next start.
    let kept = [("FLED_FAKE_WORKERS", "0"), ("FLED_FAKE_KEEP_MS", "0")];
    drop(farm.start("api", &kept));
    let (_api, base) = farm.start("api", &kept);
    let at = Client::new(base, PATIENCE);
    at.get(&format!("/v1/jobs/{job}"), &[]).expect(404);
    at.get(&format!("/v1/jobs/{job}/render"), &[]).expect(404);
    // The worker goes on with others; here nothing goes before the next start.
    let next = result(&at);
    assert_eq!(view(&at, &next, 10).header(BY), "worker");
}

#[test]
fn who_is_busy_is_waited_for() {
    let farm = Farm::new();
    let (_one, one) = farm.replica("one");
    let (_two, two) = farm.replica("two");
    let worker = farm.worker("worker");
    let job = result(&one);
    // 5 a second take a tenth of a second each: in all longer than anybody would be waited for.
    let first = film(&one, &job, 5, 4.0);
    under_way(&one, &first);
    assert_eq!(makes(&worker), 1);
    let second = film(&two, &job, 10, 1.0);
    // Views are another matter.
    assert_eq!(view(&two, &job, 40).header(BY), "worker");
    for (api, video) in [(&one, &first), (&two, &second)] {
        let shown = ended(api, video);
        assert_eq!(shown["state"], "succeeded", "{shown:#}");
        assert_eq!(shown["made_by"], "worker", "{shown:#}");
    }
}
