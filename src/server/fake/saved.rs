//! Checkpoints of a fake training: one at a fixed step, and one when the process is asked to stop.

use std::error::Error;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{sleep, spawn};
use std::time::Duration;

use fled_core::event::Event;
use tokio::signal::unix::{SignalKind, signal};

use crate::protocol::tell;

/// The step after which the only unrequested checkpoint is saved.
const BY_THE_CLOCK: u64 = 2;

/// The checkpoint of a training.
pub struct Saved {
    path: PathBuf,
    asked: Arc<AtomicBool>,
    /// How long a requested checkpoint takes to write.
    takes: Duration,
}

impl Saved {
    /// Uses this file. From now on SIGTERM ends the process only after its next step.
    pub fn new(path: PathBuf) -> Result<Self, Box<dyn Error>> {
        let asked = Arc::new(AtomicBool::new(false));
        let raised = asked.clone();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        let mut signals = runtime.block_on(async { signal(SignalKind::terminate()) })?;
        spawn(move || {
            runtime.block_on(signals.recv());
            raised.store(true, Ordering::Relaxed);
        });
        let takes = std::env::var("FLED_FAKE_SAVING_MS").unwrap_or_else(|_| "0".to_owned());
        Ok(Self { path, asked, takes: Duration::from_millis(takes.parse()?) })
    }

    /// The number of steps done before it resumes.
    pub fn step(&self) -> Result<u64, Box<dyn Error>> {
        let Ok(saved) = fs::read_to_string(&self.path) else {
            return Ok(0);
        };
        let message = format!("resumed at step {saved}");
        tell(&Event::Log { message });
        Ok(saved.parse()?)
    }

    /// Records a step; if the process was asked to stop, saves a checkpoint and exits.
    pub fn done(&self, step: u64) -> Result<(), Box<dyn Error>> {
        let is_asked = self.asked.load(Ordering::Relaxed);
        if is_asked {
            sleep(self.takes);
        }
        if is_asked || step == BY_THE_CLOCK {
            fs::create_dir_all(self.path.parent().ok_or("no folder")?)?;
            let beside = self.path.with_extension("tmp");
            fs::write(&beside, step.to_string())?;
            fs::rename(beside, &self.path)?;
        }
        if is_asked {
            let message = format!("stopped at step {step}");
            tell(&Event::Log { message });
            std::process::exit(1);
        }
        Ok(())
    }

    /// Removes the checkpoint of a finished training.
    pub fn forget(&self) -> Result<(), Box<dyn Error>> {
        Ok(fs::remove_file(&self.path)?)
    }
}
