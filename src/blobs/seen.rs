//! Cached digests of local files.

use std::collections::{BTreeSet, HashMap};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::blob::Stamp;

/// How long a file must have been unchanged before its digest is cached.
const SETTLED: Duration = Duration::from_secs(2);

/// Cached digests of the files of one folder, so that unchanged files are not read again. Each
/// folder needs its own cache, which may be dropped at any time.
///
/// A file counts as unchanged while its size, modification time in nanoseconds, and inode are the
/// same. A same-size change within one tick of the file system's clock would go unnoticed, so a
/// digest read within two seconds of a change is not cached. The digest of a fetched file is:
/// an immediate overwrite in place with the same size would go unnoticed, but jobs replace files by
/// renaming, which changes the inode.
#[derive(Debug, Default)]
pub struct Seen {
    files: HashMap<String, (Stamp, String)>,
}

impl Seen {
    /// Returns the digest of a file if its stamp is unchanged.
    pub(crate) fn digest(&self, path: &str, stamp: Stamp) -> Option<&str> {
        let (before, digest) = self.files.get(path)?;
        (*before == stamp).then_some(digest)
    }

    /// Caches the digest of a file that was read, if the file is at rest.
    pub(crate) fn read(&mut self, path: String, stamp: Stamp, digest: String) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let now_ns = now.map_or(0, |now| now.as_nanos().cast_signed());
        if now_ns - stamp.modified_ns > SETTLED.as_nanos().cast_signed() {
            self.written(path, stamp, digest);
        } else {
            self.files.remove(&path);
        }
    }

    /// Caches the digest of a file that this process has just written.
    pub(crate) fn written(&mut self, path: String, stamp: Stamp, digest: String) {
        self.files.insert(path, (stamp, digest));
    }

    /// Drops files that are no longer in the folder.
    pub(crate) fn forget_all_but(&mut self, files: &BTreeSet<String>) {
        self.files.retain(|path, _| files.contains(path));
    }
}
