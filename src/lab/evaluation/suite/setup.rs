//! All inputs of a run and an evaluation, and the arguments that start them.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Value, json};

use super::content::checksum;
use super::error::SuiteError;
use super::file::{CaptureEntry, Configuration, OptionSet, Suite};
use fled_core::deblur::Model;
use fled_core::pipeline::config::{Options, Preset};

/// All inputs that determine the result of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunFacts {
    /// Hash of the program.
    pub program: String,
    /// The components that compute: adapter, COLMAP, ONNX Runtime, networks.
    pub machine: BTreeMap<String, String>,
    /// The complete options.
    pub options: Options,
    /// Hash of the capture's content.
    pub capture: String,
    /// Hashes of the networks that the options name.
    pub networks: BTreeMap<String, String>,
    /// The pose cache, if it is not that of the records.
    pub poses: Option<PathBuf>,
}

/// All inputs that determine the result of an evaluation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct EvaluationFacts {
    /// Name of the run's record.
    pub run: String,
    /// Hash of the sharp photographs and their cameras.
    pub truth: String,
    /// Hash of the LPIPS network.
    pub lpips: Option<String>,
    /// Whether views outside the training views' path are left out.
    pub inside: bool,
    /// Name of the record of the run whose scene decides which pixels are seen; `None` is the run
    /// itself.
    pub seen_from: Option<String>,
}

/// A run to make.
#[derive(Clone, Debug, PartialEq)]
pub struct RunOrder {
    /// The capture.
    pub capture: PathBuf,
    /// The preset that `set` overrides.
    pub preset: Preset,
    /// Options that override the preset's.
    pub set: OptionSet,
}

/// An evaluation to make.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EvaluationOrder {
    /// The run's folder.
    pub run: PathBuf,
    /// The folder of the run whose scene decides which pixels are seen.
    pub seen_from: Option<PathBuf>,
    /// Sharp photographs and their cameras.
    pub truth: PathBuf,
    /// The LPIPS network.
    pub lpips: Option<PathBuf>,
    /// Whether views outside the training views' path are left out.
    pub inside: bool,
    /// The adapter that renders.
    pub adapter: String,
}

impl RunOrder {
    /// The arguments of `fled run`.
    pub fn words(&self, out: &Path, poses: &Path) -> Vec<OsString> {
        let mut words: Vec<OsString> = vec![
            "run".into(),
            self.capture.clone().into(),
            "--out".into(),
            out.into(),
            "--cache".into(),
            poses.into(),
            "--preset".into(),
            self.preset.name().into(),
        ];
        for (key, value) in &self.set {
            let value = match value {
                Value::String(text) => text.clone(),
                value => value.to_string(),
            };
            words.extend(["--set".into(), format!("{key}={value}").into()]);
        }
        words
    }
}

impl EvaluationOrder {
    /// The arguments of `fled eval`.
    pub fn words(&self, out: &Path) -> Vec<OsString> {
        let mut words: Vec<OsString> = vec![
            "eval".into(),
            self.run.clone().into(),
            "--truth".into(),
            self.truth.clone().into(),
            "--out".into(),
            out.into(),
            "--adapter".into(),
            self.adapter.clone().into(),
        ];
        for (flag, path) in [("--lpips", &self.lpips), ("--seen-from", &self.seen_from)] {
            if let Some(path) = path {
                words.extend([flag.into(), path.clone().into()]);
            }
        }
        if self.inside {
            words.push("--inside".into());
        }
        words
    }
}

/// A build of the program on a machine.
#[derive(Debug)]
pub struct Setup {
    program: PathBuf,
    /// Hash of the program when it was opened.
    pub checksum: String,
    machine: BTreeMap<String, String>,
    models: Vec<PathBuf>,
    /// The pose cache, if it is not that of the records.
    pub poses: Option<PathBuf>,
    /// Hashes computed so far: captures are large.
    known: RefCell<BTreeMap<PathBuf, String>>,
}

impl Setup {
    /// The build at `program`. `machine` describes the components that compute, as the program
    /// reports them, and `models` are the folders of its networks.
    ///
    /// # Errors
    /// [`SuiteError::Io`] when the program cannot be read.
    pub fn open(
        program: &Path,
        machine: BTreeMap<String, String>,
        models: Vec<PathBuf>,
    ) -> Result<Self, SuiteError> {
        Ok(Self {
            program: program.to_owned(),
            checksum: checksum(program)?,
            machine,
            models,
            poses: None,
            known: RefCell::default(),
        })
    }

