//! Records of finished work: a file per run and per evaluation, named by the hash of all its
//! inputs.
//!
//! ```text
//! runs/NAME.json  runs/NAME/  evaluations/NAME.json  evaluations/NAME/  poses/PROGRAM/
//! ```

use std::fs;
use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::content::hashed;
use super::error::SuiteError;
use super::outcome::Outcome;

/// Characters of a record's name.
const NAME: usize = 16;

/// Kinds of records, each with its own folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A run, with its report.
    Run,
    /// An evaluation.
    Evaluation,
}

impl Kind {
    fn folder(self) -> &'static str {
        match self {
            Self::Run => "runs",
            Self::Evaluation => "evaluations",
        }
    }
}

/// The folder of the records. Cheap to clone; holds only a path.
#[derive(Clone, Debug)]
pub struct Records {
    out: PathBuf,
}

/// A record's file.
#[derive(Serialize, Deserialize)]
struct Record<O> {
    facts: Value,
    outcome: O,
}

impl Records {
    /// The records below `out`, which need not exist.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self { out: out.into() }
    }

    /// The name of the record of these facts.
    pub fn name(facts: &impl Serialize) -> String {
        hashed(facts)[..NAME].to_owned()
    }

    /// The folder of the work recorded under this name.
    pub fn folder(&self, kind: Kind, name: &str) -> PathBuf {
        self.out.join(kind.folder()).join(name)
    }

    /// The pose cache of a build of the program: poses outlive a run, but not the build that found
    /// them.
    pub fn poses(&self, program: &str) -> PathBuf {
        self.out.join("poses").join(&program[..NAME])
    }

    /// Reads the outcome recorded for these facts.
    ///
    /// # Errors
    /// [`SuiteError::Io`], or [`SuiteError::Record`] when the file holds other facts.
    pub fn read<T: DeserializeOwned>(
        &self,
        kind: Kind,
        facts: &impl Serialize,
    ) -> Result<Option<Outcome<T>>, SuiteError> {
        let path = self.file(kind, &Self::name(facts));
        let bytes = match fs::read(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            bytes => bytes.map_err(SuiteError::io(&path))?,
        };
        let damaged = |detail: String| SuiteError::Record { path: path.clone(), detail };
        let record: Record<Outcome<T>> = serde_json::from_slice(&bytes)
            .map_err(|error| damaged(format!("is no record: {error}")))?;
        if record.facts != as_json(facts) {
            return Err(damaged("records another run than its name says".to_owned()));
        }
        Ok(Some(record.outcome))
    }

    /// Records the outcome of these facts atomically.
    ///
    /// # Errors
    /// [`SuiteError::Io`].
    pub fn write<T: Serialize>(
        &self,
        kind: Kind,
        facts: &impl Serialize,
        outcome: &Outcome<T>,
    ) -> Result<(), SuiteError> {
        let path = self.file(kind, &Self::name(facts));
        let record = Record { facts: as_json(facts), outcome };
        let text = serde_json::to_vec_pretty(&record).expect("numbers of a report are finite");
        let partial = path.with_extension(format!("json.{}", std::process::id()));
        let folder = path.parent().unwrap_or(&self.out);
        fs::create_dir_all(folder).map_err(SuiteError::io(folder))?;
        fs::write(&partial, text).map_err(SuiteError::io(&partial))?;
        fs::rename(&partial, &path).map_err(SuiteError::io(&path))
    }

    fn file(&self, kind: Kind, name: &str) -> PathBuf {
        self.folder(kind, name).with_extension("json")
    }
}

fn as_json(facts: &impl Serialize) -> Value {
    serde_json::to_value(facts).expect("facts are text, numbers and maps of text")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn facts(steps: u32) -> BTreeMap<&'static str, u32> {
        BTreeMap::from([("steps", steps)])
    }

    #[test]
    fn records_round_trip_and_other_facts_have_none() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let records = Records::new(folder.path());
        for outcome in [Outcome::Failed("no poses".to_owned()), Outcome::Finished(0.5)] {
            records.write(Kind::Run, &facts(1), &outcome).expect("written");
            let read = records.read::<f64>(Kind::Run, &facts(1)).expect("readable");
            assert_eq!(read, Some(outcome));
        }
        assert_eq!(records.read::<f64>(Kind::Run, &facts(2)).expect("none"), None);
        assert_eq!(records.read::<f64>(Kind::Evaluation, &facts(1)).expect("none"), None);
    }

    #[test]
    fn a_record_whose_facts_contradict_its_name_is_refused() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let records = Records::new(folder.path());
        records.write(Kind::Run, &facts(1), &Outcome::Finished(0.5)).expect("written");
        let file = |steps| records.file(Kind::Run, &Records::name(&facts(steps)));
        fs::rename(file(1), file(2)).expect("renamed");
        let refused = records.read::<f64>(Kind::Run, &facts(2));
        let error = refused.expect_err("another run's").to_string();
        assert!(error.contains("another run than its name says"), "{error}");
    }
}
