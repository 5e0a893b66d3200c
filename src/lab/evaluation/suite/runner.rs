//! Makes the runs of a suite in order. Recorded runs are not repeated; failed runs are.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::PathBuf;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::content::checksum;
use super::error::SuiteError;
use super::file::{CaptureEntry, Configuration, Suite};
use super::outcome::{Judged, Outcome, SuiteRun, steps, training_seconds};
use super::records::{Kind, Records};
use super::setup::{EvaluationOrder, RunFacts, RunOrder, Setup};
use crate::evaluation::report::Evaluation;
use fled_core::metrics::Report;
use fled_core::run_folder::RunFolder;

/// Steps derived from a time are rounded to a multiple of this: the timing is no more precise.
const STEPS_ROUNDED_TO: f64 = 100.0;

/// Starts the program with these arguments and waits for its end; returns its last error line if it
/// failed.
pub type Start<'a> = dyn FnMut(&[OsString]) -> Result<Result<(), String>, SuiteError> + 'a;

/// The callbacks for running a suite.
pub struct Hands<'a> {
    /// Starts the program.
    pub start: &'a mut Start<'a>,
    /// Reports the current work.
    pub tell: &'a mut dyn FnMut(&str),
}

/// Runs a suite and returns its runs in the order in which they were due. Without `hands`, only
/// returns the recorded runs.
///
/// Every configuration runs one seed on all captures before any runs its second. Configurations
/// whose steps derive from a time come after the others.
///
/// # Errors
/// [`SuiteError`], before the first run if the fault can be detected by then.
pub fn run(
    suite: &Suite,
    setup: &Setup,
    records: &Records,
    hands: Option<Hands<'_>>,
) -> Result<Vec<SuiteRun>, SuiteError> {
    let mut carrier = Carrier { suite, setup, records, hands, made: BTreeMap::new(), due: 0 };
    carrier.check()?;
    let (timed, others): (Vec<_>, Vec<_>) =
        suite.configurations.iter().partition(|configuration| configuration.seconds_of.is_some());
    let mut runs = Vec::new();
    for seed in 0..suite.seeds {
        for configuration in others.iter().chain(&timed) {
            for capture in &suite.captures {
                let place = Place { capture, configuration, seed };
                carrier.due += 1;
                let outcome = carrier.judged(place)?;
                runs.extend(outcome.map(|outcome| SuiteRun {
                    capture: capture.name.clone(),
                    configuration: configuration.name.clone(),
                    seed,
                    outcome,
                }));
            }
        }
    }
    Ok(runs)
}

/// A run's place in the suite.
#[derive(Clone, Copy)]
struct Place<'a> {
    capture: &'a CaptureEntry,
    configuration: &'a Configuration,
    seed: u64,
}

impl Place<'_> {
    fn of(self, configuration: &Configuration) -> (String, String, u64) {
        let capture = self.capture.name.clone();
        (capture, configuration.name.clone(), self.seed)
    }

    fn title(self) -> String {
        let (capture, configuration) = (&self.capture.name, &self.configuration.name);
        format!("{capture}, {configuration}, seed {}", self.seed)
    }
}

/// A run that finished.
struct Made {
    name: String,
    report: Report,
}

struct Carrier<'a, 'h> {
    suite: &'a Suite,
    setup: &'a Setup,
    records: &'a Records,
    hands: Option<Hands<'h>>,
    made: BTreeMap<(String, String, u64), Made>,
    due: usize,
}

/// A call to the program.
struct Task<'a> {
    kind: Kind,
    title: String,
    words: Vec<OsString>,
    /// The folder that the program fills.
    folder: PathBuf,
    /// The file in the folder that is recorded.
    result: PathBuf,
    /// Names the inputs that no longer match the facts.
    changed: &'a dyn Fn() -> Result<Vec<&'static str>, SuiteError>,
}

