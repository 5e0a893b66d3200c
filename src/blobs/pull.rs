//! Synchronisation from blobs to a folder.

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};

use futures::StreamExt;

use crate::blob::{Stamp, blocking, expect_digest, hash_file};
use crate::error::{BlobError, Result};
use crate::folder::{AT_ONCE, Kept, expect_no_links, list, place, stamp};
use crate::seen::Seen;
use crate::store::Blobs;

/// Totals of [`pull`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pulled {
    /// Files fetched.
    pub files: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Files removed.
    pub removed: usize,
}

/// A stored file that is not known to be present.
struct Absent {
    kept: Kept,
    folder: PathBuf,
    file: PathBuf,
    /// The stamp of the existing file.
    stamp: Option<Stamp>,
}

/// A file that is present after the pull.
struct Present {
    kept: Kept,
    stamp: Stamp,
    fetched: bool,
}

/// Makes the files of `folder` match `kept`: fetches missing and different ones, eight at a time.
/// If `exact` is given, removes the other regular files that it accepts, once all of `kept` is
/// present. A file under its final name is always complete.
///
/// # Errors
/// [`BlobError::Damaged`], before anything is done, if a path could lead out of the folder or
/// occurs twice; the error of a failed fetch, with the files fetched so far in place.
pub async fn pull(
    blobs: &Blobs,
    kept: &[Kept],
    folder: &Path,
    exact: Option<&(dyn Fn(&str) -> bool + Send + Sync)>,
    seen: &mut Seen,
) -> Result<Pulled> {
    let mut paths = BTreeSet::new();
    for Kept { path, blob } in kept {
        place(folder, path)?;
        expect_digest(&blob.digest)?;
        if !paths.insert(path.clone()) {
            return Err(BlobError::Damaged {
                what: format!("the path {path:?} of a kept file"),
                detail: "it is there twice".into(),
            });
        }
    }
    let (root, wanted) = (folder.to_owned(), kept.to_vec());
    let placed = blocking(move || placed(&root, wanted)).await?;
    let is_known = |one: &Absent| {
        let digest = one.stamp.and_then(|stamp| seen.digest(&one.kept.path, stamp));
        digest == Some(one.kept.blob.digest.as_str())
    };
    let absent: Vec<Absent> = placed.into_iter().filter(|one| !is_known(one)).collect();

    let mut pulled = Pulled::default();
    let fetches = absent.into_iter().map(|one| fetch_one(blobs.clone(), one));
    let mut fetches = futures::stream::iter(fetches).buffer_unordered(AT_ONCE);
    while let Some(present) = fetches.next().await {
        let Present { kept: Kept { path, blob }, stamp, fetched } = present?;
        if fetched {
            pulled.files += 1;
            pulled.bytes += blob.bytes;
            seen.written(path, stamp, blob.digest);
        } else {
            seen.read(path, stamp, blob.digest);
        }
    }
    if let Some(exact) = exact {
        let root = folder.to_owned();
        let mut others = blocking(move || list(&root)).await?.unwrap_or_default().files;
        others.retain(|path| exact(path) && !paths.contains(path));
        let root = folder.to_owned();
        pulled.removed = blocking(move || remove(&root, &others)).await?;
    }
    Ok(pulled)
}

/// Pairs every file with the stamp of the existing one.
fn placed(folder: &Path, kept: Vec<Kept>) -> Result<Vec<Absent>> {
    let placed = kept.into_iter().map(|kept| {
        let file = place(folder, &kept.path)?;
        expect_no_links(folder, &file)?;
        let stamp = stamp(&file)?;
        Ok(Absent { kept, folder: folder.to_owned(), file, stamp })
    });
    placed.collect()
}

async fn fetch_one(blobs: Blobs, absent: Absent) -> Result<Present> {
    let Absent { kept, folder, file, stamp } = absent;
    if let Some(stamp) = stamp
        && stamp.bytes == kept.blob.bytes
    {
        let there = file.clone();
        let blob = match blocking(move || hash_file(&there)).await {
            // The file will be replaced anyway.
            Err(BlobError::Changed(_)) => None,
            Err(error) if error.is_gone() => None,
            blob => Some(blob?),
        };
        if blob.as_ref() == Some(&kept.blob) {
            return Ok(Present { kept, stamp, fetched: false });
        }
    }
    let (root, target) = (folder, file.clone());
    blocking(move || expect_no_links(&root, &target)).await?;
    let stamp = blobs.fetch(&kept.blob, &file).await?;
    Ok(Present { kept, stamp, fetched: true })
}

fn remove(folder: &Path, paths: &BTreeSet<String>) -> Result<usize> {
    let mut removed = 0;
    for path in paths {
        let file = folder.join(path);
        match std::fs::remove_file(&file) {
            Ok(()) => removed += 1,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(BlobError::io(&file)(error)),
        }
    }
    Ok(removed)
}
