//! The files of what moves: which there are to be, and those of a data directory in the store.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use fled_blobs::{Blob, Blobs, Kept, Seen, push};
use serde_json::{Map, Value};

use super::file::{Header, Reader};
use crate::copies::is_kept;
use crate::data::DataDir;
use crate::error::{Result, ServerError};
use crate::videos::record::{VideoFolder, videos_of};

/// What an export names.
#[derive(Debug)]
pub struct Survey {
    /// Its first line.
    pub header: Header,
    captures: Vec<String>,
    /// And whether it succeeded.
    jobs: Vec<(String, bool)>,
    /// Captures and jobs whose files a store has.
    stored: HashSet<String>,
    /// Those files.
    blobs: HashSet<Blob>,
}

/// What was put into the store of files, by the id of its capture or job.
#[derive(Debug, Default)]
pub struct Stored {
    /// Of captures.
    pub captures: Vec<(String, Vec<Kept>)>,
    /// Of jobs.
    pub jobs: Vec<(String, Vec<Kept>)>,
    /// Videos that are not finished, and so not among them.
    pub videos: usize,
}

impl Survey {
    /// Reads a file to its end.
    ///
    /// # Errors
    /// When it cannot be read or is not what was written.
    pub fn of(path: &Path) -> Result<Self> {
        let mut reader = Reader::open(path)?;
        let mut survey = Self {
            header: reader.header.clone(),
            captures: Vec::new(),
            jobs: Vec::new(),
            stored: HashSet::new(),
            blobs: HashSet::new(),
        };
        while let Some((table, row)) = reader.next_row()? {
            match table.name {
                "captures" => survey.captures.push(text(&row, "id")?),
                "jobs" => {
                    let job = (text(&row, "id")?, row["state"] == "succeeded");
                    survey.jobs.push(job);
                }
                "capture_files" => survey.stored(&row, "capture_id")?,
                "job_files" => survey.stored(&row, "job_id")?,
                _ => {}
            }
        }
        Ok(survey)
    }

    fn stored(&mut self, row: &Map<String, Value>, owner: &str) -> Result<()> {
        self.stored.insert(text(row, owner)?);
        self.blobs.insert(Blob {
            digest: text(row, "digest")?,
            bytes: row["bytes"].as_u64().ok_or_else(|| damaged("bytes"))?,
        });
        Ok(())
    }
}

fn text(row: &Map<String, Value>, column: &str) -> Result<String> {
    let text = row.get(column).and_then(Value::as_str);
    text.map(str::to_owned).ok_or_else(|| damaged(column))
}

fn damaged(column: &str) -> ServerError {
    ServerError::Damaged {
        what: "row",
        detail: format!("it has no {column}"),
    }
}

/// Sees that the files which are named are in the store, and puts the others there.
///
/// # Errors
/// [`ServerError::NotMoved`] where one is nowhere; when the store or the disk refuses.
pub async fn keep(survey: &Survey, blobs: &Blobs, data: Option<&DataDir>) -> Result<Stored> {
    let named: Vec<Blob> = survey.blobs.iter().cloned().collect();
    if let Some(lacking) = blobs.lacks(named).await? {
        return Err(ServerError::NotMoved(format!(
            "{} lacks the blob {}, which the database names: give the store of files that the \
             server has used, or copy what lies there first",
            blobs.location(),
            lacking.digest
        )));
    }
    let in_data = |id: &&str| !survey.stored.contains(*id);
    let mut stored = Stored::default();
    let captures = survey.captures.iter().map(String::as_str).filter(in_data);
    for id in captures {
        let data = data.ok_or_else(|| nowhere("capture", id))?;
        let files = push_all(blobs, &data.capture(id), &|_| true).await?;
        if files.is_empty() {
            return Err(missing("capture", id, data));
        }
        stored.captures.push((id.to_owned(), files));
    }
    tracing::info!(captures = stored.captures.len(), "are in the store");
    let total = survey.jobs.len();
    for (done, (id, has_succeeded)) in survey.jobs.iter().enumerate() {
        if !in_data(&id.as_str()) {
            continue;
        }
        let Some(data) = data else {
            if *has_succeeded {
                return Err(nowhere("job", id));
            }
            continue;
        };
        let unfinished = unfinished_videos(data, id)?;
        stored.videos += unfinished.len();
        let wanted =
            |path: &str| is_kept(path) && !unfinished.iter().any(|video| path.starts_with(video));
        let files = push_all(blobs, &data.job(id), &wanted).await?;
        if files.is_empty() && *has_succeeded {
            return Err(missing("job", id, data));
        }
        stored.jobs.push((id.clone(), files));
        if (done + 1) % 50 == 0 {
            tracing::info!("{} of {total} jobs are in the store", done + 1);
        }
    }
    Ok(stored)
}

/// How the names of the files begin of videos that are not finished: who makes them stays behind.
fn unfinished_videos(data: &DataDir, job: &str) -> Result<Vec<String>> {
    let videos = videos_of(data, job)?;
    let unfinished = videos.iter().filter(|video| !video.state.is_over());
    let folder = |id: &str| Some(VideoFolder::of(data, job, id)?.path().to_owned());
    let below = data.job(job);
    let begins = unfinished.filter_map(|video| {
        let folder = folder(&video.id)?;
        let path = folder.strip_prefix(&below).ok()?.to_str()?;
        Some(format!("{path}/"))
    });
    Ok(begins.collect())
}

async fn push_all(
    blobs: &Blobs,
    folder: &Path,
    wanted: &(dyn Fn(&str) -> bool + Send + Sync),
) -> Result<Vec<Kept>> {
    let pushed = push(blobs, folder, wanted, &HashMap::new(), &mut Seen::default()).await?;
    if pushed.skipped > 0 {
        return Err(ServerError::NotMoved(format!(
            "{} has files that change, or whose names are no UTF-8",
            folder.display()
        )));
    }
    Ok(pushed.kept)
}

fn nowhere(what: &str, id: &str) -> ServerError {
    ServerError::NotMoved(format!(
        "the files of {what} {id} are in no store: give the data directory that was exported, by \
         --data DIR"
    ))
}

fn missing(what: &str, id: &str, data: &DataDir) -> ServerError {
    ServerError::NotMoved(format!(
        "{} has no files of {what} {id}: give the data directory that was exported, or delete the \
         {what} at the old server and export again",
        data.root().display()
    ))
}
