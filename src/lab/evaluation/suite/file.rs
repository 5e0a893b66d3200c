//! The file of a suite: captures, configurations and comparisons.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::error::SuiteError;
use fled_core::pipeline::config::Preset;

/// Options of a run: flat keys, as in `fled run --options`.
pub type OptionSet = Map<String, Value>;

/// The content of a suite's file. Paths are relative to the file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// The question that it answers, a sentence.
    pub question: String,
    /// Preset of every run.
    pub preset: Preset,
    /// Number of seeds, from 0.
    #[serde(default = "one")]
    pub seeds: u64,
    /// Options of every run.
    #[serde(default)]
    pub set: OptionSet,
    /// The material of configurations that name none.
    #[serde(default = "dark")]
    pub material: String,
    /// The LPIPS network; without one, no view has that score.
    pub lpips: Option<PathBuf>,
    /// Whether test views that lie outside the training views' path are left out.
    #[serde(default)]
    pub inside: bool,
    /// The captures; may be omitted if a separate list of captures is given.
    #[serde(default)]
    pub captures: Vec<CaptureEntry>,
    /// The configurations; the first is the baseline of the others.
    pub configurations: Vec<Configuration>,
    /// The share of a ceiling to report.
    pub gain: Option<Gain>,
}

/// One scene, photographed in one or several ways from the same places.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureEntry {
    /// Its name in the tables.
    pub name: String,
    /// Captures of the scene by kind, such as `dark`, `sharp` and `shaken`.
    pub materials: BTreeMap<String, PathBuf>,
    /// Sharp photographs with their cameras, which judge its runs.
    pub truth: PathBuf,
    /// Options of its runs, which override the suite's.
    #[serde(default)]
    pub set: OptionSet,
}

/// One configuration to compare.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Configuration {
    /// Its name in the tables.
    pub name: String,
    /// Its options, which override the suite's and the capture's.
    #[serde(default)]
    pub set: OptionSet,
    /// The material that it processes.
    pub material: Option<String>,
    /// Another configuration; this one makes as many steps as fit into that one's training time.
    pub seconds_of: Option<String>,
}

/// (of - over) / (ceiling - over), each the name of a configuration.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gain {
    /// The configuration to be judged.
    pub of: String,
    /// The baseline.
    pub over: String,
    /// The upper bound.
    pub ceiling: String,
}

/// A part of a suite; by default all of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Configurations, besides the first and those that they need.
    pub only: Vec<String>,
    /// Captures.
    pub captures: Vec<String>,
    /// Seeds in place of the file's number.
    pub seeds: Option<u64>,
}

fn one() -> u64 {
    1
}

fn dark() -> String {
    "dark".to_owned()
}

impl Suite {
    /// Reads a suite's file and checks it.
    ///
    /// # Errors
    /// [`SuiteError::Io`], or [`SuiteError::Wrong`] naming the key.
    pub fn read(path: &Path) -> Result<Self, SuiteError> {
        let mut suite: Self = parsed(path)?;
        let folder = folder_of(path);
        suite.lpips = suite.lpips.map(|lpips| folder.join(lpips));
        place(&mut suite.captures, folder);
        suite.check().map_err(|fault| SuiteError::Wrong(format!("{}: {fault}", path.display())))?;
        Ok(suite)
    }

    /// Replaces the captures by those of a separate file, whose paths are relative to that file.
    ///
    /// # Errors
    /// As [`Suite::read`].
    pub fn with_captures_of(mut self, path: &Path) -> Result<Self, SuiteError> {
        self.captures = parsed(path)?;
        place(&mut self.captures, folder_of(path));
        self.check().map_err(|fault| SuiteError::Wrong(format!("{}: {fault}", path.display())))?;
        Ok(self)
    }

