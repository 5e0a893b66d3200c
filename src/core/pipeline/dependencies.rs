//! The dependencies of each stage's result: the only list of the options that a stage reads.
//!
//! A stage receives [`Dependencies::options`]: the options that it names, and the defaults of all
//! others. So it cannot read an option that its fingerprint leaves out, and an option that it does
//! not name never invalidates its result.

use serde_json::Value;

use super::config::{Guide, Options};
use super::tools::{Networks, Tools};
use super::workspace::fingerprint;
use crate::capture::Capture;
use crate::deblur::RestorerInfo;
use crate::poses::Poses;

/// Structure from motion.
const POSES: &[&str] = &["pose_source", "seed"];
/// Structure from motion repeated on brightened and deblurred photographs.
const POSES_OF_DEBLURRED: &[&str] = &["target", "lut_scope"];
/// The registered photographs at working size, evened.
const VIEWS: &[&str] = &["detail", "size", "exposure"];
/// The tone curves of all rounds. The seed serves the search for the curve nearest to a network.
const ENHANCE: &[&str] = &["rounds", "target", "lut_scope", "seed"];
/// Deblurring with a guide.
const DEBLUR_GUIDED: &[&str] = &["guide"];
/// Deblurring without a guide.
const DEBLUR: &[&str] = &[];
/// The curves from a round's renders to the next round and to the target.
const MATCH: &[&str] = &["lut_scope", "seed"];
/// The views that join or leave the scene after a round.
const LATE_VIEWS: &[&str] = &["detail", "size", "shake", "refine_poses", "lut_scope", "seed"];
/// Training, and the registration of held-out views.
const RECONSTRUCT: &[&str] = &[
    "detail",
    "minutes",
    "rounds",
    "steps",
    "noise",
    "shake",
    "train_on",
    "loss",
    "refine_poses",
    "start",
    "schedule",
    "densify",
    "cap",
    "sh_degree",
    "background",
    "held_out",
    "seed",
];

/// The dependencies of one result.
#[derive(Clone, Debug)]
pub struct Dependencies {
    options: Options,
    fingerprint: String,
}

impl Dependencies {
    /// Depends on the options of these names and on `facts`: fingerprints of earlier results, names
    /// and checksums of tools.
    pub fn on(options: &Options, names: &[&str], facts: &[&str]) -> Self {
        let options = options.only(names);
        let named = names.join(" ");
        let values = json(&options);
        let fingerprint = fingerprint(&[&[named.as_str(), values.as_str()], facts].concat());
        Self { options, fingerprint }
    }

    /// The options that the stage may read; all others have their defaults.
    pub fn options(&self) -> &Options {
        &self.options
    }

    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }
}

/// The dependencies of the poses, before and after deblurring.
#[derive(Clone, Debug)]
pub struct PosesDependencies {
    /// Dependencies of the first attempt.
    pub first: Dependencies,
    /// Additional dependencies of the second attempt, on deblurred photographs.
    pub second: Dependencies,
}

impl PosesDependencies {
    /// `capture` is the capture's fingerprint, `source` the description of the source of poses.
    pub fn new(options: &Options, capture: &str, source: &str, networks: &Networks) -> Self {
        let first = Dependencies::on(options, POSES, &[capture, source]);
        let network = of_network(&networks.deblur);
        let facts = [first.fingerprint(), &network];
        let second = Dependencies::on(options, POSES_OF_DEBLURRED, &facts);
        Self { first, second }
    }
}

/// The brightness of the rounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Levels {
    /// Each brighter than the previous one; the last at the target.
    Rising,
    /// All at the target.
    Target,
}

/// The dependencies of the stages of the rounds.
#[derive(Clone, Debug)]
pub struct RunDependencies {
    levels: Levels,
    given: Options,
    networks: Networks,
    adapter: String,
    views: Dependencies,
    enhance: Dependencies,
}

impl RunDependencies {
    /// Dependencies of a run with these poses and tools.
    pub fn of(options: &Options, capture: &Capture, poses: &Poses, tools: &Tools<'_>) -> Self {
        let adapter = tools.device.identity();
        let networks = tools.networks();
        Self::new(options, &capture.fingerprint, poses, networks, adapter)
    }

