//! Mutual nearest neighbours: the fast check whether two photographs may overlap.

use super::KeyPoints;
use super::detect::DESCRIPTOR;

/// Least cosine of two matching descriptors; the published value.
const LEAST_COSINE: f32 = 0.82;

/// Pairs of key points whose descriptors are each other's nearest.
pub(super) fn mutual(a: &KeyPoints, b: &KeyPoints) -> Vec<[u32; 2]> {
    let (rows, columns) = (a.len(), b.len());
    let mut best_of_a = vec![(f32::MIN, 0); rows];
    let mut best_of_b = vec![(f32::MIN, 0); columns];
    for (i, best) in best_of_a.iter_mut().enumerate() {
        let of_a = a.descriptor(i);
        for (j, best_of_j) in best_of_b.iter_mut().enumerate() {
            let cosine = dot(of_a, b.descriptor(j));
            if cosine > best.0 {
                *best = (cosine, j);
            }
            if cosine > best_of_j.0 {
                *best_of_j = (cosine, i);
            }
        }
    }
    let both = best_of_a
        .iter()
        .enumerate()
        .filter(|(i, (cosine, j))| *cosine > LEAST_COSINE && best_of_b[*j].1 == *i);
    both.map(|(i, (_, j))| [i as u32, *j as u32]).collect()
}

/// Sums in lanes, so that the compiler can use the vector unit without reordering a sum itself.
fn dot(a: &[f32; DESCRIPTOR], b: &[f32; DESCRIPTOR]) -> f32 {
    const LANES: usize = 16;
    let mut sums = [0.0; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum()
}