    /// Overrides options of every run by `key=value` assignments.
    ///
    /// # Errors
    /// [`SuiteError::Options`] for an invalid one.
    pub fn with_assignments(mut self, assignments: &[String]) -> Result<Self, SuiteError> {
        for assignment in assignments {
            let options = self.preset.options().with_assignment(assignment);
            let options = options
                .map_err(|error| SuiteError::Options { of: "every run".to_owned(), error })?;
            // The value in the option's type.
            let value = serde_json::to_value(options).expect("options are JSON");
            if let Some((key, _)) = assignment.split_once('=') {
                self.set.insert(key.to_owned(), value[key].clone());
            }
        }
        self.check().map_err(SuiteError::Wrong)?;
        Ok(self)
    }

    /// Reduces the suite to the selection. The first configuration stays, and so do those from
    /// whose times others derive their steps.
    ///
    /// # Errors
    /// [`SuiteError::Wrong`] for an unknown name, or when no capture is left.
    pub fn selected(mut self, selection: &Selection) -> Result<Self, SuiteError> {
        let all: Vec<&str> = self.configurations.iter().map(|c| &*c.name).collect();
        expect_known("configuration", &selection.only, &all)?;
        let all: Vec<&str> = self.captures.iter().map(|c| &*c.name).collect();
        expect_known("capture", &selection.captures, &all)?;
        if !selection.only.is_empty() {
            let mut wanted: BTreeSet<String> = selection.only.iter().cloned().collect();
            wanted.extend(self.configurations.first().map(|first| first.name.clone()));
            for configuration in &self.configurations {
                if wanted.contains(&configuration.name)
                    && let Some(timing) = self.timing(configuration)
                {
                    wanted.extend([timing.time_of.name.clone(), timing.rate_of.name.clone()]);
                }
            }
            self.configurations.retain(|c| wanted.contains(&c.name));
        }
        if !selection.captures.is_empty() {
            self.captures.retain(|capture| selection.captures.contains(&capture.name));
        }
        self.seeds = selection.seeds.unwrap_or(self.seeds);
        if self.captures.is_empty() {
            return Err(SuiteError::Wrong(
                "the suite's file has no `captures`, and no list of them is given".to_owned(),
            ));
        }
        Ok(self)
    }