impl Carrier<'_, '_> {
    /// Checks all that can be checked before the first run: options, captures, truth, networks.
    fn check(&self) -> Result<(), SuiteError> {
        for capture in &self.suite.captures {
            for configuration in &self.suite.configurations {
                let place = Place { capture, configuration, seed: 0 };
                let order = Setup::order(self.suite, capture, configuration, (0, None))?;
                self.setup.run_facts(&order, &place.title())?;
            }
            let order = self.evaluation_order(capture);
            self.setup.evaluation_facts(&order, ("", None))?;
        }
        Ok(())
    }

    /// The outcome of a run; `None` if it is not recorded and no runs are made.
    fn judged(&mut self, place: Place<'_>) -> Result<Option<Outcome<Judged>>, SuiteError> {
        let first = &self.suite.configurations[0];
        let Some(steps) = self.steps(place)? else {
            return Ok(self.lacking("the runs are not there from which its steps follow"));
        };
        let (capture, of) = (place.capture, place.configuration);
        let order = Setup::order(self.suite, capture, of, (place.seed, steps))?;
        let facts = self.setup.run_facts(&order, &place.title())?;
        let name = Records::name(&facts);
        let report = match self.run(place, &order, &facts)? {
            Some(Outcome::Finished(report)) => report,
            Some(Outcome::Failed(line)) => return Ok(Some(Outcome::Failed(line))),
            None => return Ok(None),
        };
        let made = Made { name: name.clone(), report: report.clone() };
        self.made.insert(place.of(of), made);
        let seen_from = match self.made.get(&place.of(first)) {
            Some(base) => (base.name != name).then(|| base.name.clone()),
            None => return Ok(self.lacking("no run of the first configuration says what is seen")),
        };
        let evaluation = self.evaluate(place, &facts, (&name, seen_from.as_deref()))?;
        Ok(evaluation.map(|evaluation| match evaluation {
            Outcome::Finished(evaluation) => {
                Outcome::Finished(Judged::new(name, &report, evaluation))
            }
            Outcome::Failed(line) => Outcome::Failed(line),
        }))
    }

    /// The failure of a run that depends on a missing one; `None` if no runs are made.
    fn lacking(&self, what: &str) -> Option<Outcome<Judged>> {
        self.hands.as_ref()?;
        Some(Outcome::Failed(what.to_owned()))
    }

    /// The steps of a run if they derive from a time, and `Some(None)` if the options give them;
    /// `None` if the runs from which they derive are missing.
    fn steps(&self, place: Place<'_>) -> Result<Option<Option<u64>>, SuiteError> {
        let Some(timing) = self.suite.timing(place.configuration) else {
            return Ok(Some(None));
        };
        let of = |configuration| self.made.get(&place.of(configuration));
        let (Some(time), Some(rate)) = (of(timing.time_of), of(timing.rate_of)) else {
            return Ok(None);
        };
        let rate = steps(&rate.report) as f64 / training_seconds(&rate.report);
        let (capture, configuration) = (place.capture, place.configuration);
        let order = Setup::order(self.suite, capture, configuration, (place.seed, None))?;
        let facts = self.setup.run_facts(&order, &place.title())?;
        let a_round =
            training_seconds(&time.report) * rate / f64::from(facts.options.round_count());
        let rounded = (a_round / STEPS_ROUNDED_TO).round() * STEPS_ROUNDED_TO;
        Ok(Some(Some(rounded.max(STEPS_ROUNDED_TO) as u64)))
    }

