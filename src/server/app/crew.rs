//! Whether a worker is connected that can run a waiting job.

use super::App;
use super::readiness::Check;
use crate::error::Result;
use crate::store::{Engine, Machine, Needs};

/// The machines that take jobs now.
#[derive(Clone, Debug)]
pub struct Crew {
    machines: Vec<Machine>,
    /// Whether other machines can join.
    is_shared: bool,
}

impl Crew {
    /// Those of this deployment.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn of(app: &App) -> Result<Self> {
        let is_shared = app.store.engine() == Engine::Postgres;
        let mut machines = Vec::new();
        if app.config.workers > 0 && app.config.about.is_none() {
            machines.push(Machine::ANY);
        }
        // A server that says what its machine has is one of the workers that report.
        if is_shared || app.config.about.is_some() {
            let lost_before = app.store.now().await? - app.limits.lease_ms();
            let workers = app.store.workers().await?;
            let present = workers.iter().filter(|w| !w.draining && w.seen_at >= lost_before);
            machines.extend(present.map(|worker| Machine {
                has_gpu: worker.about.has_gpu,
                memory: worker.about.memory,
            }));
        }
        Ok(Self { machines, is_shared })
    }

    /// Why none of them can run a job with these needs, and what to start; `None` if one can.
    pub fn lacks(&self, needs: &Needs) -> Option<String> {
        let fits =
            |machine: &Machine| (machine.has_gpu || !needs.gpu) && machine.memory >= needs.memory;
        if self.machines.iter().any(fits) {
            return None;
        }
        let gib = needs.memory >> 30;
        Some(match (self.machines.is_empty(), self.is_shared) {
            (_, false) => {
                "This server runs no jobs. Start it again with `--workers 1` or more.".to_owned()
            }
            (true, true) if needs.gpu => format!(
                "No worker is connected. Start `fled worker` on a machine with a GPU and {gib} GiB \
                 of memory."
            ),
            (true, true) => "No worker is connected. Start one with `fled worker`.".to_owned(),
            (false, true) => format!(
                "No connected worker has a GPU and {gib} GiB of memory. Start `fled worker` on a \
                 machine that has."
            ),
        })
    }

    /// Whether any worker is connected, as a check.
    pub fn check(&self) -> Check {
        let lack = self.lacks(&Needs::default());
        let (detail, hint) = match lack.as_deref().map(|words| words.split_once(". ")) {
            None if self.machines.len() == 1 => ("1 worker can run jobs".to_owned(), ""),
            None => (format!("{} workers can run jobs", self.machines.len()), ""),
            Some(words) => {
                words.map_or_else(Default::default, |(what, to_do)| (what.into(), to_do))
            }
        };
        Check { name: "workers".to_owned(), ok: lack.is_none(), detail, hint: hint.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lack_names_the_worker_to_start() {
        let paper = Needs { gpu: true, memory: 12 << 30 };
        let crew =
            |machines: &[Machine], is_shared| Crew { machines: machines.to_vec(), is_shared };
        let small = Machine { has_gpu: false, memory: 8 << 30 };
        let of = |crew: Crew, needs: &Needs| crew.lacks(needs).unwrap_or_default();
        let any = Needs::default();
        assert!(of(crew(&[], false), &any).contains("--workers 1"));
        assert!(of(crew(&[], true), &any).contains("`fled worker`"));
        assert!(of(crew(&[], true), &paper).contains("with a GPU and 12 GiB"));
        assert_eq!(of(crew(&[small], true), &any), "");
        assert!(of(crew(&[small], true), &paper).starts_with("No connected worker has a GPU"));
        assert_eq!(of(crew(&[small, Machine::ANY], true), &paper), "");
        let check = crew(&[], false).check();
        assert_eq!((check.ok, &*check.detail), (false, "This server runs no jobs"));
        assert_eq!(check.hint, "Start it again with `--workers 1` or more.");
        assert!(crew(&[small], true).check().ok);
    }
}
