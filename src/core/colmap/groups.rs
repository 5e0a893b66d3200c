//! Groups of connected photographs.

use std::cmp::Reverse;
use std::collections::HashMap;

use crate::poses::PoseView;
use crate::poses::matching::{Correspondences, PairMatches};
use crate::poses::overlap::{Overlap, OverlapLink};

/// Fewer matches do not connect photographs.
pub(super) const LEAST_MATCHES: usize = 30;

/// Photographs connected by matches, regardless of a model; the largest group first.
pub(super) fn connected(found: &Correspondences) -> Vec<Vec<usize>> {
    let views: Vec<usize> = (0..found.key_points.len()).collect();
    let mut groups = Groups::new(&views);
    for pair in &found.pairs {
        if pair.matches.len() >= LEAST_MATCHES {
            groups.join(pair.first, pair.second);
        }
    }
    groups.members()
}

/// Pairs with a smaller share of the matches of the strongest pair of both of their photographs do
/// not clearly show one place. Of six sharp photographs of three places the pairs of one place have
/// 766 to 997 matches and those of two up to 62, which also fit an epipolar geometry.
const CLEAR: f64 = 0.15;

/// Photographs connected by pairs that clearly show one place; the largest group first.
pub(super) fn clearly_connected(found: &Correspondences) -> Vec<Vec<usize>> {
    let clear = Clear::new(found);
    let views: Vec<usize> = (0..found.key_points.len()).collect();
    let mut groups = Groups::new(&views);
    for pair in found.pairs.iter().filter(|pair| clear.connects(pair)) {
        groups.join(pair.first, pair.second);
    }
    groups.members()
}

/// The number of matches of each photograph's strongest pair.
struct Clear(Vec<usize>);

impl Clear {
    fn new(found: &Correspondences) -> Self {
        let mut strongest = vec![0; found.key_points.len()];
        for pair in &found.pairs {
            for view in [pair.first, pair.second] {
                strongest[view] = pair.matches.len().max(strongest[view]);
            }
        }
        Self(strongest)
    }

    fn connects(&self, pair: &PairMatches) -> bool {
        let matches = pair.matches.len();
        let strongest = self.0[pair.first].min(self.0[pair.second]);
        matches >= LEAST_MATCHES && matches as f64 >= CLEAR * strongest as f64
    }
}

/// Up to this many photographs the links to the [`STRONGEST`] of each are listed, beyond it only
/// those that connect the groups: a job keeps them all.
const MOST_LISTED: usize = 60;

/// Number of links of each photograph.
const STRONGEST: usize = 3;

/// The groups of the photographs `views` and the pairs that connect them; `None` if there is but
/// one group.
pub(super) fn overlap(found: &Correspondences, views: &[PoseView]) -> Option<Overlap> {
    let groups = clearly_connected(found);
    if groups.len() < 2 {
        return None;
    }
    let clear = Clear::new(found);
    let name = |index: usize| views[index].name.clone();
    let link = |pair: &PairMatches| OverlapLink {
        first: name(pair.first),
        second: name(pair.second),
        matches: pair.matches.len(),
        connects: clear.connects(pair),
    };
    Some(Overlap {
        links: strongest(found).into_iter().map(link).collect(),
        groups: groups.iter().map(|group| group.iter().map(|&view| name(view)).collect()).collect(),
    })
}

/// The maximum spanning forest of the matches, and some more of the connecting pairs.
fn strongest(found: &Correspondences) -> Vec<&PairMatches> {
    let views: Vec<usize> = (0..found.key_points.len()).collect();
    let most = if views.len() <= MOST_LISTED { STRONGEST } else { 0 };
    let mut pairs: Vec<&PairMatches> = found.pairs.iter().collect();
    pairs.sort_by_key(|pair| (Reverse(pair.matches.len()), pair.first, pair.second));
    let clear = Clear::new(found);
    let mut forest = Groups::new(&views);
    let mut listed = vec![0; views.len()];
    pairs.retain(|pair| {
        let joins = forest.join(pair.first, pair.second);
        let is_strong = listed[pair.first] < most || listed[pair.second] < most;
        let is_listed = joins || is_strong && clear.connects(pair);
        listed[pair.first] += usize::from(is_listed);
        listed[pair.second] += usize::from(is_listed);
        is_listed
    });
    pairs
}

