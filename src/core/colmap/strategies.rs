//! The fallback strategies, and the criteria for a good model.

use super::copies::Kind;
use crate::event::{Event, ProgressSink, Stage};

/// Criteria for a good model. Fitted to runs of real captures: looser options register photographs
/// with wrong poses, and the reprojection error does not show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acceptance {
    /// Smallest share of the photographs that must register.
    pub registered: f64,
    /// Smallest number of observations (track members) per registered photograph.
    pub observations: f64,
    /// Smallest mean track length.
    pub track: f64,
    /// Smallest share that is still returned, with a warning, if no strategy was good enough.
    pub salvage: f64,
}

impl Default for Acceptance {
    fn default() -> Self {
        Self { registered: 0.8, observations: 75.0, track: 3.1, salvage: 0.5 }
    }
}

/// The strategies with learned matches have this letter and those after it.
pub(super) const FIRST_LEARNED: char = 'L';

/// The description of the strategies with learned matches, for users.
pub(super) const LEARNED: &str = "features found and matched by networks";

/// Settings of one strategy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Strategy {
    pub(super) letter: char,
    /// Its description, for users.
    pub(super) name: &'static str,
    /// The strategy whose features and matches are mapped.
    pub(super) database: char,
    /// The copies from which features are extracted.
    pub(super) copies: Kind,
    /// Affine shapes, domain-size pooling, a lower peak threshold: for images with few features.
    pub(super) robust_features: bool,
    pub(super) loose_mapper: bool,
    /// Whether it is tried even after the networks' matches gave no good model: the other
    /// strategies did not help there despite their cost.
    pub(super) beside_networks: bool,
}

/// Strategies with COLMAP's own features, in the order in which they are tried.
pub(super) const STRATEGIES: [Strategy; 6] = [
    Strategy {
        letter: 'A',
        name: "COLMAP's features on small copies",
        database: 'A',
        copies: Kind::Small,
        robust_features: false,
        loose_mapper: false,
        beside_networks: true,
    },
    Strategy {
        letter: 'B',
        name: "COLMAP's features on small copies, with lower thresholds",
        database: 'A',
        copies: Kind::Small,
        robust_features: false,
        loose_mapper: true,
        beside_networks: true,
    },
    Strategy {
        letter: 'C',
        name: "COLMAP's features on full-size copies",
        database: 'C',
        copies: Kind::Full,
        robust_features: false,
        loose_mapper: true,
        beside_networks: false,
    },
    Strategy {
        letter: 'D',
        name: "more of COLMAP's features on small copies",
        database: 'D',
        copies: Kind::Small,
        robust_features: true,
        loose_mapper: true,
        beside_networks: false,
    },
    Strategy {
        letter: 'E',
        name: "COLMAP's features on small copies, with another seed",
        database: 'E',
        copies: Kind::Small,
        robust_features: false,
        loose_mapper: false,
        beside_networks: false,
    },
    Strategy {
        letter: 'G',
        name: "COLMAP's features on copies as dark as the photographs",
        database: 'G',
        copies: Kind::Plain,
        robust_features: false,
        loose_mapper: false,
        beside_networks: true,
    },
];

/// How to run COLMAP's mapper.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mapping {
    /// The strategy.
    pub letter: char,
    /// With lower minimums for placing a photograph.
    pub loose: bool,
}

/// Reports that a strategy begins.
pub(super) fn begin(sink: &mut dyn ProgressSink, strategy: char, name: &str) {
    sink.event(&Event::StrategyStarted { strategy, name: name.to_owned() });
}

/// Progress in thirds of a strategy; the total grows with each strategy tried.
pub(super) fn advance(sink: &mut dyn ProgressSink, letter: char, part: u64) {
    let strategies_before =
        STRATEGIES.iter().take_while(|strategy| strategy.letter != letter).count() as u64;
    let (done, total) = (3 * strategies_before + part, 3 * (strategies_before + 1));
    sink.event(&Event::advanced(Stage::Poses, done, total));
}