    fn run(
        &mut self,
        place: Place<'_>,
        order: &RunOrder,
        facts: &RunFacts,
    ) -> Result<Option<Outcome<Report>>, SuiteError> {
        let folder = self.records.folder(Kind::Run, &Records::name(facts));
        let poses = facts.poses.clone();
        let poses = poses.unwrap_or_else(|| self.records.poses(&facts.program));
        let setup = self.setup;
        let task = Task {
            kind: Kind::Run,
            title: place.title(),
            words: order.words(&folder, &poses),
            result: RunFolder::new(&folder).metrics(),
            folder: folder.clone(),
            changed: &|| setup.changed(facts, order),
        };
        let outcome = self.done(&task, facts)?;
        if let (Some(Outcome::Finished(_)), Some(_)) = (&outcome, &self.hands) {
            // Most of a run's size is needed only to resume it. Runs recorded earlier have already
            // lost it.
            let _ = fs::remove_dir_all(RunFolder::new(&folder).work().root());
        }
        Ok(outcome)
    }

    fn evaluation_order(&self, capture: &CaptureEntry) -> EvaluationOrder {
        EvaluationOrder {
            run: PathBuf::new(),
            seen_from: None,
            truth: capture.truth.clone(),
            lpips: self.suite.lpips.clone(),
            inside: self.suite.inside,
            adapter: String::new(),
        }
    }

    fn evaluate(
        &mut self,
        place: Place<'_>,
        of: &RunFacts,
        (run, seen_from): (&str, Option<&str>),
    ) -> Result<Option<Outcome<Evaluation>>, SuiteError> {
        let folder = |name: &str| self.records.folder(Kind::Run, name);
        let order = EvaluationOrder {
            run: folder(run),
            seen_from: seen_from.map(folder),
            adapter: of.options.adapter.clone(),
            ..self.evaluation_order(place.capture)
        };
        let facts = self.setup.evaluation_facts(&order, (run, seen_from))?;
        let folder = self.records.folder(Kind::Evaluation, &Records::name(&facts));
        let changed = || {
            let same = checksum(&order.truth)? == facts.truth;
            Ok(if same { vec![] } else { vec!["the truth"] })
        };
        let task = Task {
            kind: Kind::Evaluation,
            title: place.title(),
            words: order.words(&folder),
            result: folder.join("evaluation.json"),
            folder,
            changed: &changed,
        };
        self.done(&task, &facts)
    }

    /// The recorded outcome of the facts, else that of the task run now.
    fn done<T: Serialize + DeserializeOwned>(
        &mut self,
        task: &Task<'_>,
        facts: &impl Serialize,
    ) -> Result<Option<Outcome<T>>, SuiteError> {
        let recorded = self.records.read(task.kind, facts)?;
        let Some(hands) = &mut self.hands else {
            return Ok(recorded);
        };
        if let Some(Outcome::Finished(_)) = recorded {
            return Ok(recorded);
        }
        let configurations = self.suite.configurations.len();
        let all = self.suite.captures.len() * configurations * self.suite.seeds as usize;
        let words: Vec<_> = task.words.iter().map(|word| word.to_string_lossy()).collect();
        (hands.tell)(&format!("[{}/{all}] {}", self.due, task.title));
        (hands.tell)(&format!("  fled {}", words.join(" ")));
        let outcome = match (hands.start)(&task.words)? {
            Ok(()) => read(task),
            Err(line) => Outcome::Failed(line),
        };
        if let Outcome::Failed(line) = &outcome {
            (hands.tell)(&format!("  failed: {line}"));
        }
        let changed = (task.changed)()?;
        if !changed.is_empty() {
            return Err(SuiteError::Changed {
                what: changed.join(" and "),
                run: task.folder.clone(),
            });
        }
        self.records.write(task.kind, facts, &outcome)?;
        Ok(Some(outcome))
    }
}

/// Reads the result of a task. A missing or invalid file fails only this run.
fn read<T: DeserializeOwned>(task: &Task<'_>) -> Outcome<T> {
    let read = fs::read(&task.result).map_err(|error| error.to_string());
    let parsed =
        read.and_then(|bytes| serde_json::from_slice(&bytes).map_err(|error| error.to_string()));
    match parsed {
        Ok(value) => Outcome::Finished(value),
        Err(error) => Outcome::Failed(format!("{}: {error}", task.result.display())),
    }
}
