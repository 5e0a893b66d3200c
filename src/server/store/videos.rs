//! Videos: jobs of another kind. Each shows the result of a job, and is deleted with that job.

use serde_json::{Value, json};
use sqlx::Row;
use sqlx::any::AnyRow;

use super::engine::Cells;
use super::jobs::{JobRow, from_row};
use super::notifier::Change;
use super::{Store, events};
use crate::error::Result;
use crate::store::state::JobState;

/// A stored video.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoRow {
    /// The video's own job, whose options are its plan.
    pub job: JobRow,
    /// Its size in bytes, once rendered.
    pub bytes: Option<u64>,
    /// The number of videos before it in the queue, while queued.
    pub ahead: Option<u32>,
}

/// Limits on the number of videos.
#[derive(Clone, Copy, Debug)]
pub struct VideoRoom {
    /// Videos of one job.
    pub of_job: usize,
    /// Queued and running videos of all jobs.
    pub unfinished: usize,
}

/// Outcome of a request for a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoCreation {
    /// It is queued.
    Created,
    /// Its job already has the maximum, which is this number.
    JobFull(usize),
    /// The queue is full.
    QueueFull,
    /// Its job is gone.
    Gone,
}

const VIDEOS: &str = "SELECT jobs.*, CASE state WHEN 'queued' THEN
        (SELECT COUNT(*) FROM jobs AS ahead WHERE ahead.video_of IS NOT NULL
         AND (ahead.state = 'running' OR (ahead.state = 'queued'
             AND (ahead.created_at, ahead.id) < (jobs.created_at, jobs.id))))
    END AS ahead
    FROM jobs WHERE video_of = $1";

impl Store {
    /// Queues a video of a job, if there is room for it.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn create_video(
        &self,
        id: &str,
        job: &str,
        plan: &Value,
        room: VideoRoom,
    ) -> Result<VideoCreation> {
        let mut tx = self.write().await?;
        let (of_job, unfinished): (i64, i64) = sqlx::query_as(
            "SELECT COUNT(CASE WHEN video_of = $1 THEN 1 END),
                    COUNT(CASE WHEN state IN ('queued', 'running') THEN 1 END)
             FROM jobs WHERE video_of IS NOT NULL",
        )
        .bind(job)
        .fetch_one(&mut *tx)
        .await?;
        let count = |number: i64| usize::try_from(number).unwrap_or(usize::MAX);
        if count(unfinished) >= room.unfinished {
            return Ok(VideoCreation::QueueFull);
        }
        if count(of_job) >= room.of_job {
            return Ok(VideoCreation::JobFull(count(of_job)));
        }
        let made = sqlx::query(
            "INSERT INTO jobs (id, name, capture_id, preset, options, created_at, video_of)
             SELECT $1, name, capture_id, preset, $2, $3, id FROM jobs
             WHERE id = $4 AND video_of IS NULL",
        )
        .bind(id)
        .bind(plan.to_string())
        .bind(tx.now)
        .bind(job)
        .execute(&mut *tx)
        .await?;
        if made.rows_affected() == 0 {
            return Ok(VideoCreation::Gone);
        }
        let queued = json!({ "state": JobState::Queued.name() });
        events::append(&mut tx, id, "state", &queued).await?;
        tx.commit().await?;
        Ok(VideoCreation::Created)
    }

    /// Returns the videos of a job, newest first.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn videos(&self, job: &str) -> Result<Vec<VideoRow>> {
        let all = format!("{VIDEOS} ORDER BY id DESC");
        let all = sqlx::query(sqlx::AssertSqlSafe(all)).bind(job);
        let rows = all.fetch_all(&self.pool).await?;
        rows.iter().map(video).collect()
    }

    /// Returns a video of a job.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn video(&self, job: &str, id: &str) -> Result<Option<VideoRow>> {
        let one = format!("{VIDEOS} AND id = $2");
        let one = sqlx::query(sqlx::AssertSqlSafe(one)).bind(job).bind(id);
        let row = one.fetch_optional(&self.pool).await?;
        row.as_ref().map(video).transpose()
    }

    /// Deletes a video in any state; a worker that is rendering it loses its lease. `Ok(false)` if
    /// it does not exist.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn delete_video(&self, job: &str, id: &str) -> Result<bool> {
        let mut tx = self.begin().await?;
        let done = sqlx::query("DELETE FROM jobs WHERE video_of = $1 AND id = $2")
            .bind(job)
            .bind(id)
            .execute(&mut *tx)
            .await?;
        tx.notify(id, Change::Job).await?;
        tx.commit().await?;
        Ok(done.rows_affected() == 1)
    }

    /// Returns the jobs for which an earlier build stored video files.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn jobs_with_video_files(&self) -> Result<Vec<String>> {
        let jobs = "SELECT DISTINCT job_id FROM job_files WHERE path LIKE 'videos/%/video.json'";
        Ok(sqlx::query_scalar(jobs).fetch_all(&self.pool).await?)
    }

    /// Converts a video of an earlier build to a job. `record` is its `video.json`, and its file
    /// becomes the new job's.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn adopt_video(&self, job: &str, id: &str, record: &Value) -> Result<()> {
        let mut plan = record["plan"].clone();
        plan["width"] = record["width"].clone();
        plan["height"] = record["height"].clone();
        let over = record["state"].as_str();
        let over = over.filter(|state| ["succeeded", "failed"].contains(state));
        let mut tx = self.write().await?;
        let error = &record["error"];
        sqlx::query(
            "INSERT INTO jobs (id, name, capture_id, preset, options, created_at, video_of, state,
                 finished_at, bytes, error_code, error_detail, error_hint)
             SELECT $1, name, capture_id, preset, $2, $3, id, $4, $5, $6, $7, $8, $9 FROM jobs
             WHERE id = $10 ON CONFLICT DO NOTHING",
        )
        .bind(id)
        .bind(plan.to_string())
        .bind(record["created_at"].as_i64().unwrap_or(tx.now))
        .bind(over.unwrap_or("queued"))
        .bind(record["finished_at"].as_i64())
        .bind(record["bytes"].as_i64())
        .bind(error.is_object().then_some("internal"))
        .bind(error["detail"].as_str())
        .bind(error["hint"].as_str())
        .bind(job)
        .execute(&mut *tx)
        .await?;
        let folder = format!("videos/{id}/");
        for change in [
            "UPDATE job_files SET job_id = $2, path = 'output/video.mp4'
             WHERE job_id = $1 AND path = $3 || 'video.mp4'",
            "DELETE FROM job_files WHERE job_id = $1 AND path LIKE $3 || '%' AND job_id <> $2",
            "UPDATE jobs SET files_version = files_version + 1 WHERE id IN ($1, $2) AND $3 <> ''",
        ] {
            let change = sqlx::query(change).bind(job).bind(id).bind(&folder);
            change.execute(&mut *tx).await?;
        }
        tx.commit().await
    }

    /// Deletes all videos from a copy of a database that lacks their files.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn forget_videos(&self) -> Result<()> {
        let forget = sqlx::query("DELETE FROM jobs WHERE video_of IS NOT NULL");
        forget.execute(&self.pool).await?;
        Ok(())
    }
}

fn video(row: &AnyRow) -> Result<VideoRow> {
    let bytes: Option<i64> = row.try_get("bytes")?;
    Ok(VideoRow {
        job: from_row(row)?,
        bytes: bytes.map(i64::unsigned_abs),
        ahead: row.count_if_any("ahead")?,
    })
}
