//! The rungs of the ladder, and when a rung's model is good enough.

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
    /// Least share that is still delivered, with a warning, when no rung was good enough.
    pub salvage: f64,
}

impl Default for Acceptance {
    fn default() -> Self {
        Self {
            registered: 0.8,
            observations: 75.0,
            track: 3.1,
            salvage: 0.5,
        }
    }
}

/// The rungs of learned matches are this letter and those after it.
pub(super) const FIRST_LEARNED: char = 'L';

/// Settings of one rung.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rung {
    pub(super) letter: char,
    /// The rung whose features and matches are mapped.
    pub(super) database: char,
    pub(super) full_size: bool,
    /// Affine shapes, domain-size pooling, a lower peak threshold: for images with few features.
    pub(super) robust_features: bool,
    pub(super) loose_mapper: bool,
    /// Whether it is tried where the matches of networks gave no good model, too: what the others
    /// cost brought nothing there.
    pub(super) beside_networks: bool,
}

/// COLMAP's own features, in the order in which the rungs are tried.
pub(super) const LADDER: [Rung; 5] = [
    Rung {
        letter: 'A',
        database: 'A',
        full_size: false,
        robust_features: false,
        loose_mapper: false,
        beside_networks: true,
    },
    Rung {
        letter: 'B',
        database: 'A',
        full_size: false,
        robust_features: false,
        loose_mapper: true,
        beside_networks: true,
    },
    Rung {
        letter: 'C',
        database: 'C',
        full_size: true,
        robust_features: false,
        loose_mapper: true,
        beside_networks: false,
    },
    Rung {
        letter: 'D',
        database: 'D',
        full_size: false,
        robust_features: true,
        loose_mapper: true,
        beside_networks: false,
    },
    Rung {
        letter: 'E',
        database: 'E',
        full_size: false,
        robust_features: false,
        loose_mapper: false,
        beside_networks: false,
    },
];

/// How COLMAP's mapper is run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mapping {
    /// The rung.
    pub letter: char,
    /// With lower bounds on what a place needs.
    pub loose: bool,
}

/// Progress in thirds of a rung; the total grows with each rung that is needed.
pub(super) fn advance(sink: &mut dyn ProgressSink, letter: char, part: u64) {
    let rungs_before = LADDER
        .iter()
        .take_while(|rung| rung.letter != letter)
        .count() as u64;
    let (done, total) = (3 * rungs_before + part, 3 * (rungs_before + 1));
    sink.event(&Event::advanced(Stage::Poses, done, total));
}
