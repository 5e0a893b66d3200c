//! The photographs of a capture that show the same things, for a user who has to add some.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Groups of photographs that clearly show the same things, by the matches of the networks.
/// Photographs are called by the names of their views.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Overlap {
    /// Every photograph, by group: the largest group first, those that clearly match no other
    /// last.
    pub groups: Vec<Vec<String>>,
    /// The strongest pairs: those that connect each group, and the strongest between groups.
    pub links: Vec<OverlapLink>,
}

/// Two photographs with matches.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct OverlapLink {
    /// One of the photographs.
    pub first: String,
    /// The other one.
    pub second: String,
    /// The number of matches.
    pub matches: usize,
    /// Whether these are clearly enough: fewer occur between photographs of different places.
    pub connects: bool,
}

impl Overlap {
    /// The number of photographs that clearly match another one.
    pub fn matched(&self) -> usize {
        self.groups.iter().map(Vec::len).filter(|&size| size > 1).sum()
    }

    /// `groups of 4, 2 and 1`, or `one group of 7`.
    pub fn in_words(&self) -> String {
        let mut sizes: Vec<String> =
            self.groups.iter().map(|group| group.len().to_string()).collect();
        let last = sizes.pop().unwrap_or_default();
        if sizes.is_empty() {
            return format!("one group of {last}");
        }
        format!("groups of {} and {last}", sizes.join(", "))
    }
}
