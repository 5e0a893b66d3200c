//! Synchronisation of folders with blobs.

use std::collections::HashMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::server::{Fault, Server};
use super::{HOUR, directory, names, noise, object, set_age};
use crate::{Blob, BlobError, Blobs, Kept, Pulled, Pushed, Seen, pull, push};

const PATIENCE: Duration = Duration::from_secs(5);
const PUT: &str = "PUT /bucket/some/prefix/blobs/";
const GET: &str = "GET /bucket/some/prefix/blobs/";

fn write(folder: &Path, path: &str, bytes: &[u8]) {
    let file = folder.join(path);
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    // As jobs do.
    let temporary = file.with_extension("tmp");
    fs::write(&temporary, bytes).unwrap();
    fs::rename(&temporary, &file).unwrap();
    set_age(&file, HOUR);
}

fn kept(path: &str, bytes: &[u8]) -> Kept {
    Kept { path: path.to_owned(), blob: Blob::of(bytes) }
}

/// A folder, with the database's record of it.
struct Folder {
    dir: TempDir,
    known: HashMap<String, Blob>,
    seen: Seen,
}

impl Folder {
    fn new() -> Self {
        Self { dir: tempfile::tempdir().unwrap(), known: HashMap::new(), seen: Seen::default() }
    }

    /// Pushes everything except files below `cache`, and remembers the result.
    async fn push(&mut self, blobs: &Blobs) -> Pushed {
        let wanted = |path: &str| !path.starts_with("cache/");
        let pushed = push(blobs, self.dir.path(), &wanted, &self.known, &mut self.seen);
        let pushed = pushed.await.unwrap();
        for kept in &pushed.kept {
            self.known.insert(kept.path.clone(), kept.blob.clone());
        }
        for path in &pushed.gone {
            self.known.remove(path);
        }
        pushed
    }

    async fn pull(&mut self, blobs: &Blobs, kept: &[Kept], exact: bool) -> Pulled {
        let wanted = |path: &str| !path.starts_with("cache/");
        let exact: Option<&(dyn Fn(&str) -> bool + Send + Sync)> = exact.then_some(&wanted);
        let pulled = pull(blobs, kept, self.dir.path(), exact, &mut self.seen).await;
        pulled.unwrap()
    }
}

#[tokio::test]
async fn push_finds_new_changed_and_removed_files() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let mut folder = Folder::new();
    let path = folder.dir.path().to_owned();
    write(&path, "a", b"a");
    write(&path, "b/c", b"c");
    write(&path, "b/d/e", b"");
    write(&path, "cache/f", b"f");
    let pushed = folder.push(&blobs).await;
    let all = [kept("a", b"a"), kept("b/c", b"c"), kept("b/d/e", b"")];
    assert_eq!(pushed.kept, all);
    assert_eq!((pushed.gone.len(), pushed.skipped), (0, 0));
    assert_eq!(server.count(PUT), 3);

    // Nothing has changed, so there is no request at all.
    let before = server.count("");
    assert_eq!(folder.push(&blobs).await, Pushed::default());
    assert_eq!(server.count(""), before);

    // With the same size and the same time.
    let modified = path.join("a").metadata().unwrap().modified().unwrap();
    write(&path, "a", b"A");
    let replaced = fs::File::open(path.join("a")).unwrap();
    replaced.set_modified(modified).unwrap();
    write(&path, "b/g", b"g");
    fs::remove_file(path.join("b/c")).unwrap();
    let pushed = folder.push(&blobs).await;
    assert_eq!(pushed.kept, [kept("a", b"A"), kept("b/g", b"g")]);
    assert_eq!(pushed.gone, ["b/c"]);
    assert_eq!(server.count(PUT), 5);
    assert!(object(&server.objects(), &Blob::of(b"A")).exists());
}

#[tokio::test]
async fn a_new_process_hashes_known_files_but_sends_nothing() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let mut folder = Folder::new();
    write(folder.dir.path(), "a", &noise(1, 17 << 20));
    folder.push(&blobs).await;
    let before = server.count("");
    folder.seen = Seen::default();
    assert_eq!(folder.push(&blobs).await, Pushed::default());
    assert_eq!(server.count(""), before);
}

#[tokio::test]
async fn a_freshly_written_file_is_hashed_again() {
    let (_store, blobs) = directory();
    let mut folder = Folder::new();
    let file = folder.dir.path().join("a");
    fs::write(&file, "one").unwrap();
    let modified = file.metadata().unwrap().modified().unwrap();
    folder.push(&blobs).await;
    // In place, within the tick of the clock.
    fs::write(&file, "two").unwrap();
    let written = fs::File::options().write(true).open(&file).unwrap();
    written.set_modified(modified).unwrap();
    assert_eq!(folder.push(&blobs).await.kept, [kept("a", b"two")]);
}