    /// The order of a run; `steps` override its options if they derive from a time.
    ///
    /// # Errors
    /// [`SuiteError::Wrong`] for a missing material.
    pub fn order(
        suite: &Suite,
        capture: &CaptureEntry,
        configuration: &Configuration,
        (seed, steps): (u64, Option<u64>),
    ) -> Result<RunOrder, SuiteError> {
        let material = suite.material(capture, configuration).ok_or_else(|| {
            let (capture, of) = (&capture.name, &configuration.name);
            SuiteError::Wrong(format!("`{capture}` has no material for `{of}`"))
        })?;
        let mut set = suite.set.clone();
        set.extend(capture.set.clone());
        set.insert("seed".to_owned(), json!(seed));
        set.extend(configuration.set.clone());
        set.extend(steps.map(|steps| ("steps".to_owned(), json!(steps))));
        Ok(RunOrder { capture: material.to_owned(), preset: suite.preset, set })
    }

    /// The facts of a run.
    ///
    /// # Errors
    /// [`SuiteError::Options`] for invalid options, [`SuiteError::Wrong`] for a missing network,
    /// [`SuiteError::Io`].
    pub fn run_facts(&self, order: &RunOrder, of: &str) -> Result<RunFacts, SuiteError> {
        let options = options(order, of)?;
        Ok(RunFacts {
            program: self.checksum.clone(),
            machine: self.machine.clone(),
            capture: self.known(&order.capture)?,
            networks: self.networks(&options)?,
            options,
            poses: self.poses.clone(),
        })
    }

    /// The facts of an evaluation of runs whose records have these names.
    ///
    /// # Errors
    /// [`SuiteError::Io`].
    pub fn evaluation_facts(
        &self,
        order: &EvaluationOrder,
        (run, seen_from): (&str, Option<&str>),
    ) -> Result<EvaluationFacts, SuiteError> {
        Ok(EvaluationFacts {
            run: run.to_owned(),
            truth: self.known(&order.truth)?,
            lpips: order.lpips.as_deref().map(|path| self.known(path)).transpose()?,
            inside: order.inside,
            seen_from: seen_from.map(str::to_owned),
        })
    }

    /// Names the facts of a run that no longer hold.
    ///
    /// # Errors
    /// [`SuiteError::Io`].
    pub fn changed(
        &self,
        facts: &RunFacts,
        order: &RunOrder,
    ) -> Result<Vec<&'static str>, SuiteError> {
        let still = [
            ("the program", checksum(&self.program)? == facts.program),
            ("the capture", checksum(&order.capture)? == facts.capture),
            ("a network", self.networks(&facts.options)? == facts.networks),
        ];
        let changed = still.into_iter().filter(|(_, same)| !same);
        Ok(changed.map(|(what, _)| what).collect())
    }

    fn known(&self, path: &Path) -> Result<String, SuiteError> {
        if let Some(known) = self.known.borrow().get(path) {
            return Ok(known.clone());
        }
        let found = checksum(path)?;
        self.known.borrow_mut().insert(path.to_owned(), found.clone());
        Ok(found)
    }

    /// Hash of every network that an option names.
    fn networks(&self, options: &Options) -> Result<BTreeMap<String, String>, SuiteError> {
        let named = options.networks().into_iter().filter(|o| o.choice.is_network());
        named
            .map(|option| {
                let wrong = |error| SuiteError::Wrong(format!("`{}`: {error}", option.key));
                let model = Model::find(option.choice.as_str(), &self.models).map_err(wrong)?;
                Ok((option.key.to_owned(), model.sha256))
            })
            .collect()
    }
}

/// The complete options of a run; `of` names the run in an error.
///
/// # Errors
/// [`SuiteError::Options`].
fn options(order: &RunOrder, of: &str) -> Result<Options, SuiteError> {
    let options = order.preset.options().with_overrides(&order.set);
    options.map_err(|error| SuiteError::Options { of: of.to_owned(), error })
}
