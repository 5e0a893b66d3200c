//! The fallback strategies, and when a model of one is good enough.

use super::copies::Kind;
use crate::event::{Event, ProgressSink, Stage};

/// When a model is good enough. Fitted on runs of real captures: loosened options register
/// photographs with wrong poses, and the reprojection error does not show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acceptance {
    /// Least share of the photographs that must register.
    pub registered: f64,
    /// Least observations (members of tracks) a registered photograph.
    pub observations: f64,
    /// Least mean track length.
    pub track: f64,
    /// Least share that is still delivered, with a warning, when no strategy was good enough.
    pub salvage: f64,
}

impl Default for Acceptance {
    fn default() -> Self {
        Self { registered: 0.8, observations: 75.0, track: 3.1, salvage: 0.5 }
    }
}

/// The strategies of learned matches are this letter and those after it.
pub(super) const FIRST_LEARNED: char = 'L';

/// Settings of one strategy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Strategy {
    pub(super) letter: char,
    /// The strategy whose features and matches are mapped.
    pub(super) database: char,
    /// The copies that features are found in.
    pub(super) copies: Kind,
    /// Affine shapes, domain-size pooling, a lower peak threshold: for images with few features.
    pub(super) robust_features: bool,
    pub(super) loose_mapper: bool,
    /// Whether it is tried where the matches of networks gave no good model, too: what the others
    /// cost brought nothing there.
    pub(super) beside_networks: bool,
}

/// COLMAP's own features, in the order in which they are tried.
pub(super) const STRATEGIES: [Strategy; 6] = [
    Strategy {
        letter: 'A',
        database: 'A',
        copies: Kind::Small,
        robust_features: false,
        loose_mapper: false,
        beside_networks: true,
    },
    Strategy {
        letter: 'B',
        database: 'A',
        copies: Kind::Small,
        robust_features: false,
        loose_mapper: true,
        beside_networks: true,
    },
    Strategy {
        letter: 'C',
        database: 'C',
        copies: Kind::Full,
        robust_features: false,
        loose_mapper: true,
        beside_networks: false,
    },
    Strategy {
        letter: 'D',
        database: 'D',
        copies: Kind::Small,
        robust_features: true,
        loose_mapper: true,
        beside_networks: false,
    },
    Strategy {
        letter: 'E',
        database: 'E',
        copies: Kind::Small,
        robust_features: false,
        loose_mapper: false,
        beside_networks: false,
    },
    Strategy {
        letter: 'G',
        database: 'G',
        copies: Kind::Plain,
        robust_features: false,
        loose_mapper: false,
        beside_networks: true,
    },
];

/// How COLMAP's mapper is run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mapping {
    /// The strategy.
    pub letter: char,
    /// With lower bounds on what a place needs.
    pub loose: bool,
}

/// Progress in thirds of a strategy; the total grows with each strategy that is needed.
pub(super) fn advance(sink: &mut dyn ProgressSink, letter: char, part: u64) {
    let strategies_before =
        STRATEGIES.iter().take_while(|strategy| strategy.letter != letter).count() as u64;
    let (done, total) = (3 * strategies_before + part, 3 * (strategies_before + 1));
    sink.event(&Event::advanced(Stage::Poses, done, total));
}
