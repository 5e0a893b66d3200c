//! The rule for this machine's blob cache.

use std::fs;
use std::time::{Duration, SystemTime};

use crate::app::App;
use crate::error::{Result, ServerError};
use crate::files::blob_cache::Copy;
use crate::files::remove;

/// Removes cached jobs and captures that have been unused for `age`. Returns how many.
///
/// # Errors
/// When the data directory cannot be read.
pub(super) async fn remove_unused(app: &App, age: Duration) -> Result<usize> {
    let mut removed = 0;
    for folder in [app.data.captures(), app.data.jobs()] {
        let entries = fs::read_dir(&folder).map_err(ServerError::io(&folder))?;
        for entry in entries {
            let path = entry.map_err(ServerError::io(&folder))?.path();
            let Some(id) = path.file_name().and_then(|name| name.to_str()) else {
                continue;
            };
            let copy = app.blob_cache.folder(id);
            let mut copy = copy.lock().await;
            let is_old = |used: SystemTime| used.elapsed().is_ok_and(|unused| unused > age);
            let used = fs::metadata(&path).and_then(|about| about.modified());
            if app.running.has(id) || !used.is_ok_and(is_old) {
                continue;
            }
            remove(&path).await;
            *copy = Copy::default();
            app.blob_cache.forget(id);
            removed += 1;
        }
    }
    Ok(removed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ServeConfig;
    use crate::files::blob_cache::BlobCache;
    use crate::files::data::DataDir;
    use crate::store::{Lease, Store};

    #[tokio::test]
    async fn only_long_unused_cached_folders_are_removed() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let nowhere = ([127, 0, 0, 1], 0).into();
        let config = ServeConfig::new(dir.path().into(), nowhere, 1).expect("a program");
        let data = DataDir::open(dir.path()).expect("free");
        let store = Store::open(&data.database()).await.expect("open");
        let blob_cache = BlobCache::default();
        let app = App::new(config, data, store, blob_cache, "w".to_owned());
        let age = Duration::from_secs(3600);
        let old = SystemTime::now() - 2 * age;
        let folders = [
            (app.data.capture("old"), true),
            (app.data.capture("new"), false),
            (app.data.job("old"), true),
            (app.data.job("runs"), true),
        ];
        for (folder, is_old) in &folders {
            fs::create_dir(folder).expect("made");
            if *is_old {
                let folder = fs::File::open(folder).expect("opened");
                folder.set_modified(old).expect("set");
            }
        }
        let job = "runs".to_owned();
        app.running.begin(&Lease { job, epoch: 1 });
        assert_eq!(remove_unused(&app, age).await.expect("read"), 2);
        let left = folders.map(|(folder, _)| folder.exists());
        assert_eq!(left, [false, true, false, true]);
    }
}
