//! Helpers for all tests of this crate.

mod blobs;
mod damage;
mod faults;
mod folders;
mod puts;
mod server;

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use tempfile::TempDir;

use crate::{Blob, Blobs};

const HOUR: Duration = Duration::from_secs(60 * 60);

/// Deterministic pseudo-random bytes.
fn noise(seed: u64, bytes: usize) -> Vec<u8> {
    let mut noise = vec![0; bytes];
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.finalize_xof().fill(&mut noise);
    noise
}

fn directory() -> (TempDir, Blobs) {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path().to_str().unwrap()).unwrap();
    (dir, blobs)
}

/// The path of a blob's object below `root`, a directory of blobs.
fn object(root: &Path, blob: &Blob) -> PathBuf {
    root.join("blobs").join(&blob.digest[..2]).join(&blob.digest)
}

fn set_age(file: &Path, age: Duration) {
    let file = File::options().write(true).open(file).unwrap();
    file.set_modified(SystemTime::now() - age).unwrap();
}

/// All blobs older than `age`, with any digest.
async fn older_than(blobs: &Blobs, age: Duration) -> Vec<Blob> {
    let mut old = Vec::new();
    for first in 0..=u8::MAX {
        old.extend(blobs.older_than(first, age).await.unwrap());
    }
    old
}

fn age(file: &Path) -> Duration {
    let modified = file.metadata().unwrap().modified().unwrap();
    modified.elapsed().unwrap_or_default()
}

/// The names in a folder, in order.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let name = |entry: std::io::Result<fs::DirEntry>| entry.unwrap().file_name();
    let mut names: Vec<String> = entries.map(|entry| name(entry).into_string().unwrap()).collect();
    names.sort();
    names
}
