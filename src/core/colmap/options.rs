//! Options have moved between COLMAP's versions, so the help (`-h`) of each command is checked.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use super::copies::Copies;
use super::process::{Finished, Runner};
use crate::cancel::CancelToken;
use crate::poses::PosesError;

/// An option by all its names so far, newest last, and its value.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Setting {
    names: &'static [&'static str],
    value: String,
}

/// A setting.
pub(super) fn set(names: &'static [&'static str], value: &dyn std::fmt::Display) -> Setting {
    Setting { names, value: value.to_string() }
}

/// The folder of the copies' masks, if there are any: COLMAP takes no features where they are
/// black.
pub(super) fn masks(copies: &Copies) -> Option<Setting> {
    copies.mask_dir().map(|dir| set(&["ImageReader.mask_path"], &dir.display()))
}

/// COLMAP 3.8 to 3.12, then 3.13 and later.
pub(super) const RANDOM_SEED: &[&str] = &["random_seed", "default_random_seed"];
/// The default of 1 aborts in a build without CUDA.
pub(super) const EXTRACT_USE_GPU: &[&str] =
    &["SiftExtraction.use_gpu", "FeatureExtraction.use_gpu"];
/// Moved in 3.13.
pub(super) const EXTRACT_THREADS: &[&str] =
    &["SiftExtraction.num_threads", "FeatureExtraction.num_threads"];
/// The default of 1 aborts in a build without CUDA.
pub(super) const MATCH_USE_GPU: &[&str] = &["SiftMatching.use_gpu", "FeatureMatching.use_gpu"];
/// Moved in 3.13.
pub(super) const GUIDED_MATCHING: &[&str] =
    &["SiftMatching.guided_matching", "FeatureMatching.guided_matching"];

/// The program with its options known so far.
#[derive(Debug)]
pub(super) struct Prober<'a> {
    runner: &'a Runner,
    known: RefCell<BTreeMap<String, Rc<BTreeSet<String>>>>,
}

impl<'a> Prober<'a> {
    pub fn new(runner: &'a Runner) -> Self {
        Self { runner, known: RefCell::default() }
    }

    /// Runs `command` with the `settings` that it supports; the others are noted in the log.
    pub fn run(
        &self,
        command: &str,
        settings: &[Setting],
        cancel: &CancelToken,
    ) -> Result<Finished, PosesError> {
        let known = self.options(command, cancel)?;
        let mut arguments = Vec::new();
        for setting in settings {
            match setting.names.iter().rev().find(|name| known.contains(**name)) {
                Some(name) => arguments.extend([format!("--{name}"), setting.value.clone()]),
                None => self.runner.note(&format!(
                    "[{command} has no option {}: not sent]",
                    setting.names.join(" or ")
                )),
            }
        }
        self.runner.run(command, &arguments, cancel)
    }

    fn options(
        &self,
        command: &str,
        cancel: &CancelToken,
    ) -> Result<Rc<BTreeSet<String>>, PosesError> {
        if let Some(known) = self.known.borrow().get(command) {
            return Ok(known.clone());
        }
        let finished = self.runner.run(command, &["-h".to_owned()], cancel)?;
        let options = Rc::new(parse(&finished.text()));
        // Every command has at least a database; without it this is not a help text.
        if !options.contains("database_path") {
            return Err(finished.failure(&format!("{command} -h")));
        }
        self.known.borrow_mut().insert(command.to_owned(), options.clone());
        Ok(options)
    }
}

/// The long options listed in a help text: `  --Name.part arg (=0)`.
fn parse(help: &str) -> BTreeSet<String> {
    help.lines()
        .filter_map(|line| line.trim_start().strip_prefix("--"))
        .filter_map(|line| line.split(|c: char| c.is_whitespace() || c == '=').next())
        .map(str::to_owned)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_help_text_gives_its_option_names() {
        let help = "COLMAP 3.8\n\n  -h [ --help ] \n  --random_seed arg (=0)\n  --camera_mode arg (=-1)\n  --SiftExtraction.use_gpu arg (=1)\n                      --not at its end\n";
        let options = parse(help);
        assert!(options.contains("SiftExtraction.use_gpu") && options.contains("random_seed"));
        assert!(!options.contains("help"));
    }
}
