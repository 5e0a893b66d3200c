//! Synchronisation from a folder to blobs.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use futures::StreamExt;

use crate::blob::{Blob, Stamp, blocking, hash_file};
use crate::error::{BlobError, Result};
use crate::folder::{AT_ONCE, Kept, is_passing, list, stamp};
use crate::seen::Seen;
use crate::store::Blobs;

/// The result of [`push`], in order of the paths.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pushed {
    /// New or changed files, now in the store.
    pub kept: Vec<Kept>,
    /// Known and wanted paths whose files no longer exist.
    pub gone: Vec<String>,
    /// Files that changed or disappeared during the push, or whose names are not UTF-8. Their state
    /// stays undetermined this time.
    pub skipped: usize,
}

/// A file to examine.
struct Candidate {
    path: String,
    file: PathBuf,
    stamp: Stamp,
    known: Option<Blob>,
}

/// The content of a candidate, and whether it was unknown and has been put into the store.
struct Looked {
    candidate: Candidate,
    blob: Blob,
    put: bool,
}

/// Puts all regular files below `folder` whose relative path is `wanted` and whose content differs
/// from `known`, eight at a time. Symbolic links, and names that end in `.tmp` or begin with
/// `.fetch-`, are ignored.
///
/// # Errors
/// [`BlobError::Io`] if the folder cannot be read, or does not exist although it has known files:
/// an empty disk must not count as a deletion of everything. [`BlobError::Store`] if a file cannot
/// be put. The next call reuses all that was put until then.
pub async fn push(
    blobs: &Blobs,
    folder: &Path,
    wanted: &(dyn Fn(&str) -> bool + Send + Sync),
    known: &HashMap<String, Blob>,
    seen: &mut Seen,
) -> Result<Pushed> {
    let root = folder.to_owned();
    let listed = blocking(move || list(&root)).await?;
    let passing = |path: &str| path.split('/').any(is_passing);
    let expected = known.keys().filter(|path| wanted(path) && !passing(path));
    let mut missing: Vec<String> = expected.cloned().collect();
    if listed.is_none() && !missing.is_empty() {
        let error = std::io::Error::from(std::io::ErrorKind::NotFound);
        return Err(BlobError::io(folder)(error));
    }
    let listed = listed.unwrap_or_default();
    seen.forget_all_but(&listed.files);
    missing.retain(|path| !listed.files.contains(path));
    let paths = listed.files.into_iter().filter(|path| wanted(path));
    let (root, paths) = (folder.to_owned(), paths.collect());
    let looked_at = blocking(move || look_at(&root, paths, missing)).await?;

    let mut pushed = Pushed {
        gone: looked_at.gone,
        skipped: listed.nameless + looked_at.skipped,
        ..Pushed::default()
    };
    let candidates = looked_at.files.into_iter().filter_map(|(path, stamp)| {
        let known = known.get(&path).cloned();
        let digest = seen.digest(&path, stamp);
        let unchanged = digest.is_some() && digest == known.as_ref().map(|b| b.digest.as_str());
        let file = folder.join(&path);
        (!unchanged).then_some(Candidate { path, file, stamp, known })
    });
    let candidates: Vec<Candidate> = candidates.collect();
    let looks = candidates.into_iter().map(|one| look(blobs.clone(), one));
    let mut looks = futures::stream::iter(looks).buffer_unordered(AT_ONCE);
    while let Some(looked) = looks.next().await {
        let Some(Looked { candidate: Candidate { path, stamp, .. }, blob, put }) = looked? else {
            pushed.skipped += 1;
            continue;
        };
        seen.read(path.clone(), stamp, blob.digest.clone());
        if put {
            pushed.kept.push(Kept { path, blob });
        }
    }
    pushed.kept.sort();
    Ok(pushed)
}

#[derive(Default)]
struct LookedAt {
    files: Vec<(String, Stamp)>,
    gone: Vec<String>,
    skipped: usize,
}

/// Stamps the listed files, and checks those missing from the list.
fn look_at(folder: &Path, paths: Vec<String>, missing: Vec<String>) -> Result<LookedAt> {
    let mut looked_at = LookedAt::default();
    for path in paths {
        match stamp(&folder.join(&path))? {
            Some(stamp) => looked_at.files.push((path, stamp)),
            None => looked_at.skipped += 1,
        }
    }
    for path in missing {
        // Replaced while the folder was listed: some file systems then list neither file.
        if stamp(&folder.join(&path))?.is_some() {
            looked_at.skipped += 1;
        } else {
            looked_at.gone.push(path);
        }
    }
    looked_at.gone.sort();
    Ok(looked_at)
}

/// Returns `None` if the file changed or disappeared meanwhile.
async fn look(blobs: Blobs, candidate: Candidate) -> Result<Option<Looked>> {
    let looked = match look_into(&blobs, &candidate).await {
        Err(BlobError::Changed(_)) => None,
        Err(error) if error.is_gone() => None,
        looked => Some(looked?),
    };
    let Some((blob, put)) = looked else {
        return Ok(None);
    };
    let file = candidate.file.clone();
    let after = blocking(move || stamp(&file)).await?;
    let same = after == Some(candidate.stamp);
    Ok(same.then_some(Looked { candidate, blob, put }))
}

async fn look_into(blobs: &Blobs, candidate: &Candidate) -> Result<(Blob, bool)> {
    if let Some(known) = &candidate.known
        && known.bytes == candidate.stamp.bytes
    {
        let file = candidate.file.clone();
        let blob = blocking(move || hash_file(&file)).await?;
        if blob == *known {
            return Ok((blob, false));
        }
    }
    let blob = blobs.put(&candidate.file).await?;
    // The content may have changed back since it was hashed above.
    let put = candidate.known.as_ref() != Some(&blob);
    Ok((blob, put))
}
