//! LighterGlue: matches the key points of two photographs.

use super::detect::DESCRIPTOR;
use super::key_points::KeyPoints;
use crate::inference::{Input, Network};

/// Least probability of a match, as published.
const LEAST_SCORE: f32 = 0.1;

/// A match of two key points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Index in the first photograph.
    pub first: u32,
    /// Index in the second.
    pub second: u32,
    /// Probability, 0..=1.
    pub score: f32,
}

/// LighterGlue, ready to run.
pub struct Matcher {
    network: Network,
}

impl Matcher {
    pub(super) fn new(network: Network) -> Self {
        Self { network }
    }

    /// The matches of two photographs; each key point has at most one.
    ///
    /// # Errors
    /// ONNX Runtime's message.
    pub fn matches(&mut self, a: &KeyPoints, b: &KeyPoints) -> Result<Vec<Match>, String> {
        if a.is_empty() || b.is_empty() {
            return Ok(Vec::new());
        }
        let (points_a, points_b) = (a.normalised(), b.normalised());
        let (points_of_a, points_of_b) = ([1, a.len(), 2], [1, b.len(), 2]);
        let (shape_of_a, shape_of_b) = ([1, a.len(), DESCRIPTOR], [1, b.len(), DESCRIPTOR]);
        let input = |name, shape, values| Input { name, shape, values };
        let inputs = [
            input("points_a", &points_of_a, &points_a[..]),
            input("points_b", &points_of_b, &points_b[..]),
            input("descriptors_a", &shape_of_a, &a.descriptors[..]),
            input("descriptors_b", &shape_of_b, &b.descriptors[..]),
        ];
        let [scores] = self.network.run(&inputs, ["scores"])?;
        if scores.shape != [a.len(), b.len()] {
            return Err(format!("it returned {:?}", scores.shape));
        }
        Ok(mutual(&scores.values, b.len()))
    }
}

/// Entries of a matrix that are the highest of their row and column, and above [`LEAST_SCORE`].
fn mutual(scores: &[f32], columns: usize) -> Vec<Match> {
    let mut best_row = vec![(f32::MIN, 0); columns];
    for (row, values) in scores.chunks_exact(columns).enumerate() {
        for (best, &value) in best_row.iter_mut().zip(values) {
            if value > best.0 {
                *best = (value, row);
            }
        }
    }
    let rows = scores.chunks_exact(columns).enumerate();
    rows.filter_map(|(row, values)| {
        let (column, &score) = values.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        (score > LEAST_SCORE && best_row[column].1 == row).then_some(Match {
            first: row as u32,
            second: column as u32,
            score,
        })
    })
    .collect()
}
