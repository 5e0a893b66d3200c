//! A worker that is killed at a given failpoint.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

use fled_server::{Failpoint, Watcher};
use rustix::process::{Signal, getpid, kill_process};

/// The failpoint to die at, and which occurrence of it.
static PLAN: OnceLock<(Failpoint, u32)> = OnceLock::new();
static PASSED: AtomicU32 = AtomicU32::new(0);

/// Parses `FLED_FAKE_DIE_AT`: `named`, or `named:3` for the third time.
pub fn planned() -> Result<Option<Watcher>, String> {
    let Ok(plan) = std::env::var("FLED_FAKE_DIE_AT") else {
        return Ok(None);
    };
    let (name, times) = plan.split_once(':').unwrap_or((&plan, "1"));
    let failpoint = Failpoint::ALL.into_iter().find(|failpoint| failpoint.to_string() == name);
    let failpoint = failpoint.ok_or_else(|| format!("no such failpoint: {name}"))?;
    PLAN.get_or_init(|| (failpoint, times.parse().unwrap_or(1)));
    Ok(Some(pass))
}

fn pass(failpoint: Failpoint) {
    let Some(&(planned, times)) = PLAN.get() else {
        return;
    };
    if failpoint == planned && PASSED.fetch_add(1, Ordering::Relaxed) + 1 == times {
        // Like the kernel when memory runs out: no clean-up.
        let _ = kill_process(getpid(), Signal::KILL);
        std::thread::park();
    }
}
