//! Readiness of the machine: database, disk, and the checks of a child process on the adapter,
//! COLMAP, ONNX Runtime and the models.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::crew::Crew;
use crate::process::{Group, Line};
use crate::redaction::without_paths;
use crate::store::Engine;

/// One check of the server.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Check {
    /// Name: `database`, `disk`, `workers`, `adapter`, `colmap`, `onnxruntime`, `models` and so on.
    pub name: String,
    /// Whether the check passed.
    pub ok: bool,
    /// What was found.
    pub detail: String,
    /// What to do if it failed.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub hint: String,
}

/// Cached results of the child process and their time.
#[derive(Clone, Debug)]
pub struct Remembered {
    at: Instant,
    doctor: Doctor,
}

/// How long the result of the child process is cached.
const BELIEVED: Duration = Duration::from_secs(60);
/// Timeout of the child process.
const PATIENCE: Duration = Duration::from_secs(60);

/// The output of the child process, one line of JSON.
#[derive(Clone, Debug, Deserialize)]
struct Doctor {
    checks: Vec<Check>,
    #[serde(default)]
    has_gpu: Option<bool>,
}

/// Runs all checks. Whether this machine has a GPU is known only if all jobs run here.
pub async fn checks(app: &App) -> (Vec<Check>, Option<bool>) {
    let mut checks = vec![database(app).await, disk(app)];
    checks.extend(files(app).await);
    // Without a database, its own check says so.
    checks.extend(Crew::of(app).await.ok().map(|crew| crew.check()));
    // Concurrent callers wait for one child process instead of starting several.
    let mut remembered = app.readiness.lock().await;
    if remembered.as_ref().is_none_or(|known| known.at.elapsed() > BELIEVED) {
        *remembered = Some(Remembered { at: Instant::now(), doctor: doctor(app).await });
    }
    let mut has_gpu = None;
    if let Some(Remembered { doctor, .. }) = remembered.as_ref() {
        checks.extend(doctor.checks.iter().filter(|check| check.name != "disk").cloned());
        has_gpu = doctor.has_gpu.filter(|_| app.store.engine() == Engine::Sqlite);
    }
    (checks, has_gpu)
}

async fn database(app: &App) -> Check {
    let outcome = app.store.check().await;
    Check {
        name: "database".to_owned(),
        ok: outcome.is_ok(),
        detail: match &outcome {
            Ok(()) => "responds and is writable".to_owned(),
            Err(error) => {
                tracing::error!(%error, "cannot write to the database");
                without_paths(&error.to_string())
            }
        },
        hint: outcome
            .map_or("Check the permissions and free space of the data directory.", |()| "")
            .to_owned(),
    }
}

/// Checks the shared blob store, if there is one.
async fn files(app: &App) -> Option<Check> {
    let outcome = app.blob_cache.blobs()?.check().await;
    Some(Check {
        name: "store".to_owned(),
        ok: outcome.is_ok(),
        detail: match &outcome {
            Ok(()) => "responds and is writable".to_owned(),
            Err(error) => {
                tracing::error!(%error, "cannot use the file store");
                without_paths(&error.to_string())
            }
        },
        hint: outcome
            .map_or("Check the store given by --store and its credentials.", |()| "")
            .to_owned(),
    })
}

fn disk(app: &App) -> Check {
    let needed = app.limits.min_free_bytes;
    let (ok, detail) = match app.data.free_bytes() {
        Ok(free) => (free >= needed, format!("{:.1} GiB free", free as f64 / f64::from(1 << 30))),
        Err(error) => (false, error.to_string()),
    };
    let hint = if ok { String::new() } else { format!("Free at least {} MiB.", needed >> 20) };
    Check { name: "disk".to_owned(), ok, detail, hint }
}

async fn doctor(app: &App) -> Doctor {
    match tokio::time::timeout(PATIENCE, ask_doctor(app)).await {
        Ok(Ok(mut doctor)) => {
            for check in &mut doctor.checks {
                check.detail = without_paths(&check.detail);
            }
            doctor
        }
        Ok(Err(detail)) => unknown(detail),
        Err(_) => unknown(format!("no answer within {} s", PATIENCE.as_secs())),
    }
}

fn unknown(detail: String) -> Doctor {
    let hint = "Run `fled doctor` on the server.".to_owned();
    let check = Check { name: "environment".to_owned(), ok: false, detail, hint };
    Doctor { checks: vec![check], has_gpu: None }
}

async fn ask_doctor(app: &App) -> Result<Doctor, String> {
    let mut group =
        Group::spawn(&app.config.doctor_command, &[], &[]).map_err(|error| error.to_string())?;
    drop(group.stdin.take());
    let mut said = String::new();
    while let Some(line) = group.next_line().await {
        match line {
            Line::Output(text) => match serde_json::from_str::<Doctor>(&text) {
                Ok(doctor) => return Ok(doctor),
                Err(_) => said.push_str(&text),
            },
            Line::Error(text) => tracing::info!(text, "doctor"),
        }
    }
    // The output has several lines.
    serde_json::from_str(&said).map_err(|_| "the output of `fled doctor` cannot be read".to_owned())
}
