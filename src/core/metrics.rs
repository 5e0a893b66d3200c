//! Quality metrics of each round.
//!
//! [`psnr`], [`psnr_colour_corrected`], [`ssim`] and [`correlation`] compare an image (first
//! argument; the first three clip it to 0..=1) with a reference of the same size (second,
//! unchanged). [`noise_sigma`], [`sharpness`], [`mean_v`] and [`clipped_share`] describe a single
//! image.

mod correlation;
mod noise;
mod psnr;
pub mod report;
mod scores;
mod ssim;

#[cfg(test)]
mod golden;

pub use correlation::correlation;
pub use noise::{clipped_share, mean_v, noise_sigma, sharpness};
pub use psnr::{ColourFit, decibels, noise_ceiling, psnr, psnr_colour_corrected};
pub use report::{
    Brightness, CaptureExposure, CaptureShake, ChosenDetail, DetailLevel, ImageKind, Record,
    Reference, Report, RoundMetrics, ViewExposure, ViewScore,
};
pub use scores::Scores;
pub use ssim::{ssim, ssim_where};

use crate::image::Image;

fn assert_same_size(image: &Image, reference: &Image) {
    let (a, b) = ((image.width(), image.height()), (reference.width(), reference.height()));
    assert_eq!(a, b, "image and reference: sizes differ");
}