/// Views in disjoint groups.
pub(super) struct Groups(HashMap<usize, usize>);

impl Groups {
    /// Each view in its own group.
    pub fn new(views: &[usize]) -> Self {
        Self(views.iter().map(|&view| (view, view)).collect())
    }

    /// Joins the groups of two views; returns whether they were different.
    pub fn join(&mut self, a: usize, b: usize) -> bool {
        let (from, to) = (self.0[&a], self.0[&b]);
        for group in self.0.values_mut() {
            if *group == from {
                *group = to;
            }
        }
        from != to
    }

    /// The groups, largest first, then by the first view.
    pub fn members(&self) -> Vec<Vec<usize>> {
        let mut groups: HashMap<usize, Vec<usize>> = HashMap::new();
        for (&view, &group) in &self.0 {
            groups.entry(group).or_default().push(view);
        }
        let mut groups: Vec<Vec<usize>> = groups.into_values().collect();
        groups.iter_mut().for_each(|group| group.sort_unstable());
        groups.sort_by_key(|group| (Reverse(group.len()), group[0]));
        groups
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(photographs: usize, pairs: &[(usize, usize, u32)]) -> Correspondences {
        let pair = |&(first, second, matches): &(usize, usize, u32)| PairMatches {
            first,
            second,
            matches: (0..matches).map(|point| [point, point]).collect(),
        };
        Correspondences {
            key_points: vec![Vec::new(); photographs],
            pairs: pairs.iter().map(pair).collect(),
            kept: 0,
        }
    }

    #[test]
    fn links_connect_each_group_and_the_strongest_lead_from_one_to_another() {
        let least = LEAST_MATCHES as u32;
        let pairs =
            [(0, 1, 90), (0, 2, 50), (1, 2, least), (3, 4, 70), (2, 3, least - 1), (0, 3, 9)];
        let found = found(6, &pairs);
        assert_eq!(connected(&found), [vec![0, 1, 2], vec![3, 4], vec![5]]);
        let pairs = strongest(&found).into_iter();
        let listed: Vec<_> =
            pairs.map(|pair| (pair.first, pair.second, pair.matches.len() as u32)).collect();
        assert_eq!(listed, [(0, 1, 90), (3, 4, 70), (0, 2, 50), (1, 2, least), (2, 3, least - 1)]);
    }

    #[test]
    fn many_fewer_matches_than_those_of_the_strongest_pairs_connect_no_places() {
        let places = [(0, 1, 997), (2, 3, 817), (4, 5, 766)];
        let between = [(0, 4, 62), (1, 4, 47), (2, 5, 56), (1, 5, 40)];
        let rooms = found(6, &[&places[..], &between].concat());
        assert_eq!(connected(&rooms), [vec![0, 1, 2, 3, 4, 5]]);
        assert_eq!(clearly_connected(&rooms), [[0, 1], [2, 3], [4, 5]]);
        // Where all pairs have few, few are enough.
        let dark = found(3, &[(0, 1, 90), (1, 2, 31)]);
        assert_eq!(clearly_connected(&dark), [vec![0, 1, 2]]);
    }

    #[test]
    fn of_many_photographs_only_the_links_of_the_forest_are_listed() {
        let count = MOST_LISTED + 1;
        let all: Vec<_> = (0..count)
            .flat_map(|first| (first + 1..count).map(move |second| (first, second, 99)))
            .collect();
        assert_eq!(strongest(&found(count, &all)).len(), count - 1);
    }
}
