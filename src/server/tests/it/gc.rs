//! `fled gc` beside a server and without one.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use crate::support::Server;
use fled_server::{Collected, GcOptions, gc};

const DAY: Duration = Duration::from_secs(24 * 3600);

/// Reports what would be removed now.
const LOOK: GcOptions =
    GcOptions { dry_run: true, unnamed: Duration::ZERO, caches: Duration::ZERO };
const DO: GcOptions = GcOptions { dry_run: false, ..LOOK };

fn wait<T>(future: impl Future<Output = T>) -> T {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
    runtime.block_on(future)
}

/// The reported removals by path, and the totals.
fn collect(data: &Path, options: &GcOptions) -> (BTreeMap<String, (u64, &'static str)>, Collected) {
    let mut removed = BTreeMap::new();
    let mut note = |gone: &fled_server::Gone| {
        let path = gone.path.to_string_lossy().into_owned();
        let before = removed.insert(path, (gone.bytes, gone.why));
        assert!(before.is_none(), "reported twice: {gone:?}");
    };
    let done = wait(gc(data, options, &mut note));
    (removed, done.expect("collected"))
}

fn write(path: &Path, bytes: usize) {
    fs::create_dir_all(path.parent().expect("a folder")).expect("made");
    fs::write(path, vec![7; bytes]).expect("written");
}

#[test]
fn a_dry_run_lists_exactly_what_is_removed() {
    let mut server = Server::start();
    let (kept, expired) = (server.job("ok"), server.job("ok"));
    for job in [&kept, &expired] {
        server.wait_state(job, "succeeded");
    }
    server.put(&format!("/v1/jobs/{kept}/pin"));
    server.get(&format!("/v1/jobs/{kept}/render?azimuth=3"), &[]).expect(200);
    let marks = [("FLED_FAKE_KEEP_MS", "1"), ("FLED_FAKE_NOTICE_MS", "300")];
    server.restart_with(&marks);
    server.kill();
    std::thread::sleep(Duration::from_millis(400));
    let data = server.data.path().join("data");
    write(&data.join("captures/left/images/a.jpg"), 1000);
    write(&data.join("unnamed/jobs/old/log.txt"), 2000);
    write(&data.join("cache/poses/a.json"), 3000);
    write(&data.join("incoming/half/images/a.jpg"), 4000);
    let (would, _) = collect(&data, &LOOK);
    let bytes = |path: &str| would.get(path).map(|(bytes, _)| *bytes);
    assert_eq!(bytes("captures/left"), Some(0), "{would:#?}");
    assert_eq!(bytes("unnamed/jobs/old"), Some(2000));
    assert_eq!(bytes("cache/poses/a.json"), Some(3000));
    assert_eq!(bytes("incoming/half"), Some(4000));
    assert!(bytes(&format!("jobs/{expired}")).is_some_and(|bytes| bytes > 10_000));
    let render = format!("jobs/{kept}/renders/");
    assert!(would.keys().any(|path| path.starts_with(&render)));
    assert!(would.keys().all(|path| data.join(path).exists()), "a look");
    let (done, collected) = collect(&data, &DO);
    assert_eq!(done, would);
    assert!(!collected.beside_server);
    for path in done.keys() {
        assert!(!data.join(path).exists(), "{path} is there");
    }
    assert!(data.join("unnamed/captures/left/images/a.jpg").is_file());
    let (then, _) = collect(&data, &DO);
    let then: Vec<&str> = then.keys().map(String::as_str).collect();
    assert_eq!(then, ["unnamed/captures/left"]);
    server.restart();
    server.get(&format!("/v1/jobs/{kept}/artifacts/scene.ply"), &[]).expect(200);
    server.get(&format!("/v1/jobs/{expired}"), &[]).expect(404);
}

#[test]
fn only_cached_poses_unused_for_long_are_removed() {
    let mut server = Server::start();
    server.kill();
    let data = server.data.path().join("data");
    for name in ["unused", "used"] {
        write(&data.join(format!("cache/poses/{name}.json")), 10);
    }
    std::thread::sleep(Duration::from_millis(1100));
    let used = fs::File::options().write(true).open(data.join("cache/poses/used.json"));
    used.expect("there").set_modified(std::time::SystemTime::now()).expect("touched");
    write(&data.join("cache/poses/new.json"), 10);
    write(&data.join("cache/costs.json"), 10);
    let (gone, _) = collect(&data, &GcOptions { caches: Duration::from_secs(1), ..DO });
    let gone: Vec<&str> = gone.keys().map(String::as_str).collect();
    assert_eq!(gone, ["cache/poses/unused.json"]);
}

#[test]
fn the_database_is_compacted_if_no_server_runs() {
    let mut server = Server::start();
    for _ in 0..3 {
        let job = server.job("ok");
        server.wait_state(&job, "succeeded");
        server.delete(&format!("/v1/jobs/{job}")).expect(204);
    }
    let data = server.data.path().join("data");
    let (_, beside) = collect(&data, &DO);
    assert_eq!((beside.beside_server, beside.database), (true, 0));
    server.kill();
    let bytes = || fs::metadata(data.join("fled.db")).expect("a database").len();
    let (_, alone) = collect(&data, &DO);
    assert!(!alone.beside_server && alone.database > 0, "{alone:?}");
    let log = fs::metadata(data.join("fled.db-wal")).map_or(0, |log| log.len());
    assert_eq!(log, 0, "its log has ended");
    assert!(bytes() < 1 << 20, "{}", bytes());
    server.restart();
    server.capture(3);
}

#[test]
fn beside_a_server_recent_files_stay() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    server.get(&format!("/v1/jobs/{job}/render?azimuth=3"), &[]).expect(200);
    let data = server.data.path().join("data");
    // An upload being moved into place, and one in progress: neither has a row yet.
    for young in ["captures/young/a.jpg", "incoming/young/a.jpg", "uploads/young", "cache/a.json"] {
        write(&data.join(young), 10);
    }
    let (removed, collected) = collect(&data, &DO);
    assert!(collected.beside_server && removed.is_empty(), "{removed:#?}");
    let old = GcOptions { unnamed: 30 * DAY, ..DO };
    let (removed, _) = collect(&data, &old);
    assert!(removed.is_empty(), "{removed:#?}");
}

#[test]
fn without_a_valid_database_nothing_is_an_orphan() {
    let mut server = Server::start();
    let capture = server.capture(3);
    server.kill();
    let data = server.data.path().join("data");
    let refused = |data: &Path| wait(gc(data, &DO, &mut |gone| panic!("{gone:?}"))).is_err();
    let database = data.join("fled.db");
    let aside = data.join("aside.db");
    fs::rename(&database, &aside).expect("moved");
    assert!(refused(&data));
    assert!(!database.exists(), "made by looking");
    fs::write(&database, "").expect("written");
    assert!(refused(&data), "an empty one");
    assert!(data.join("captures").join(&capture).is_dir());
}
