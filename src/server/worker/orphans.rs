//! Kills processes left running by a killed server.
//!
//! A job's process asks the kernel to end it with its server, but its own children, such as COLMAP,
//! may continue, write into the job's directory and use the machine.

use std::fs;
use std::path::Path;

use rustix::process::{Pid, Signal, kill_process};

use crate::process::JOB_VARIABLE;

/// Kills every process marked with one of `jobs`. Returns their number.
pub fn kill_orphans(jobs: &[String]) -> usize {
    let Ok(processes) = fs::read_dir("/proc") else {
        return 0;
    };
    processes
        .flatten()
        .filter(|entry| marked(&entry.path(), jobs))
        .filter_map(|entry| Pid::from_raw(entry.file_name().to_str()?.parse().ok()?))
        .filter(|&pid| kill_process(pid, Signal::KILL).is_ok())
        .count()
}

fn marked(process: &Path, jobs: &[String]) -> bool {
    // Processes of other users cannot be read, and none of them belongs to a job.
    let Ok(environment) = fs::read(process.join("environ")) else {
        return false;
    };
    environment.split(|&byte| byte == 0).any(|variable| {
        variable
            .strip_prefix(JOB_VARIABLE.as_bytes())
            .and_then(|rest| rest.strip_prefix(b"="))
            .is_some_and(|job| jobs.iter().any(|known| known.as_bytes() == job))
    })
}

#[cfg(test)]
mod tests {
    use std::process::Command;
    use std::thread;
    use std::time::{Duration, Instant};

    use super::*;

    #[test]
    fn only_processes_of_the_named_jobs_are_killed() {
        let sleeper = |job: &str| {
            Command::new("sleep").arg("60").env(JOB_VARIABLE, job).spawn().expect("sleep starts")
        };
        let (mut ours, mut other) = (sleeper("orphan-test-a"), sleeper("orphan-test-b"));
        // `spawn` returns a moment before the kernel shows the new program's environment.
        for child in [&ours, &other] {
            let environment = format!("/proc/{}/environ", child.id());
            let deadline = Instant::now() + Duration::from_secs(10);
            while fs::read(&environment).is_ok_and(|bytes| bytes.is_empty())
                && Instant::now() < deadline
            {
                thread::sleep(Duration::from_millis(5));
            }
        }
        assert_eq!(kill_orphans(&["orphan-test-a".to_owned()]), 1);
        assert!(!ours.wait().expect("ended").success());
        assert!(other.try_wait().expect("known").is_none(), "another job's process was killed");
        other.kill().expect("kill");
        other.wait().expect("ended");
    }
}
