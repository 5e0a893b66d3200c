//! What is known of local files.

use std::collections::{BTreeSet, HashMap};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::blob::Stamp;

/// How long a file must not have been written to before its digest is believed the next time.
const SETTLED: Duration = Duration::from_secs(2);

/// Digests of the files of one folder, so that those that did not change are not read again. One
/// belongs to each folder; it may be thrown away at any time.
///
/// A file counts as unchanged while size, time of change in nanoseconds, and inode are the same. A
/// change of the same size within one tick of the file system's clock would go unnoticed: so a
/// digest that was read within two seconds of a change is not remembered. Of a file that was
/// fetched it is, and who then overwrites that file in place, at once, and with as many bytes, is
/// not noticed; jobs replace files by renaming, which changes the inode.
#[derive(Debug, Default)]
pub struct Seen {
    files: HashMap<String, (Stamp, String)>,
}

impl Seen {
    /// The digest of a file that is the same as before.
    pub(crate) fn digest(&self, path: &str, stamp: Stamp) -> Option<&str> {
        let (before, digest) = self.files.get(path)?;
        (*before == stamp).then_some(digest)
    }

    /// Remembers a file that was read, if it rests.
    pub(crate) fn read(&mut self, path: String, stamp: Stamp, digest: String) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let now_ns = now.map_or(0, |now| now.as_nanos().cast_signed());
        if now_ns - stamp.modified_ns > SETTLED.as_nanos().cast_signed() {
            self.written(path, stamp, digest);
        } else {
            self.files.remove(&path);
        }
    }

    /// Remembers a file that was just written by us.
    pub(crate) fn written(&mut self, path: String, stamp: Stamp, digest: String) {
        self.files.insert(path, (stamp, digest));
    }

    /// Forgets whatever is no longer in the folder.
    pub(crate) fn forget_all_but(&mut self, files: &BTreeSet<String>) {
        self.files.retain(|path, _| files.contains(path));
    }
}
