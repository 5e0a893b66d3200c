//! Kernels as numbers, for checkpoints: for each view the number of taps, then x, y and weights.

use super::{CELLS, MOST_TAPS, ShakeKernel, Tap};

/// Numbers per tap.
const TAP_NUMBERS: usize = 2 + CELLS;

/// The kernels as numbers.
pub fn save<'a>(kernels: impl IntoIterator<Item = &'a ShakeKernel>) -> Vec<f32> {
    let mut state = Vec::new();
    for kernel in kernels {
        state.push(kernel.taps.len() as f32);
        for Tap { offset, weights } in &kernel.taps {
            state.extend([offset[0] as f32, offset[1] as f32]);
            state.extend(weights);
        }
    }
    state
}

/// The kernels of [`save`], one per view; `None` for invalid numbers.
pub fn parse(state: &[f32], views: usize) -> Option<Vec<ShakeKernel>> {
    let mut rest = state;
    let mut kernels = Vec::with_capacity(views);
    for _ in 0..views {
        let (&count, tail) = rest.split_first()?;
        let count = count as usize;
        if count == 0 || count > MOST_TAPS {
            return None;
        }
        let (numbers, tail) = tail.split_at_checked(TAP_NUMBERS * count)?;
        let (taps, _) = numbers.as_chunks::<TAP_NUMBERS>();
        // Unchanged: normalising again would change the last bit.
        let tap = |&[x, y, ref weights @ ..]: &[f32; TAP_NUMBERS]| Tap {
            offset: [x as i32, y as i32],
            weights: *weights,
        };
        kernels.push(ShakeKernel { taps: taps.iter().map(tap).collect() });
        rest = tail;
    }
    rest.is_empty().then_some(kernels)
}
