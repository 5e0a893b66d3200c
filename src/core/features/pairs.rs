//! Chooses the pairs of photographs to match.

use super::detect::DESCRIPTOR;
use crate::poses::matching::Pairs;

/// Number of photographs up to which every pair is matched.
const ALL_PAIRS: usize = 60;

/// Beyond it, number of followers of each in the capture's order.
const FOLLOWERS: usize = 8;

/// Beyond it, number of the photographs most similar to each.
const SIMILAR: usize = 12;

/// Upper bound of the number of pairs.
pub(super) fn count(photographs: usize, pairs: Pairs) -> usize {
    if let Pairs::Across(first) = pairs {
        first * photographs.saturating_sub(first)
    } else if photographs <= ALL_PAIRS {
        photographs * photographs.saturating_sub(1) / 2
    } else {
        photographs * (FOLLOWERS + SIMILAR)
    }
}

/// Pairs of indices, the lower first, in order. `pooled` has one vector per photograph.
pub(super) fn candidates(pooled: &[[f32; DESCRIPTOR]], wanted: Pairs) -> Vec<(usize, usize)> {
    let count = pooled.len();
    if let Pairs::Across(some) = wanted {
        let others = |first| (some..count).map(move |second| (first, second));
        return (0..some).flat_map(others).collect();
    }
    let mut pairs: Vec<(usize, usize)> = Vec::new();
    if count <= ALL_PAIRS {
        for first in 0..count {
            pairs.extend((first + 1..count).map(|second| (first, second)));
        }
        return pairs;
    }
    for first in 0..count {
        pairs.extend((first + 1..count.min(first + 1 + FOLLOWERS)).map(|second| (first, second)));
        let cosine = |other: usize| -> f32 {
            pooled[first].iter().zip(&pooled[other]).map(|(a, b)| a * b).sum()
        };
        let mut others: Vec<(f32, usize)> = (0..count)
            .filter(|&other| other != first)
            .map(|other| (cosine(other), other))
            .collect();
        others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let similar = others.iter().take(SIMILAR);
        pairs.extend(similar.map(|&(_, other)| (first.min(other), first.max(other))));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_photographs_are_paired_by_order_and_similarity() {
        let vector = |turn: usize| {
            let mut vector = [0.0; DESCRIPTOR];
            let angle = std::f32::consts::TAU * turn as f32 / 200.0;
            (vector[0], vector[1]) = (angle.cos(), angle.sin());
            vector
        };
        let few: Vec<_> = (0..ALL_PAIRS).map(vector).collect();
        assert_eq!(candidates(&few, Pairs::Within).len(), count(ALL_PAIRS, Pairs::Within));
        assert_eq!(
            (count(ALL_PAIRS, Pairs::Within), count(0, Pairs::Within)),
            (ALL_PAIRS * (ALL_PAIRS - 1) / 2, 0)
        );
        // Two full turns: each photograph of the second is similar to one of the first.
        let many: Vec<_> = (0..400).map(|i| vector(i % 200)).collect();
        let pairs = candidates(&many, Pairs::Within);
        assert!(
            pairs.contains(&(10, 11)) && pairs.contains(&(10, 18)) && pairs.contains(&(10, 210))
        );
        assert!(!pairs.contains(&(10, 100)));
        assert!(pairs.len() < count(400, Pairs::Within));
        assert!(pairs.iter().all(|(first, second)| first < second));
    }

    #[test]
    fn two_sets_are_paired_across_and_not_within() {
        let pooled = vec![[0.0; DESCRIPTOR]; 5];
        let pairs = candidates(&pooled, Pairs::Across(2));
        assert_eq!(pairs, [(0, 2), (0, 3), (0, 4), (1, 2), (1, 3), (1, 4)]);
        assert_eq!(count(5, Pairs::Across(2)), pairs.len());
        assert_eq!(count(2, Pairs::Across(2)), 0);
    }
}
