//! Chooses the frames to take.

/// Segments of equal length, from each of which one frame is taken.
pub(super) struct Segments {
    frames: usize,
    count: usize,
}

/// Share at each end of a segment from which nothing is taken: otherwise the sharpest frames of
/// adjacent segments could be adjacent, too.
const MARGIN: f64 = 0.1;

impl Segments {
    /// For a video with `frames` frames: `count` segments, or one per frame if there are fewer.
    pub(super) fn of(frames: usize, count: usize) -> Self {
        Self { frames, count: count.clamp(1, frames.max(1)) }
    }

    /// The sharpest frame of each segment, in order, without repeats.
    pub(super) fn sharpest(&self, sharpness: &[f32]) -> Vec<usize> {
        (0..self.count)
            .map(|segment| {
                let range = self.range(segment);
                let first = range.start;
                range.max_by(|&a, &b| sharpness[a].total_cmp(&sharpness[b])).unwrap_or(first)
            })
            .collect()
    }

    fn range(&self, segment: usize) -> std::ops::Range<usize> {
        let length = self.frames as f64 / self.count as f64;
        let (from, to) = (segment as f64 * length, (segment + 1) as f64 * length);
        let margin = MARGIN * length;
        let inner = (from + margin).ceil() as usize..(to - margin).floor() as usize;
        if inner.is_empty() {
            let whole = from as usize;
            return whole..(to as usize).clamp(whole + 1, self.frames.max(whole + 1));
        }
        inner
    }
}

/// Mean squared gradient over the squared mean, for a square of grey values: independent of
/// exposure, comparable within one video.
pub(super) fn sharpness(grey: &[u8], side: usize) -> f32 {
    let value = |x: usize, y: usize| f32::from(grey[y * side + x]);
    let (mut energy, mut sum) = (0.0_f64, 0.0_f64);
    for y in 0..side - 1 {
        for x in 0..side - 1 {
            let here = value(x, y);
            let (dx, dy) = (value(x + 1, y) - here, value(x, y + 1) - here);
            energy += f64::from(dx * dx + dy * dy);
            sum += f64::from(here);
        }
    }
    let pixels = ((side - 1) * (side - 1)) as f64;
    let mean = (sum / pixels).max(0.5);
    (energy / pixels / (mean * mean)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_sharpest_frame_of_each_segment_is_taken() {
        let mut sharpness = vec![1.0; 40];
        for sharp in [5, 17, 22, 33] {
            sharpness[sharp] = 2.0;
        }
        assert_eq!(Segments::of(40, 4).sharpest(&sharpness), [5, 17, 22, 33]);
    }

    #[test]
    fn blur_reduces_sharpness_and_darkness_does_not() {
        let side = 16;
        let stripes: Vec<u8> =
            (0..side * side).map(|i| if i % side % 4 < 2 { 40 } else { 200 }).collect();
        let darker: Vec<u8> = stripes.iter().map(|v| v / 4).collect();
        let soft: Vec<u8> = stripes.iter().map(|&v| v / 2 + 60).collect();
        let sharp = sharpness(&stripes, side);
        assert!((sharpness(&darker, side) / sharp - 1.0).abs() < 0.05);
        assert!(sharpness(&soft, side) < 0.5 * sharp);
    }

    proptest! {
        #[test]
        fn frames_taken_exist_and_are_in_order(
            sharpness in prop::collection::vec(0.0_f32..1.0, 3..200), count in 1..80_usize
        ) {
            let chosen = Segments::of(sharpness.len(), count).sharpest(&sharpness);
            prop_assert_eq!(chosen.len(), count.min(sharpness.len()));
            prop_assert!(chosen.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert!(chosen.iter().all(|&frame| frame < sharpness.len()));
        }
    }
}
