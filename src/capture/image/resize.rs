//! Resizing: exact area average to shrink, bilinear to enlarge.

use super::Image;

/// How much of each input sample one output sample covers; the weights add up to 1.
struct Span {
    first: usize,
    weights: Vec<f32>,
}

/// The spans of an axis of `from` samples averaged to `to` samples.
fn spans(from: usize, to: usize) -> Vec<Span> {
    let step = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            let (start, end) = (i as f64 * step, ((i + 1) as f64 * step).min(from as f64));
            let first = (start as usize).min(from - 1);
            let last = (end.ceil() as usize).clamp(first + 1, from);
            let covered = |k: usize| (end.min((k + 1) as f64) - start.max(k as f64)).max(0.0);
            let total: f64 = (first..last).map(covered).sum();
            Span { first, weights: (first..last).map(|k| (covered(k) / total) as f32).collect() }
        })
        .collect()
}

/// Averages rows that arrive from top to bottom, so the full-size picture never exists as floats:
/// only a few rows are in memory.
pub(super) struct AreaAverage {
    columns: Vec<Span>,
    rows: Vec<Span>,
}

impl AreaAverage {
    /// From `(width, height)` to `(width, height)`, all at least 1.
    pub(super) fn new(from: (usize, usize), to: (usize, usize)) -> Self {
        Self { columns: spans(from.0, to.0), rows: spans(from.1, to.1) }
    }

    /// Averages one plane into `out` at the new size; `row(y, buffer)` supplies a row of the input
    /// and is called with ascending rows, at most twice for each.
    pub(super) fn plane(
        &self,
        input_width: usize,
        mut row: impl FnMut(usize, &mut [f32]),
        out: &mut [f32],
    ) {
        let width = self.columns.len();
        let mut wide = vec![0.0; input_width];
        let mut narrow = vec![0.0; width];
        let mut have = usize::MAX;
        for (span, target) in self.rows.iter().zip(out.chunks_exact_mut(width)) {
            target.fill(0.0);
            for (offset, &weight) in span.weights.iter().enumerate() {
                if have != span.first + offset {
                    have = span.first + offset;
                    row(have, &mut wide);
                    self.narrow(&wide, &mut narrow);
                }
                target.iter_mut().zip(&narrow).for_each(|(sum, value)| *sum += weight * value);
            }
        }
    }

    fn narrow(&self, wide: &[f32], narrow: &mut [f32]) {
        for (value, span) in narrow.iter_mut().zip(&self.columns) {
            let covered = &wide[span.first..span.first + span.weights.len()];
            *value = covered.iter().zip(&span.weights).map(|(v, w)| v * w).sum();
        }
    }
}

/// The size with its long side reduced to `long_side`; never enlarged, never below 1 px.
pub(crate) fn at_most(width: usize, height: usize, long_side: usize) -> (usize, usize) {
    let longest = width.max(height);
    if longest <= long_side {
        return (width, height);
    }
    let scale = long_side as f64 / longest as f64;
    let scaled = |side: usize| ((side as f64 * scale).round() as usize).max(1);
    (scaled(width), scaled(height))
}

impl<E> Image<E> {
    /// The exact area average at a new size (any factor; each output pixel is the mean of the area
    /// it covers). Averages the encoded values: convert to linear first where light matters.
    ///
    /// # Panics
    /// When the image or the new size is empty: a fault of the caller.
    pub fn resize_area(&self, width: usize, height: usize) -> Self {
        assert!(
            self.pixels() > 0 && width > 0 && height > 0,
            "resizing {self:?} to {width}x{height}",
            self = (self.width, self.height)
        );
        if (width, height) == (self.width, self.height) {
            return self.map(|v| v);
        }
        let average = AreaAverage::new((self.width, self.height), (width, height));
        let mut out = Self::new(width, height);
        for channel in 0..3 {
            let plane = self.plane(channel);
            let row = |y: usize, buffer: &mut [f32]| {
                buffer.copy_from_slice(&plane[y * self.width..(y + 1) * self.width]);
            };
            average.plane(self.width, row, out.plane_mut(channel));
        }
        out
    }