    fn new(
        options: &Options,
        capture: &str,
        poses: &Poses,
        networks: Networks,
        adapter: String,
    ) -> Self {
        let views = Dependencies::on(options, VIEWS, &[capture, &json(poses), &adapter]);
        let brightener = networks.enhance.as_ref().map(of_network);
        let facts = [views.fingerprint(), &brightener.unwrap_or_default()];
        let enhance = Dependencies::on(options, ENHANCE, &facts);
        Self { levels: Levels::Rising, given: options.clone(), networks, adapter, views, enhance }
    }

    /// Changes the brightness of the rounds.
    pub fn with_levels(self, levels: Levels) -> Self {
        if levels == Levels::Rising {
            return self;
        }
        let facts = [self.enhance.fingerprint(), "at the target"];
        Self { levels, enhance: Dependencies::on(&self.given, ENHANCE, &facts), ..self }
    }

    pub fn levels(&self) -> Levels {
        self.levels
    }

    pub fn networks(&self) -> &Networks {
        &self.networks
    }

    /// Dependencies of the enhanced views of every round.
    pub fn enhance(&self) -> &Dependencies {
        &self.enhance
    }

    /// Dependencies of the stages of a round; `before` are those of the previous round.
    pub fn round(&self, round: u32, before: Option<&RoundDependencies>) -> RoundDependencies {
        let guided_by = before.filter(|_| self.given.guide != Guide::None);
        let number = round.to_string();
        let network = of_network(&self.networks.deblur);
        let deblur = match guided_by {
            Some(before) => {
                let guides = before.matching.fingerprint();
                let facts = [self.enhance.fingerprint(), &network, &number, guides];
                Dependencies::on(&self.given, DEBLUR_GUIDED, &facts)
            }
            None => {
                let facts = [self.enhance.fingerprint(), &network, &number];
                Dependencies::on(&self.given, DEBLUR, &facts)
            }
        };
        let images = if self.given.needs_no_network() { &self.enhance } else { &deblur };
        let before = before.map_or("", |before| before.reconstruct.fingerprint());
        let facts = [images.fingerprint(), &self.adapter, &number, before];
        let reconstruct = Dependencies::on(&self.given, RECONSTRUCT, &facts);
        let facts = [self.enhance.fingerprint(), reconstruct.fingerprint()];
        let matching = Dependencies::on(&self.given, MATCH, &facts);
        RoundDependencies { is_guided: guided_by.is_some(), deblur, reconstruct, matching }
    }

    /// Dependencies of the whole result. Options that the run itself does not read act through its
    /// tools.
    pub fn run(&self) -> Dependencies {
        let every = self.given.names();
        let names: Vec<&str> = every.iter().map(String::as_str).collect();
        let networks: Vec<String> = self
            .networks
            .named()
            .map(|(option, network)| format!("{option} {}", of_network(network)))
            .collect();
        let facts = [self.views.fingerprint(), &networks.join(" "), &self.adapter];
        Dependencies::on(&self.given, &names, &facts)
    }
}

impl RoundDependencies {
    /// Dependencies of the views that join or leave after the round; `matching` describes the
    /// matcher.
    pub fn late_views(&self, run: &RunDependencies, matching: &str) -> Dependencies {
        let facts = [self.reconstruct.fingerprint(), matching];
        Dependencies::on(&run.given, LATE_VIEWS, &facts)
    }
}

/// The dependencies of the stages of one round.
#[derive(Clone, Debug)]
pub struct RoundDependencies {
    /// Whether the renders of the previous round guide the deblurring.
    pub is_guided: bool,
    /// D_i.
    pub deblur: Dependencies,
    /// V_i.
    pub reconstruct: Dependencies,
    /// P_R and H_{i+1}.
    pub matching: Dependencies,
}

/// Everything that a network's output depends on.
fn of_network(network: &RestorerInfo) -> String {
    format!("{network:?}")
}

fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("plain data has a JSON form")
}

impl Options {
    /// The names of all options.
    fn names(&self) -> Vec<String> {
        match serde_json::to_value(self) {
            Ok(Value::Object(fields)) => fields.keys().cloned().collect(),
            _ => unreachable!("options are a JSON object"),
        }
    }

    /// The options of these names, and the defaults of all others.
    fn only(&self, names: &[&str]) -> Self {
        let fields = |options: &Self| serde_json::to_value(options).expect("plain data");
        let (mut options, given) = (fields(&Self::default()), fields(self));
        for name in names {
            options[*name] = given[*name].clone();
        }
        serde_json::from_value(options).expect("every field comes from valid options")
    }
}

#[cfg(test)]
mod tests;
