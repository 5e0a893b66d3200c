//! Codebooks: few values that stand for many. They depend on nothing but the values.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Values of a codebook.
const VALUES: usize = 256;

/// Steps of Lloyd's algorithm, after which the error falls by less than 1 % a step.
const STEPS: usize = 20;

/// 256 values in ascending order.
pub struct Codebook([f32; VALUES]);

impl Codebook {
    /// The values that stand for `numbers` with a small mean square error: k-means in one
    /// dimension. It starts from the quantiles of `numbers`, mixed half and half with their range,
    /// so that rare ones are not far from a value. They must be finite.
    pub fn of(mut numbers: Vec<f32>) -> Self {
        numbers.sort_unstable_by(f32::total_cmp);
        if numbers.is_empty() {
            return Self([0.0; VALUES]);
        }
        let mut book = Self(std::array::from_fn(|n| mixed_quantile(&numbers, n)));
        let mut sums = vec![0.0];
        sums.extend(numbers.iter().scan(0.0, |sum, &number| {
            *sum += f64::from(number);
            Some(*sum)
        }));
        for _ in 0..STEPS {
            let mut from = 0;
            for n in 0..VALUES {
                let to = match book.0.get(n + 1) {
                    Some(next) => numbers.partition_point(|&v| v < f32::midpoint(book.0[n], *next)),
                    None => numbers.len(),
                };
                if to > from {
                    book.0[n] = ((sums[to] - sums[from]) / (to - from) as f64) as f32;
                    from = to;
                }
            }
        }
        book.0.sort_unstable_by(f32::total_cmp);
        book
    }

    /// The index of the value that is nearest to `number`.
    pub fn index(&self, number: f32) -> u8 {
        let above = self.0.partition_point(|&value| value < number).min(VALUES - 1);
        let below = above.saturating_sub(1);
        let is_below = (number - self.0[below]).abs() <= (self.0[above] - number).abs();
        (if is_below { below } else { above }) as u8
    }

    /// The values.
    pub fn values(&self) -> &[f32] {
        &self.0
    }
}

/// Value `n` of a codebook for these numbers, which are sorted.
fn mixed_quantile(numbers: &[f32], n: usize) -> f32 {
    let last = numbers.len() - 1;
    let (least, width) = (numbers[0], (numbers[last] - numbers[0]).max(f32::MIN_POSITIVE));
    let wanted = n as f32 / (VALUES - 1) as f32;
    let rank = |i: usize| 0.5 * (i as f32 / last.max(1) as f32 + (numbers[i] - least) / width);
    // The rank of numbers[above] is not less than `wanted`, that of its neighbour is.
    let (mut below, mut above) = (0, last);
    while above - below > 1 {
        let middle = usize::midpoint(below, above);
        *(if rank(middle) < wanted { &mut below } else { &mut above }) = middle;
    }
    let share = (wanted - rank(below)) / (rank(above) - rank(below)).max(f32::MIN_POSITIVE);
    numbers[below] + share.clamp(0.0, 1.0) * (numbers[above] - numbers[below])
}

/// Vectors that stand for many others.
pub struct Palette {
    /// The vectors.
    pub entries: Vec<Vec<f32>>,
    /// For each of the others the index of its entry.
    pub labels: Vec<u16>,
}

impl Palette {
    /// At most `most` entries for `vectors` of equal length. Starting with one group of all, the
    /// group with the largest error is divided at the mean of its widest dimension, until there are
    /// enough: k-means needs hours on a processor for a million vectors.
    pub fn of(vectors: &[&[f32]], most: usize) -> Self {
        let mut order: Vec<usize> = (0..vectors.len()).collect();
        let mut groups = BinaryHeap::from([Group::of(vectors, &order, 0)]);
        while groups.len() < most {
            let Some(group) = groups.pop() else { break };
            let members = &mut order[group.start..group.start + group.count];
            if group.error == 0 {
                groups.push(group);
                break;
            }
            let (axis, middle) = (group.widest, group.mean[group.widest]);
            members.sort_by_key(|&index| vectors[index][axis] > middle);
            let below = members.partition_point(|&index| vectors[index][axis] <= middle);
            if below == members.len() {
                // Rounding has hidden the difference.
                groups.push(Group { error: 0, ..group });
                continue;
            }
            let (low, high) = members.split_at(below);
            groups.push(Group::of(vectors, low, group.start));
            groups.push(Group::of(vectors, high, group.start + below));
        }
        let mut groups = groups.into_vec();
        groups.sort_unstable_by_key(|group| group.start);
        let mut labels = vec![0; vectors.len()];
        for (label, group) in (0_u16..=u16::MAX).zip(&groups) {
            for &index in &order[group.start..group.start + group.count] {
                labels[index] = label;
            }
        }
        Self { entries: groups.into_iter().map(|group| group.mean).collect(), labels }
    }
}

/// Vectors that share an entry. The group with the largest error comes first.
struct Group {
    /// Sum of the square distances to the mean, as the bits of a positive `f32`.
    error: u32,
    /// Where it begins in the order, which makes groups of one error distinct.
    start: usize,
    count: usize,
    /// The dimension with the largest error.
    widest: usize,
    mean: Vec<f32>,
}

impl Group {
    fn of(vectors: &[&[f32]], members: &[usize], start: usize) -> Self {
        let dimensions = vectors.first().map_or(0, |vector| vector.len());
        let (mut sums, mut squares) = (vec![0.0_f64; dimensions], vec![0.0_f64; dimensions]);
        for &index in members {
            for (axis, &value) in vectors[index].iter().enumerate() {
                sums[axis] += f64::from(value);
                squares[axis] += f64::from(value) * f64::from(value);
            }
        }
        let count = members.len().max(1) as f64;
        let errors: Vec<f64> = sums
            .iter()
            .zip(&squares)
            .map(|(sum, square)| (square - sum * sum / count).max(0.0))
            .collect();
        let widest = (0..dimensions).max_by(|&a, &b| errors[a].total_cmp(&errors[b]));
        let error = if members.len() > 1 { errors.iter().sum::<f64>() as f32 } else { 0.0 };
        Self {
            error: error.to_bits(),
            start,
            count: members.len(),
            widest: widest.unwrap_or_default(),
            mean: sums.iter().map(|sum| (sum / count) as f32).collect(),
        }
    }
}

impl Ord for Group {
    fn cmp(&self, other: &Self) -> Ordering {
        (self.error, self.start).cmp(&(other.error, other.start))
    }
}

impl PartialOrd for Group {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Group {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Group {}

#[cfg(test)]
mod tests;