    /// The material of a capture that a configuration processes.
    pub fn material<'a>(&self, capture: &'a CaptureEntry, of: &Configuration) -> Option<&'a Path> {
        let name = of.material.as_ref().unwrap_or(&self.material);
        capture.materials.get(name).map(PathBuf::as_path)
    }

    /// The configurations whose runs determine the number of steps of one that has `seconds_of`.
    pub fn timing(&self, of: &Configuration) -> Option<Timing<'_>> {
        let name = of.seconds_of.as_ref()?;
        let time_of = self.configurations.iter().find(|c| c.name == *name)?;
        let rate_of = self.configurations.iter().find(|other| {
            let same_material = other.material.as_ref().unwrap_or(&self.material)
                == of.material.as_ref().unwrap_or(&self.material);
            other.seconds_of.is_none() && same_material && but_steps(&other.set) == of.set
        })?;
        Some(Timing { time_of, rate_of })
    }

    /// Checks the suite; the error names the key.
    fn check(&self) -> Result<(), String> {
        if self.seeds == 0 {
            return Err("`seeds` is 0: nothing would be run".to_owned());
        }
        let configurations: Vec<&str> = self.configurations.iter().map(|c| &*c.name).collect();
        let captures: Vec<&str> = self.captures.iter().map(|c| &*c.name).collect();
        let first = self.configurations.first();
        let first = first.ok_or("`configurations` is empty")?;
        for (key, names) in [("configurations", &configurations), ("captures", &captures)] {
            if let Some(twice) = twice(names) {
                return Err(format!("`{key}`: two are named `{twice}`"));
            }
        }
        if first.seconds_of.is_some() {
            return Err(format!(
                "`seconds_of` of `{}`: the first configuration is what the others are compared \
                 with, and has steps of its own",
                first.name
            ));
        }
        self.check_sets()?;
        for configuration in &self.configurations {
            self.check_timing(configuration)?;
            self.check_materials(configuration)?;
        }
        let gain = self.gain.iter().flat_map(Gain::named);
        for (key, name) in gain {
            if !configurations.contains(&name) {
                return Err(format!("`gain.{key}`: no configuration is named `{name}`"));
            }
        }
        Ok(())
    }

    fn check_sets(&self) -> Result<(), String> {
        let captures = self.captures.iter().map(|c| (c.name.as_str(), &c.set));
        let configurations = self.configurations.iter().map(|c| (c.name.as_str(), &c.set));
        let all = [("the suite", &self.set)];
        for (name, set) in all.into_iter().chain(captures).chain(configurations) {
            if set.contains_key("seed") {
                return Err(format!("`set.seed` of `{name}`: seeds are counted by `seeds`"));
            }
        }
        Ok(())
    }

    fn check_timing(&self, of: &Configuration) -> Result<(), String> {
        let Some(name) = &of.seconds_of else {
            return Ok(());
        };
        let fault = |text: String| Err(format!("`seconds_of` of `{}`: {text}", of.name));
        let Some(other) = self.configurations.iter().find(|c| c.name == *name) else {
            return fault(format!("no configuration is named `{name}`"));
        };
        if other.seconds_of.is_some() {
            return fault(format!("`{name}` has `seconds_of` itself"));
        }
        if of.set.contains_key("steps") {
            return fault(
                "its steps follow from the time, and `set.steps` says them too".to_owned(),
            );
        }
        if self.timing(of).is_none() {
            return fault(
                "no configuration without it has the same `material` and the same `set` but for \
                 `steps`, so its steps a second are unknown"
                    .to_owned(),
            );
        }
        Ok(())
    }

    fn check_materials(&self, of: &Configuration) -> Result<(), String> {
        let lacking = self.captures.iter().find(|capture| self.material(capture, of).is_none());
        match lacking {
            Some(capture) => Err(format!(
                "`materials` of `{}`: there is no `{}`, which `{}` is given",
                capture.name,
                of.material.as_ref().unwrap_or(&self.material),
                of.name
            )),
            None => Ok(()),
        }
    }
}

/// The configurations whose runs determine a number of steps.
#[derive(Clone, Copy, Debug)]
pub struct Timing<'a> {
    /// The one whose training time is filled.
    pub time_of: &'a Configuration,
    /// The one whose steps per second are assumed.
    pub rate_of: &'a Configuration,
}

impl Gain {
    /// Its keys and the configurations that they name.
    fn named(&self) -> [(&'static str, &str); 3] {
        [("of", &self.of), ("over", &self.over), ("ceiling", &self.ceiling)]
    }
}

fn but_steps(set: &OptionSet) -> OptionSet {
    let mut set = set.clone();
    set.remove("steps");
    set
}

fn twice<'a>(names: &[&'a str]) -> Option<&'a str> {
    let mut seen = BTreeSet::new();
    names.iter().find(|name| !seen.insert(**name)).copied()
}

fn expect_known(what: &str, asked: &[String], all: &[&str]) -> Result<(), SuiteError> {
    match asked.iter().find(|name| !all.contains(&name.as_str())) {
        Some(name) => Err(SuiteError::Wrong(format!(
            "no {what} is named `{name}`; there are {}",
            all.join(", ")
        ))),
        None => Ok(()),
    }
}

fn parsed<T: DeserializeOwned>(path: &Path) -> Result<T, SuiteError> {
    let bytes = std::fs::read(path).map_err(SuiteError::io(path))?;
    serde_json::from_slice(&bytes)
        .map_err(|error| SuiteError::Wrong(format!("{}: {error}", path.display())))
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}

fn place(captures: &mut [CaptureEntry], folder: &Path) {
    for capture in captures {
        capture.truth = folder.join(&capture.truth);
        for path in capture.materials.values_mut() {
            *path = folder.join(&path);
        }
    }
}

#[cfg(test)]
mod tests;