    /// RGB at a point in px, pixel centres at half-integers, bilinear, the border repeated.
    pub fn sample(&self, x: f32, y: f32) -> [f32; 3] {
        let (x0, x1, fx) = neighbours(x, self.width);
        let (y0, y1, fy) = neighbours(y, self.height);
        let n = self.pixels();
        std::array::from_fn(|channel| {
            let at = |x: usize, y: usize| self.data[channel * n + y * self.width + x];
            let top = at(x0, y0) + fx * (at(x1, y0) - at(x0, y0));
            let bottom = at(x0, y1) + fx * (at(x1, y1) - at(x0, y1));
            top + fy * (bottom - top)
        })
    }

    /// Bilinear at a new size, with the corners aligned. For enlarging: shrinking by more than 2
    /// skips pixels; use [`Image::resize_area`] instead.
    pub fn resize_bilinear(&self, width: usize, height: usize) -> Self {
        let (step_x, step_y) =
            (self.width as f32 / width as f32, self.height as f32 / height as f32);
        let mut out = Self::new(width, height);
        for y in 0..height {
            for x in 0..width {
                out.set(x, y, self.sample((x as f32 + 0.5) * step_x, (y as f32 + 0.5) * step_y));
            }
        }
        out
    }

    /// The size of this image with its long side reduced to `long_side` px, never enlarged.
    pub fn size_at_most(&self, long_side: usize) -> (usize, usize) {
        at_most(self.width, self.height, long_side)
    }
}

/// The two samples around a coordinate and the share of the second.
fn neighbours(coordinate: f32, count: usize) -> (usize, usize, f32) {
    let position = (coordinate - 0.5).clamp(0.0, (count - 1) as f32);
    let first = position as usize;
    (first, (first + 1).min(count - 1), position - first as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Srgb;
    use proptest::prelude::*;

    fn ramp(width: usize, height: usize) -> Image<Srgb> {
        let data = (0..3 * width * height).map(|i| ((i * 7919) % 1009) as f32 / 1008.0).collect();
        Image::from_planar(width, height, data)
    }

    #[test]
    fn halving_is_the_mean_of_four_pixels() {
        let image = ramp(6, 4);
        let half = image.resize_area(3, 2);
        let expected =
            (image.get(2, 2)[1] + image.get(3, 2)[1] + image.get(2, 3)[1] + image.get(3, 3)[1])
                / 4.0;
        assert!((half.get(1, 1)[1] - expected).abs() < 1e-6);
    }

    #[test]
    fn three_columns_to_two_weigh_the_shared_column_half() {
        let image =
            Image::<Srgb>::from_planar(3, 1, vec![0.0, 0.3, 0.9, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        let two = image.resize_area(2, 1);
        assert!((two.get(0, 0)[0] - 0.1).abs() < 1e-6 && (two.get(1, 0)[0] - 0.7).abs() < 1e-6);
    }

    #[test]
    fn bilinear_keeps_a_linear_ramp_linear_inside() {
        let data = (0..3).flat_map(|_| (0..8).map(|x| x as f32 / 7.0)).collect();
        let image = Image::<Srgb>::from_planar(8, 1, data);
        let double = image.resize_bilinear(16, 1);
        for x in 1..15 {
            let expected = ((x as f32 + 0.5) / 2.0 - 0.5) / 7.0;
            assert!((double.get(x, 0)[2] - expected).abs() < 1e-6, "{x}");
        }
    }

    proptest! {
        #[test]
        fn an_area_average_keeps_the_mean_and_the_range(
            width in 1usize..40, height in 1usize..40,
            to_width in 1usize..50, to_height in 1usize..50,
        ) {
            let image = ramp(width, height);
            let resized = image.resize_area(to_width, to_height);
            let sum = |image: &Image<Srgb>| image.plane(0).iter().sum::<f32>();
            let mean = |image: &Image<Srgb>| sum(image) / image.pixels() as f32;
            prop_assert!((mean(&image) - mean(&resized)).abs() < 1e-4);
            prop_assert!(resized.data().iter().all(|v| (-1e-5..=1.00001).contains(v)));
        }

        #[test]
        fn the_long_side_never_grows_and_no_side_vanishes(
            width in 1usize..9000, height in 1usize..9000, limit in 1usize..3000,
        ) {
            let (w, h) = at_most(width, height, limit);
            prop_assert!(w >= 1 && h >= 1 && w <= width && h <= height && w.max(h) <= limit.max(1));
        }
    }
}