#[tokio::test]
async fn temporary_files_and_symbolic_links_are_ignored() {
    let (_store, blobs) = directory();
    let mut folder = Folder::new();
    let path = folder.dir.path().to_owned();
    let outside = tempfile::tempdir().unwrap();
    fs::write(outside.path().join("secret"), "secret").unwrap();
    symlink(outside.path(), path.join("folder")).unwrap();
    symlink(outside.path().join("secret"), path.join("link")).unwrap();
    fs::write(path.join(".fetch-1"), "half").unwrap();
    fs::write(path.join("half.tmp"), "half").unwrap();
    write(&path, "a.txt", b"whole");
    let pushed = folder.push(&blobs).await;
    assert_eq!(pushed.kept, [kept("a.txt", b"whole")]);
    assert_eq!(pushed.skipped, 0);
    assert_eq!(folder.pull(&blobs, &[], true).await.removed, 1);
    assert_eq!(names(&path), [".fetch-1", "folder", "half.tmp", "link"]);
    assert!(outside.path().join("secret").exists());
}

#[tokio::test]
async fn a_missing_folder_is_not_an_empty_one() {
    let (_store, blobs) = directory();
    let mut folder = Folder::new();
    let absent = folder.dir.path().join("absent");
    let all = |_: &str| true;
    let none = push(&blobs, &absent, &all, &folder.known, &mut folder.seen).await;
    assert_eq!(none.unwrap(), Pushed::default());
    folder.known.insert("a".into(), Blob::of(b"a"));
    let lost = push(&blobs, &absent, &all, &folder.known, &mut folder.seen).await;
    assert!(lost.unwrap_err().is_gone());
    fs::create_dir(&absent).unwrap();
    let gone = push(&blobs, &absent, &all, &folder.known, &mut folder.seen).await;
    assert_eq!(gone.unwrap().gone, ["a"]);
}

/// A file is replaced during its upload, and another one disappears.
#[tokio::test]
async fn files_that_change_during_a_push_wait_for_the_next_one() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let mut folder = Folder::new();
    let path = folder.dir.path().to_owned();
    write(&path, "a", b"one");
    write(&path, "b", b"b");
    write(&path, "c", b"c");
    let at = path.clone();
    server.misbehave(move |request| {
        if request.starts_with(PUT) && at.join("b").exists() {
            write(&at, "a", b"two");
            fs::remove_file(at.join("b")).unwrap();
        }
        Fault::None
    });
    let pushed = folder.push(&blobs).await;
    assert_eq!(pushed.kept, [kept("c", b"c")]);
    assert_eq!(pushed.skipped, 2);
    let pushed = folder.push(&blobs).await;
    assert_eq!(pushed.kept, [kept("a", b"two")]);
    assert_eq!((pushed.gone.len(), pushed.skipped), (0, 0));
}

#[tokio::test]
async fn eight_transfers_run_at_once() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    server.misbehave(|_| Fault::Late(Duration::from_millis(60)));
    let mut folder = Folder::new();
    let path = folder.dir.path().to_owned();
    let all: Vec<Kept> = (0..40_u64)
        .map(|number| {
            let (name, bytes) = (format!("{number:02}"), noise(number, 1000));
            write(&path, &name, &bytes);
            kept(&name, &bytes)
        })
        .collect();
    assert_eq!(folder.push(&blobs).await.kept, all);
    let mut other = Folder::new();
    let pulled = other.pull(&blobs, &all, true).await;
    assert_eq!((pulled.files, pulled.bytes), (40, 40_000));
    assert_eq!(server.most_at_once(), 8);
}

#[tokio::test]
async fn pull_fetches_only_different_files() {
    let server = Server::start();
    let blobs = server.blobs(PATIENCE);
    let mut origin = Folder::new();
    for (path, bytes) in [("a", "a"), ("b/c", "c"), ("b/d", ""), ("e", "e")] {
        write(origin.dir.path(), path, bytes.as_bytes());
    }
    let all = origin.push(&blobs).await.kept;

    let mut copy = Folder::new();
    let path = copy.dir.path().to_owned();
    write(&path, "a", b"a");
    write(&path, "b/c", b"C");
    write(&path, "b/d", b"longer");
    write(&path, "mine", b"mine");
    write(&path, "cache/f", b"f");
    let pulled = copy.pull(&blobs, &all, false).await;
    assert_eq!((pulled.files, pulled.bytes, pulled.removed), (3, 2, 0));
    assert_eq!(server.count(GET), 3);
    assert!(path.join("mine").exists());

    assert_eq!(copy.pull(&blobs, &all, false).await, Pulled::default());
    let pulled = copy.pull(&blobs, &all[..3], true).await;
    assert_eq!((pulled.files, pulled.removed), (0, 2));
    assert_eq!(server.count(GET), 3);
    assert_eq!(names(&path), ["a", "b", "cache"]);
    assert_eq!(fs::read(path.join("b/c")).unwrap(), b"c");
    assert_eq!(fs::read(path.join("b/d")).unwrap(), b"");

    // A push recognises the pulled files.
    copy.known = all[..3].iter().map(|k| (k.path.clone(), k.blob.clone())).collect();
    assert_eq!(copy.push(&blobs).await, Pushed::default());
}

