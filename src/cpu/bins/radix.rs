//! The order of depths.

/// Bits of a pass.
const BITS: u32 = 11;

/// A stable sort of the finite depths, with its buffers.
#[derive(Debug, Default)]
pub(super) struct Sort {
    /// Key and index.
    pairs: Vec<u64>,
    scratch: Vec<u64>,
}

impl Sort {
    /// Sorts the indices of the finite `depths`, none negative; equal ones stay in their order.
    pub(super) fn run(&mut self, depths: &[f32]) {
        self.pairs.clear();
        let mut least = u32::MAX;
        for (index, depth) in depths.iter().enumerate() {
            if depth.is_finite() {
                let key = depth.to_bits();
                least = least.min(key);
                self.pairs.push(u64::from(key) << 32 | index as u64);
            }
        }
        // Numbers above 0 sort like their bits, the first of which are the same within a scene.
        let mut greatest = 0;
        for pair in &mut self.pairs {
            *pair -= u64::from(least) << 32;
            greatest = greatest.max(*pair >> 32);
        }
        self.scratch.resize(self.pairs.len(), 0);
        let mut shift = 0;
        while greatest >> shift > 0 {
            self.pass(32 + shift);
            shift += BITS;
        }
    }

    fn pass(&mut self, shift: u32) {
        const BUCKETS: usize = 1 << BITS;
        let bucket = |pair: u64| (pair >> shift) as usize % BUCKETS;
        let mut places = [0_u32; BUCKETS];
        for &pair in &self.pairs {
            places[bucket(pair)] += 1;
        }
        let mut sum = 0;
        for place in &mut places {
            sum += std::mem::replace(place, sum);
        }
        for &pair in &self.pairs {
            let place = &mut places[bucket(pair)];
            self.scratch[*place as usize] = pair;
            *place += 1;
        }
        std::mem::swap(&mut self.pairs, &mut self.scratch);
    }

    /// Indices in the lower half of each, near to far.
    pub(super) fn order(&self) -> &[u64] {
        &self.pairs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finite_depths_are_sorted_and_equal_ones_keep_their_order() {
        let mut state = 7_u32;
        let depths: Vec<f32> = (0..5_000)
            .map(|index| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let depth = (state >> 22) as f32 / 64.0 + 0.01;
                if index % 9 == 0 { f32::INFINITY } else { depth }
            })
            .collect();
        let mut expected: Vec<usize> = (0..5_000).filter(|&i| depths[i].is_finite()).collect();
        expected.sort_by(|&a, &b| depths[a].total_cmp(&depths[b]));
        let mut sort = Sort::default();
        // Twice: nothing may depend on leftovers.
        sort.run(&depths[..700]);
        sort.run(&depths);
        let found: Vec<_> = sort.order().iter().map(|&pair| pair as u32 as usize).collect();
        assert_eq!(found, expected);
        sort.run(&[f32::INFINITY; 3]);
        assert!(sort.order().is_empty());
    }
}
