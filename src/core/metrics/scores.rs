//! The scores of an image against its reference, over the pixels that count.

use super::{psnr, psnr_colour_corrected, ssim, ssim_where};
use crate::image::Image;
use crate::mask::Mask;

/// The scores of an image against its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scores {
    /// PSNR, dB.
    pub psnr_db: f64,
    /// PSNR after an affine colour fit of each channel, dB.
    pub psnr_cc_db: f64,
    /// SSIM.
    pub ssim: f64,
}

impl Scores {
    /// Scores over the pixels of `mask`, with SSIM's windows around them, or over all; `None` if no
    /// window is left.
    ///
    /// # Panics
    /// When the sizes differ: a fault of the caller.
    pub fn of(image: &Image, reference: &Image, mask: Option<&Mask>) -> Option<Self> {
        let Some(mask) = mask else {
            return Some(Self {
                psnr_db: psnr(image, reference),
                psnr_cc_db: psnr_colour_corrected(image, reference),
                ssim: ssim(image, reference),
            });
        };
        let ssim = ssim_where(image, reference, |x, y| mask.holds(x, y))?;
        let (kept, reference) = (mask.pixels_of(image), mask.pixels_of(reference));
        Some(Self {
            psnr_db: psnr(&kept, &reference),
            psnr_cc_db: psnr_colour_corrected(&kept, &reference),
            ssim,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masked_pixels_are_not_scored() {
        let value = |i: usize| 0.5 + 0.3 * (i as f32 * 0.37).sin();
        let truth = Image::from_planar(40, 30, (0..3 * 40 * 30).map(value).collect());
        let mut image = truth.clone();
        for y in 0..30 {
            (0..20).for_each(|x| image.set(x, y, [0.0; 3]));
        }
        let all = Scores::of(&image, &truth, None).expect("pixels");
        let mask = |from: usize| Mask::new(40, 30, (0..40 * 30).map(|i| i % 40 >= from).collect());
        let kept = Scores::of(&image, &truth, Some(&mask(26))).expect("pixels");
        assert!(all.psnr_db < 12.0 && all.ssim < 0.8, "{all:?}");
        assert!(kept.psnr_db > 99.0 && kept.ssim > 0.999, "{kept:?}");
        assert_eq!(Scores::of(&image, &truth, Some(&mask(0))), Some(all));
        assert_eq!(Scores::of(&image, &truth, Some(&mask(40))), None);
    }
}
