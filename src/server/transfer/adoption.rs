//! Converts the videos of an earlier build, which lie in folders of their jobs with a `video.json`
//! each, to jobs.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;

use serde_json::Value;

use crate::error::{Result, ServerError};
use crate::files::data::{DataDir, sync_directory};
use crate::store::Store;

/// Adopts all such videos in this directory. After an interruption, the next start adopts the rest.
///
/// # Errors
/// When the database or the disk fails.
pub(crate) async fn adopt_videos(store: &Store, data: &DataDir) -> Result<()> {
    for job in names(&data.jobs())? {
        let folder = data.job(&job).join("videos");
        for id in names(&folder)? {
            let video = folder.join(&id);
            let Some(record) = read(&video, &id) else {
                tracing::warn!(path = %video.display(), "its video.json is damaged: it stays");
                continue;
            };
            store.adopt_video(&job, &id, &record).await?;
            let to = data.video(&id);
            place(&video.join("video.mp4"), &to).map_err(ServerError::io(&to))?;
            fs::remove_dir_all(&video).map_err(ServerError::io(&video))?;
        }
        // The folder stays if it still holds damaged videos.
        let _ = fs::remove_dir(&folder);
    }
    Ok(())
}

/// The names of the entries of a folder, if it exists.
fn names(folder: &Path) -> Result<Vec<String>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(ServerError::io(folder))?,
    };
    let name = |entry: io::Result<fs::DirEntry>| entry.map(|entry| entry.file_name().into_string());
    let names: io::Result<Vec<_>> = entries.map(name).collect();
    let names = names.map_err(ServerError::io(folder))?;
    Ok(names.into_iter().flatten().collect())
}

/// The record of a video.
fn read(folder: &Path, id: &str) -> Option<Value> {
    let record: Value = serde_json::from_slice(&fs::read(folder.join("video.json")).ok()?).ok()?;
    (record["id"] == id && record["plan"].is_object()).then_some(record)
}

/// Moves a file, if it exists and was not moved before.
fn place(from: &Path, to: &Path) -> io::Result<()> {
    let folder = to.parent().unwrap_or(to);
    fs::create_dir_all(folder)?;
    match fs::rename(from, to) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        moved => moved.and_then(|()| sync_directory(folder)),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::config::ServeConfig;
    use crate::serve::Server;
    use crate::store::state::JobState;
    use crate::store::tests::{create, keep_capture};

    #[tokio::test]
    async fn a_start_converts_videos_of_an_earlier_build_to_jobs() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let store = Store::open(&dir.path().join("fled.db")).await.expect("open");
        keep_capture(&store, "c", None, &[]).await;
        create(&store, "j").await;
        fs::create_dir_all(dir.path().join("captures/c")).expect("made");
        for (id, state, error) in [
            ("v1", "succeeded", Value::Null),
            ("v2", "failed", json!({ "detail": "it broke", "hint": "again" })),
        ] {
            let folder = dir.path().join("jobs/j/videos").join(id);
            fs::create_dir_all(&folder).expect("made");
            let record = json!({ "id": id, "state": state, "plan": { "kind": "orbit", "fps": 5 },
                "width": 128, "height": 72, "created_at": 5, "finished_at": 7, "attempts": 1,
                "bytes": (state == "succeeded").then_some(3), "error": error });
            fs::write(folder.join("video.json"), record.to_string()).expect("written");
        }
        fs::write(dir.path().join("jobs/j/videos/v1/video.mp4"), "mp4").expect("written");
        for _ in 0..2 {
            let listen = ([127, 0, 0, 1], 0).into();
            let mut config = ServeConfig::new(dir.path().into(), listen, 0).expect("a program");
            config.ffmpeg = "no-such-ffmpeg".into();
            Server::start(config).await.expect("started").stop().await;
            let videos = store.videos("j").await.expect("read");
            let (failed, made) = (&videos[0], &videos[1]);
            assert_eq!(made.job.state, JobState::Succeeded);
            assert_eq!((made.bytes, made.job.created_at), (Some(3), 5));
            let plan = json!({ "kind": "orbit", "fps": 5, "width": 128, "height": 72 });
            assert_eq!(made.job.options, plan);
            assert_eq!(failed.job.state, JobState::Failed);
            let error = failed.job.error.as_ref().expect("why");
            assert_eq!((error.detail.as_str(), error.hint.as_str()), ("it broke", "again"));
            let file = dir.path().join("jobs/v1/output/video.mp4");
            assert_eq!(fs::read(file).expect("there"), b"mp4");
            assert!(!dir.path().join("jobs/j/videos").exists());
        }
    }
}