#[tokio::test]
async fn paths_that_lead_elsewhere_are_refused() {
    let (_store, blobs) = directory();
    let blob = blobs.put_bytes(b"bad".to_vec()).await.unwrap();
    let around = tempfile::tempdir().unwrap();
    let folder = around.path().join("folder");
    fs::create_dir(&folder).unwrap();
    symlink(around.path(), folder.join("link")).unwrap();
    let absolute = around.path().join("absolute");
    let bad = [
        "",
        ".",
        "..",
        "../out",
        "a/../../out",
        "a//b",
        "a/",
        "/",
        absolute.to_str().unwrap(),
        "a\0b",
        "link/out",
    ];
    let good = kept("good", b"bad");
    for path in bad {
        let path = path.to_owned();
        let all = [good.clone(), Kept { path, blob: blob.clone() }];
        let pulled = pull(&blobs, &all, &folder, None, &mut Seen::default()).await;
        assert!(matches!(pulled, Err(BlobError::Damaged { .. })), "{all:?}");
    }
    let twice = [good.clone(), good];
    let pulled = pull(&blobs, &twice, &folder, None, &mut Seen::default()).await;
    assert!(matches!(pulled, Err(BlobError::Damaged { .. })));
    let mut strange = kept("a", b"a");
    strange.blob.digest = "../../a".into();
    let pulled = pull(&blobs, &[strange], &folder, None, &mut Seen::default()).await;
    assert!(matches!(pulled, Err(BlobError::Digest(_))));
    assert_eq!(names(&folder), ["link"]);
    assert_eq!(names(around.path()), ["folder"]);
}

#[tokio::test]
async fn pull_replaces_links_without_following_them() {
    let (_store, blobs) = directory();
    let blob = blobs.put_bytes(b"new".to_vec()).await.unwrap();
    let outside = tempfile::tempdir().unwrap();
    let secret = outside.path().join("secret");
    fs::write(&secret, "old").unwrap();
    let mut folder = Folder::new();
    let file = folder.dir.path().join("a");
    symlink(&secret, &file).unwrap();
    let all = [Kept { path: "a".into(), blob }];
    assert_eq!(folder.pull(&blobs, &all, true).await.files, 1);
    assert!(!file.is_symlink());
    assert_eq!(fs::read(&secret).unwrap(), b"old");
}

/// While transfers break off, a reader sees the old file, the new one, or none.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pull_leaves_no_partial_file() {
    let server = Server::start();
    let blobs = server.blobs(Duration::ZERO);
    let (old, new) = (noise(1, 2 << 20), noise(2, 3 << 20));
    let blob = blobs.put_bytes(new.clone()).await.unwrap();
    let mut folder = Folder::new();
    let path = folder.dir.path().to_owned();
    write(&path, "a", &old);
    let all = ["a", "b"].map(|path| Kept { path: path.into(), blob: blob.clone() });
    server.misbehave_first(100, "GET ", Fault::CutAfter(2 << 20));
    let failed = pull(&blobs, &all, &path, None, &mut folder.seen).await;
    assert!(matches!(failed, Err(BlobError::BrokenOff { .. })));
    // The other transfer may still be writing in its own thread, which then removes its file.
    let begun = Instant::now();
    while names(&path) != ["a"] && begun.elapsed() < Duration::from_secs(10) {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(names(&path), ["a"]);
    assert!(fs::read(path.join("a")).unwrap() == old);

    server.misbehave_first(3, "GET ", Fault::CutAfter(2 << 20));
    let looked = path.clone();
    let looking = tokio::task::spawn_blocking(move || {
        loop {
            let (a, b) = (fs::read(looked.join("a")), fs::read(looked.join("b")));
            let (a, b) = (a.unwrap(), b.unwrap_or_default());
            assert!(a == old || a == new, "half a file");
            assert!(b.is_empty() || b == new, "half a file");
            if a == new && b == new {
                break;
            }
        }
    });
    assert_eq!(folder.pull(&blobs, &all, true).await.files, 2);
    looking.await.unwrap();
    assert_eq!(names(&path), ["a", "b"]);
}

#[test]
fn every_future_is_send() {
    fn expect_send<T: Send>(_: T) {}
    let (dir, blobs) = directory();
    let (known, blob, mut seen) = (HashMap::new(), Blob::of(b""), Seen::default());
    let wanted = |_: &str| true;
    expect_send(push(&blobs, dir.path(), &wanted, &known, &mut seen));
    expect_send(pull(&blobs, &[], dir.path(), Some(&wanted), &mut seen));
    expect_send(blobs.put(dir.path()));
    expect_send(blobs.put_bytes(Vec::new()));
    expect_send(blobs.fetch(&blob, dir.path()));
    expect_send(blobs.older_than(0, HOUR));
    expect_send(blobs.delete(""));
    expect_send(blobs.delete_older("", HOUR));
    expect_send(blobs.delete_unfinished(HOUR));
    expect_send(blobs.check());
}
