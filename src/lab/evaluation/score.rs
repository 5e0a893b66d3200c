//! Scores of a render against a sharp photograph, over the whole picture and over a part of it.

use rayon::prelude::*;

use super::report::{Scores, ViewScores};
use fled_core::image::Image;
use fled_core::mask::Mask;
use fled_core::metrics::{self, ColourFit};

/// Standard deviation of the Gaussian that removes detail finer than 3 px, px.
const FINE_SIGMA: f32 = 1.5;
/// Smallest share of the pixels that is scored.
const LEAST_SHARE: f64 = 0.05;

/// The scores of a render, without LPIPS, over the pixels of `scored` and over those of them that
/// two training views see. `None` if no pixel is scored.
pub(super) fn scores(
    render: &Image,
    truth: &Image,
    scored: &Mask,
    seen: &Mask,
) -> Option<ViewScores> {
    let seen = seen.and(scored);
    let (all, within_seen) =
        rayon::join(|| within(render, truth, scored), || within(render, truth, &seen));
    Some(ViewScores { all: all?, seen: within_seen.filter(|_| seen.share() >= LEAST_SHARE) })
}

/// The scores over the pixels of a mask; `None` if it is empty.
fn within(render: &Image, truth: &Image, mask: &Mask) -> Option<Scores> {
    let of = metrics::Scores::of(render, truth, Some(mask))?;
    let (kept, reference) = (mask.pixels_of(render), mask.pixels_of(truth));
    let fit = ColourFit::between(&kept, &reference);
    Some(Scores {
        psnr_db: of.psnr_db,
        psnr_cc_db: of.psnr_cc_db,
        psnr_fine_db: fine(&fit.apply(render), truth, mask),
        ssim: of.ssim,
        lpips_squeeze: None,
    })
}

/// PSNR over the part of the difference of two pictures that is finer than 3 px, dB.
fn fine(image: &Image, truth: &Image, mask: &Mask) -> f64 {
    let difference = minus(image, truth);
    let fine = minus(&difference, &blurred(&difference));
    let kept = mask.pixels_of(&fine);
    let squares = kept.data().iter().map(|v| f64::from(*v).powi(2));
    metrics::decibels(squares.sum::<f64>() / kept.data().len().max(1) as f64)
}

fn minus(a: &Image, b: &Image) -> Image {
    let values = a.data().iter().zip(b.data());
    let values = values.map(|(a, b)| a - b).collect();
    Image::from_planar(a.width(), a.height(), values)
}

/// Blurs with a Gaussian of [`FINE_SIGMA`], repeating the border.
fn blurred(image: &Image) -> Image {
    const RADIUS: isize = 5;
    let weight = |tap: isize| (-(tap as f32).powi(2) / (2.0 * FINE_SIGMA * FINE_SIGMA)).exp();
    let total: f32 = (-RADIUS..=RADIUS).map(weight).sum();
    let (width, height) = (image.width() as isize, image.height() as isize);
    let along = |image: &Image, dx: isize, dy: isize| {
        let value = |i: usize| {
            let (x, y) = (i as isize % width, i as isize / width % height);
            let plane = i - (y * width + x) as usize;
            let at = |tap: isize| {
                let x = (x + dx * tap).clamp(0, width - 1);
                let y = (y + dy * tap).clamp(0, height - 1);
                image.data()[plane + (y * width + x) as usize]
            };
            (-RADIUS..=RADIUS).map(|tap| weight(tap) / total * at(tap)).sum::<f32>()
        };
        let values = (0..image.data().len()).into_par_iter().map(value);
        Image::from_planar(image.width(), image.height(), values.collect())
    };
    along(&along(image, 1, 0), 0, 1)
}

/// Means over views. The part seen by two training views is averaged over the views that have
/// enough of it.
pub(super) fn mean(all: &[&ViewScores]) -> ViewScores {
    let seen: Vec<Scores> = all.iter().filter_map(|scores| scores.seen).collect();
    let whole: Vec<Scores> = all.iter().map(|scores| scores.all).collect();
    ViewScores { all: mean_of(&whole), seen: (!seen.is_empty()).then(|| mean_of(&seen)) }
}

fn mean_of(all: &[Scores]) -> Scores {
    let mean =
        |value: fn(&Scores) -> f64| all.iter().map(value).sum::<f64>() / all.len().max(1) as f64;
    let lpips: Option<Vec<f64>> = all.iter().map(|scores| scores.lpips_squeeze).collect();
    let lpips = lpips.filter(|values| !values.is_empty());
    Scores {
        psnr_db: mean(|scores| scores.psnr_db),
        psnr_cc_db: mean(|scores| scores.psnr_cc_db),
        psnr_fine_db: mean(|scores| scores.psnr_fine_db),
        ssim: mean(|scores| scores.ssim),
        lpips_squeeze: lpips.map(|values| values.iter().sum::<f64>() / values.len() as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture with structures of every size.
    fn picture() -> Image {
        let value = |i: usize| {
            let (x, y) = ((i % 60) as f32, (i / 60 % 48) as f32);
            0.5 + 0.2 * (x * 0.7 + y * 0.3).sin() + 0.15 * (x * 0.05).cos() * (y * 0.11).sin()
        };
        Image::from_planar(60, 48, (0..3 * 60 * 48).map(value).collect())
    }

    #[test]
    fn a_coarse_error_is_not_a_fine_one() {
        let truth = picture();
        let mut coarse = truth.clone();
        let mut grainy = truth.clone();
        for (i, v) in coarse.data_mut().iter_mut().enumerate() {
            *v += 0.1 * ((i % 60) as f32 * std::f32::consts::TAU / 60.0).sin();
        }
        for (i, v) in grainy.data_mut().iter_mut().enumerate() {
            *v += if (i % 60 + i / 60 % 48) % 2 == 0 { 0.05 } else { -0.05 };
        }
        let mask = Mask::full(60, 48);
        let [coarse, grainy] =
            [coarse, grainy].map(|image| scores(&image, &truth, &mask, &mask).expect("pixels").all);
        assert!(coarse.psnr_fine_db > coarse.psnr_cc_db + 12.0, "{coarse:?}");
        assert!((grainy.psnr_fine_db - grainy.psnr_cc_db).abs() < 1.0, "{grainy:?}");
    }

    #[test]
    fn pixels_outside_the_mask_count_in_one_column_only() {
        let truth = picture();
        let mut render = truth.clone();
        for y in 0..48 {
            (30..60).for_each(|x| render.set(x, y, [0.0; 3]));
        }
        let left = (0..60 * 48).map(|i| i % 60 < 24).collect();
        let everything = Mask::full(60, 48);
        let left = Mask::new(60, 48, left);
        let scores = scores(&render, &truth, &everything, &left).expect("pixels");
        let inside = super::scores(&render, &truth, &left, &everything).expect("pixels");
        assert_eq!(Some(inside.all), scores.seen);
        let seen = scores.seen.expect("two fifths are seen");
        assert!(scores.all.psnr_db < 15.0 && seen.psnr_db > 99.0, "{scores:?}");
        assert!(scores.all.ssim < 0.7 && seen.ssim > 0.999, "{scores:?}");
        let hardly = (0..60 * 48).map(|i| i < 20).collect();
        let hardly = super::scores(&render, &truth, &everything, &Mask::new(60, 48, hardly));
        assert!(hardly.expect("pixels").seen.is_none());
        let nothing = Mask::new(60, 48, vec![false; 60 * 48]);
        assert!(super::scores(&render, &truth, &nothing, &everything).is_none());
    }
}
