//! A worker that reaches its service by HTTP alone.

use std::fs;
use std::time::Duration;

use crate::config::{ServeConfig, Service};
use crate::coordinator::{Coordinator, Remote};
use crate::copies::remove_unused;
use crate::data::DataDir;
use crate::error::{Result, ServerError};
use crate::jobs::kill_orphans;
use crate::mirror::Mirror;
use crate::render::Renderers;
use crate::sweep::PERIOD;
use crate::traces::Traces;
use crate::workshop::{Lookers, Workshop};

/// Copies that nothing has used for so long are removed.
const UNUSED: Duration = Duration::from_secs(7 * 24 * 3600);

/// Opens the data directory, waits until the service answers, and takes up what an earlier worker
/// here has left.
///
/// # Errors
/// When the directory is in use or unusable, or the service refuses this worker.
pub async fn open(config: ServeConfig, service: &Service) -> Result<Workshop> {
    if config.about.is_none() {
        return Err(ServerError::Nameless);
    }
    let traces = Traces::from_environment()?;
    let data = DataDir::open(&config.data)?;
    let remote = Remote::new(service)?;
    let worker = data.worker()?;
    // Before others are given them.
    let orphans = kill_orphans(&jobs_here(&data)?);
    let released = begin(&remote, &worker, config.limits.look).await?;
    if !released.is_empty() || orphans > 0 {
        tracing::info!(
            jobs = released.len(),
            orphans,
            "jobs of an earlier worker go on"
        );
    }
    let workshop = workshop(config, data, remote, &worker);
    Ok(Workshop { traces, ..workshop })
}

fn workshop(config: ServeConfig, data: DataDir, remote: Remote, worker: &str) -> Workshop {
    let mirror = Mirror::new(Some(remote.blobs()));
    Workshop {
        limits: config.limits,
        data: data.into(),
        coordinator: Coordinator::Far(remote),
        renderers: Renderers::of(&config).into(),
        bells: Default::default(),
        mirror: mirror.into(),
        worker: worker.into(),
        running: Default::default(),
        wake: Default::default(),
        shutdown: Default::default(),
        traces: Traces::default(),
        lookers: Lookers::default(),
        config: config.into(),
    }
}

/// Says that this worker begins, until it is heard.
async fn begin(remote: &Remote, worker: &str, pause: Duration) -> Result<Vec<String>> {
    loop {
        match remote.begin(worker).await {
            Err(error) if error.passes() => {
                tracing::warn!(%error, "the service does not answer: waiting for it");
                tokio::time::sleep(pause).await;
            }
            answered => return answered,
        }
    }
}

/// The jobs that a worker has had here.
fn jobs_here(data: &DataDir) -> Result<Vec<String>> {
    let folder = data.jobs();
    let entries = fs::read_dir(&folder).map_err(ServerError::io(&folder))?;
    let names = entries.flatten().map(|entry| entry.file_name());
    Ok(names.filter_map(|name| name.into_string().ok()).collect())
}

/// Removes what was not used for long, now and then, until the worker stops.
pub async fn keep_tidy(work: Workshop) {
    loop {
        match remove_unused(&work, UNUSED).await {
            Ok(0) => {}
            Ok(removed) => tracing::info!(removed, "copies that were not used for a week are gone"),
            Err(error) => tracing::warn!(%error, "cannot look for copies that are not used"),
        }
        tokio::select! {
            () = tokio::time::sleep(PERIOD) => {}
            () = work.shutdown.cancelled() => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Lease;

    #[tokio::test]
    async fn only_copies_that_nothing_uses_for_long_go() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let nowhere = ([127, 0, 0, 1], 0).into();
        let config = ServeConfig::new(dir.path().into(), nowhere, 1).expect("a program");
        let service = Service {
            url: "http://127.0.0.1:9".to_owned(),
            token: None,
        };
        let remote = Remote::new(&service).expect("an address");
        let work = workshop(
            config,
            DataDir::open(dir.path()).expect("free"),
            remote,
            "w",
        );
        let old = std::time::SystemTime::now() - 2 * UNUSED;
        let folders = [
            (work.data.capture("old"), true),
            (work.data.capture("new"), false),
            (work.data.job("old"), true),
            (work.data.job("runs"), true),
        ];
        for (folder, is_old) in &folders {
            fs::create_dir(folder).expect("made");
            if *is_old {
                let folder = fs::File::open(folder).expect("opened");
                folder.set_modified(old).expect("set");
            }
        }
        let job = "runs".to_owned();
        work.running.begin(&Lease { job, epoch: 1 });
        assert_eq!(remove_unused(&work, UNUSED).await.expect("read"), 2);
        let left = folders.map(|(folder, _)| folder.exists());
        assert_eq!(left, [false, true, false, true]);
    }
}
