//! Groups of connected photographs.

use std::collections::HashMap;

use crate::poses::matching::Correspondences;

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
        groups.sort_by_key(|group| (std::cmp::Reverse(group.len()), group[0]));
        groups
    }
}
