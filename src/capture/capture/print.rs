//! A tiny copy of a picture by which two files of one exposure are recognised.

use crate::image::{Image, Srgb};

/// Side of the compared pictures, px: averages out noise and compression artefacts.
const SIDE: usize = 24;

/// A picture for comparison: luma of zero mean and unit length.
pub(super) struct Print(Vec<f32>);

impl Print {
    pub(super) fn of(picture: &Image<Srgb>) -> Self {
        let luma = picture.resize_area(SIDE, SIDE).luma();
        let mean = luma.iter().sum::<f32>() / luma.len() as f32;
        let length = luma.iter().map(|v| (v - mean).powi(2)).sum::<f32>().sqrt().max(1e-9);
        Self(luma.into_iter().map(|v| (v - mean) / length).collect())
    }

    /// 1 for pictures that differ in brightness and contrast alone.
    pub(super) fn correlation(&self, other: &Self) -> f32 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }
}
