//! Correlation of two images' structures.

use crate::image::Image;

/// Scale below which structures are noise or shake, px.
const CELL: usize = 4;

/// Radius of the local mean, in cells. Structures larger than about twice as many cells are
/// illumination, which is similar in many places.
const RADIUS: usize = 4;

/// Correlation, -1..=1, of the structures between 4 and about 40 px in two images of one size: near
/// 1 if both show the same from the same place, even if one is noisier, softer or brighter; near 0
/// if not. 0 if either is empty.
pub fn correlation(image: &Image, reference: &Image) -> f64 {
    super::assert_same_size(image, reference);
    let (a, b) = (structure(image), structure(reference));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let size = (product(&a, &a) * product(&b, &b)).sqrt();
    if size.is_finite() && size > 0.0 { product(&a, &b) / size } else { 0.0 }
}

/// The luma of each cell minus its mean over the cells around.
fn structure(image: &Image) -> Vec<f64> {
    let side = |pixels: usize| pixels.div_ceil(CELL);
    let (width, height) = (side(image.width()), side(image.height()));
    let luma = image.resize_area(width, height).luma();
    let values: Vec<f64> = luma.into_iter().map(f64::from).collect();
    let rows = around(&values, width, height);
    let columns = around(&turned(&rows, width, height), height, width);
    let means = turned(&columns, height, width);
    values.iter().zip(means).map(|(value, mean)| value - mean).collect()
}

/// Means over up to [`RADIUS`] values on each side within a row.
fn around(values: &[f64], width: usize, height: usize) -> Vec<f64> {
    let mean = |row: usize, x: usize| {
        let (from, to) = (x.saturating_sub(RADIUS), (x + RADIUS + 1).min(width));
        let some = &values[row * width + from..row * width + to];
        some.iter().sum::<f64>() / some.len() as f64
    };
    (0..height).flat_map(|row| (0..width).map(move |x| mean(row, x))).collect()
}

/// Transposes the values.
fn turned(values: &[f64], width: usize, height: usize) -> Vec<f64> {
    (0..width).flat_map(|x| (0..height).map(move |y| values[y * width + x])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of many sizes, shifted by this many px.
    fn blocks(shift: usize) -> Image {
        let mut image = Image::new(160, 120);
        for y in 0..120 {
            for x in 0..160 {
                let (u, v) = ((x + shift) / 13, (y + shift / 2) / 11);
                let level = (u * 7 + v * 5 + u * v * 3) % 10;
                image.set(x, y, [0.2 + 0.06 * level as f32; 3]);
            }
        }
        image
    }

    #[test]
    fn only_the_same_place_correlates_despite_noise_and_light() {
        let here = blocks(0);
        assert!((correlation(&here, &here) - 1.0).abs() < 1e-12);
        let mut other_light = here.map(|value| 0.3 + 0.4 * value * value);
        for (i, value) in other_light.data_mut().iter_mut().enumerate() {
            *value += 0.2 * ((i * 7919 % 1000) as f32 / 1000.0 - 0.5);
        }
        let same = correlation(&other_light, &here);
        assert!(same > 0.8, "{same}");
        let moved = correlation(&blocks(20), &here);
        assert!(moved < 0.3, "{moved}");
        let flat = here.map(|_| 0.4);
        assert_eq!(correlation(&flat, &flat), 0.0);
    }
}
