//! The uploads of a submission, kept until its job is accepted: a second command continues one that
//! was killed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::tools::cache_home;

/// The service deletes unused uploads a day after their last byte.
const KEPT: Duration = Duration::from_secs(2 * 24 * 3600);

/// Ids of uploads by the names of their files.
#[derive(Debug, Default)]
pub struct Begun {
    /// `None` if this user has no home.
    file: Option<PathBuf>,
    ids: BTreeMap<String, String>,
}

impl Begun {
    /// Those of an earlier command that sent the same capture, of this digest, to the same server.
    pub fn open(server: &str, digest: &blake3::Hash) -> Self {
        let folder = cache_home().map(|cache| cache.join("submissions"));
        folder.map_or_else(Self::default, |folder| Self::open_in(&folder, server, digest))
    }

    fn open_in(folder: &Path, server: &str, digest: &blake3::Hash) -> Self {
        remove_old(folder);
        let mut hasher = blake3::Hasher::new();
        hasher.update(digest.as_bytes()).update(server.as_bytes());
        let file = folder.join(format!("{}.json", hasher.finalize().to_hex()));
        // A file that was cut short only means that uploads begin anew.
        let ids = std::fs::read(&file).ok().and_then(|text| serde_json::from_slice(&text).ok());
        Self { file: Some(file), ids: ids.unwrap_or_default() }
    }

    /// The upload of a file.
    pub fn of(&self, name: &str) -> Option<&str> {
        self.ids.get(name).map(String::as_str)
    }

    /// The ids of all uploads.
    pub fn ids(&self) -> Vec<String> {
        self.ids.values().cloned().collect()
    }

    /// Takes the upload that was begun for a file.
    pub fn set(&mut self, name: &str, id: String) {
        self.ids.insert(name.to_owned(), id);
    }

    /// Writes them for a second command; says so if that fails.
    pub fn keep(&self) {
        let Some(file) = &self.file else { return };
        let folder = file.parent().map_or(Ok(()), std::fs::create_dir_all);
        let text = serde_json::json!(self.ids).to_string();
        if let Err(error) = folder.and_then(|()| std::fs::write(file, text)) {
            eprintln!("{}: {error}; if it is killed, this command begins anew", file.display());
        }
    }

    /// Forgets them, because a job has used them up, or they were deleted.
    pub fn forget(&mut self) {
        self.ids.clear();
        if let Some(file) = &self.file {
            // Uploads that are gone begin anew.
            let _ = std::fs::remove_file(file);
        }
    }
}

/// Removes the files of submissions whose uploads have expired.
fn remove_old(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let modified = entry.metadata().and_then(|about| about.modified());
        let age = modified.ok().and_then(|time| time.elapsed().ok());
        if age.is_some_and(|age| age > KEPT) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uploads_are_found_again_by_server_and_capture_until_they_are_forgotten() {
        let home = tempfile::tempdir().expect("temporary folder");
        let folder = home.path().join("submissions");
        let digest = blake3::hash(b"a capture");
        let open = |server: &str, of: &blake3::Hash| Begun::open_in(&folder, server, of);
        let mut begun = open("http://a", &digest);
        assert_eq!(begun.of("images/1.jpg"), None);
        begun.set("images/1.jpg", "one".to_owned());
        begun.keep();
        assert_eq!(open("http://a", &digest).of("images/1.jpg"), Some("one"));
        assert_eq!(open("http://a", &digest).ids(), ["one"]);
        assert_eq!(open("http://b", &digest).of("images/1.jpg"), None);
        assert_eq!(open("http://a", &blake3::hash(b"another")).of("images/1.jpg"), None);
        begun.forget();
        assert_eq!(open("http://a", &digest).of("images/1.jpg"), None);
    }
}
