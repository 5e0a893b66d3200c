//! Evaluates the result of examining an upload.

use std::time::Duration;

use axum::http::StatusCode;
use fled_core::capture::CaptureWarning;

use super::Upload;
use super::videos::{name_of, not_filmed, turn};
use crate::app::App;
use crate::http::problem::{Problem, disk_full};
use crate::http::quota::over_quota;
use crate::validation::{CaptureReport, Refusal, image_bytes};
use crate::validator::{AssessError, AssessRequest, VideoFaultKind};

/// Hint for a photograph that crashed the process checking it.
const SAVE_ANEW: &str = "Leave it out, or save it again as a smaller JPEG or PNG.";

impl Upload {
    /// Examines the files; unusable photographs stay listed with the reason.
    ///
    /// # Errors
    /// 422 with the assessments if too few photographs are usable, and for photographs that crash
    /// the process examining them; 415 for a video if ffmpeg is missing, 422 for a video that
    /// cannot be read, 503 while other videos are being read; 507 if there is no room.
    pub async fn examine(&self, app: &App) -> Result<CaptureReport, Problem> {
        if self.files == 0 {
            return Err(Problem::unprocessable("bad_input", "The upload has no files.")
                .hint("Send photographs as parts named `images`, one ZIP file, or one video."));
        }
        let videos = self.videos(app)?;
        let name = videos.used.as_ref().map(|video| name_of(&video.file));
        let turn = match &name {
            Some(_) => Some(turn(app).await?),
            None => None,
        };
        let Some(free) = app.free_space().checked_sub(image_bytes(self.dir.path())) else {
            return Err(disk_full());
        };
        let request = AssessRequest {
            dir: self.dir.path().to_owned(),
            video: videos.used,
            room: free.min(self.most.unwrap_or(u64::MAX)),
            memory: app.limits.assessing_bytes,
        };
        let seen = app.validators.assess(self.dir.clone(), &request, turn).await;
        let no_room = || match self.most {
            Some(most) if most <= free => over_quota(),
            _ => disk_full(),
        };
        let seen = seen.map_err(|error| match error {
            AssessError::NoRoom => no_room(),
            AssessError::Full => disk_full(),
            AssessError::Video(fault) if fault.kind == VideoFaultKind::NoRoom => no_room(),
            AssessError::Video(fault) => not_filmed(&fault, name.as_deref().unwrap_or_default()),
            AssessError::Refused(refusal) => refused(*refusal),
            error => unseen(error, app),
        })?;
        let mut report = seen.report;
        report.images.extend(videos.unused);
        report.warnings.extend(seen.filmed.map(|message| CaptureWarning::new("video", message)));
        Ok(report)
    }
}

fn refused(refusal: Refusal) -> Problem {
    if refusal.is_ours {
        tracing::error!(refusal.detail, "cannot examine an upload");
        return Problem::internal();
    }
    let (status, code) = if refusal.unsupported_format {
        (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_format")
    } else {
        (StatusCode::UNPROCESSABLE_ENTITY, "bad_input")
    };
    let capture = serde_json::to_value(&refusal.report).unwrap_or_default();
    Problem::new(status, code, refusal.detail).hint(refusal.hint).capture(capture)
}

/// The problem if the process examining the upload did not finish.
fn unseen(error: AssessError, app: &App) -> Problem {
    let minutes = |time: Duration| time.as_secs().div_ceil(60);
    let (detail, hint) = match error {
        AssessError::Died { names, status } if names.is_empty() => (
            format!("The process that checked the upload crashed ({status})."),
            "Send photographs without a ZIP file to find out which of them causes it.".to_owned(),
        ),
        AssessError::Died { names, status } => (
            format!(
                "{}: the process that checked it crashed ({status}), maybe for lack of memory.",
                names.join(" or ")
            ),
            SAVE_ANEW.to_owned(),
        ),
        AssessError::Endless { name } => (
            format!(
                "{name}: checking it did not finish within {} s.",
                app.limits.photograph.as_secs()
            ),
            SAVE_ANEW.to_owned(),
        ),
        AssessError::Slow => (
            format!(
                "The upload could not be checked within {} minutes.",
                minutes(app.limits.assessing)
            ),
            "Send fewer or smaller photographs.".to_owned(),
        ),
        error => {
            tracing::error!(?error, "cannot check an upload");
            return Problem::internal();
        }
    };
    Problem::unprocessable("bad_input", detail).hint(hint)
}
