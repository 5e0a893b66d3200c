//! What a stage's result depends on: the one place that says which options a stage reads.
//!
//! A stage is handed [`Dependencies::options`]: the options that it names, and the defaults in
//! place of all others. So it cannot read an option that its fingerprint does not hold, and an
//! option that it does not name never makes its result stale.

use serde_json::Value;

use super::config::{Guide, Options};
use super::tools::{Networks, Tools};
use super::workspace::fingerprint;
use crate::capture::Capture;
use crate::deblur::RestorerInfo;
use crate::poses::Poses;

/// Structure from motion.
const POSES: &[&str] = &["pose_source", "seed"];
/// Structure from motion once more, on brightened and deblurred photographs.
const POSES_OF_DEBLURRED: &[&str] = &["target", "lut_scope"];
/// The registered photographs at working size.
const VIEWS: &[&str] = &["size"];
/// The tone curves of all rounds. The seed is that of the search for a network's nearest curve.
const ENHANCE: &[&str] = &["rounds", "target", "lut_scope", "seed"];
/// The deblurring of views with a guide.
const DEBLUR_GUIDED: &[&str] = &["guide"];
/// The deblurring of views without one.
const DEBLUR: &[&str] = &[];
/// The curves from a round's renders to the next round and to the target.
const MATCH: &[&str] = &["lut_scope", "seed"];
/// What joins or leaves the scene after a round.
const LATE_VIEWS: &[&str] = &["size", "shake", "refine_poses", "lut_scope", "seed"];
/// Training, and the registration of held-out views.
const RECONSTRUCT: &[&str] = &[
    "rounds",
    "steps",
    "noise",
    "shake",
    "train_on",
    "refine_poses",
    "start",
    "densify",
    "cap",
    "sh_degree",
    "background",
    "held_out",
    "seed",
];

/// What one result depends on.
#[derive(Clone, Debug)]
pub struct Dependencies {
    options: Options,
    fingerprint: String,
}

impl Dependencies {
    /// On the options of these names and on `facts`: fingerprints of what came before, names and
    /// checksums of tools.
    pub fn on(options: &Options, names: &[&str], facts: &[&str]) -> Self {
        let options = options.only(names);
        let named = names.join(" ");
        let values = json(&options);
        let fingerprint = fingerprint(&[&[named.as_str(), values.as_str()], facts].concat());
        Self {
            options,
            fingerprint,
        }
    }

    /// The options that may be read; all others have their defaults.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Equal for equal dependencies.
    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }
}

/// What the poses depend on, before and after a network had a hand in them.
#[derive(Clone, Debug)]
pub struct PosesDependencies {
    /// What the first look depends on.
    pub first: Dependencies,
    /// What the second look, at deblurred photographs, depends on besides.
    pub second: Dependencies,
}

impl PosesDependencies {
    /// Of the capture with this fingerprint and a source of poses that describes itself so.
    pub fn new(options: &Options, capture: &str, source: &str, networks: &Networks) -> Self {
        let first = Dependencies::on(options, POSES, &[capture, source]);
        let network = of_network(&networks.deblur);
        let facts = [first.fingerprint(), &network];
        let second = Dependencies::on(options, POSES_OF_DEBLURRED, &facts);
        Self { first, second }
    }
}

/// How bright the rounds are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Levels {
    /// Each brighter than the one before, the last as bright as the target.
    Rising,
    /// All as bright as the target.
    Target,
}

/// What the stages of the rounds depend on.
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
    /// Of a run with these poses of a capture, and with these tools.
    pub fn of(options: &Options, capture: &Capture, poses: &Poses, tools: &Tools<'_>) -> Self {
        let adapter = tools.gpu.describe().to_string();
        let networks = tools.networks();
        Self::new(options, &capture.fingerprint, poses, networks, adapter)
    }

    /// Of a run with these poses of the capture with this fingerprint.
    fn new(
        options: &Options,
        capture: &str,
        poses: &Poses,
        networks: Networks,
        adapter: String,
    ) -> Self {
        let views = Dependencies::on(options, VIEWS, &[capture, &json(poses)]);
        let brightener = networks.enhance.as_ref().map(of_network);
        let facts = [views.fingerprint(), &brightener.unwrap_or_default()];
        let enhance = Dependencies::on(options, ENHANCE, &facts);
        Self {
            levels: Levels::Rising,
            given: options.clone(),
            networks,
            adapter,
            views,
            enhance,
        }
    }

    /// Of a run whose rounds are so bright.
    pub fn with_levels(self, levels: Levels) -> Self {
        if levels == Levels::Rising {
            return self;
        }
        let facts = [self.enhance.fingerprint(), "at the target"];
        Self {
            levels,
            enhance: Dependencies::on(&self.given, ENHANCE, &facts),
            ..self
        }
    }

    /// How bright the rounds are.
    pub fn levels(&self) -> Levels {
        self.levels
    }

    /// The networks of the run.
    pub fn networks(&self) -> &Networks {
        &self.networks
    }

    /// Of the enhanced views of every round.
    pub fn enhance(&self) -> &Dependencies {
        &self.enhance
    }

    /// Of the stages of a round; `before` is what those of the round before depend on.
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
        let images = if self.given.needs_no_network() {
            &self.enhance
        } else {
            &deblur
        };
        let before = before.map_or("", |before| before.reconstruct.fingerprint());
        let facts = [images.fingerprint(), &self.adapter, &number, before];
        let reconstruct = Dependencies::on(&self.given, RECONSTRUCT, &facts);
        let facts = [self.enhance.fingerprint(), reconstruct.fingerprint()];
        let matching = Dependencies::on(&self.given, MATCH, &facts);
        RoundDependencies {
            is_guided: guided_by.is_some(),
            deblur,
            reconstruct,
            matching,
        }
    }

    /// Of the whole result. Whatever a run does not read by itself acts through its tools.
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
    /// Of the views that join or leave after the round, found by whoever describes itself so.
    pub fn late_views(&self, run: &RunDependencies, matching: &str) -> Dependencies {
        let facts = [self.reconstruct.fingerprint(), matching];
        Dependencies::on(&run.given, LATE_VIEWS, &facts)
    }
}

/// What the stages of one round depend on.
#[derive(Clone, Debug)]
pub struct RoundDependencies {
    /// Whether the renders of the round before guide the deblurring.
    pub is_guided: bool,
    /// D_i.
    pub deblur: Dependencies,
    /// V_i.
    pub reconstruct: Dependencies,
    /// P_R and HR.
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

    /// The options of these names, and the defaults in place of all others.
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
