//! Pose copies: the dark originals as COLMAP should see them.
//!
//! One gain a photograph in linear light, so that the median level is sRGB 0.4, and a soft clip:
//! of gamma, weaker gain, the original, CLAHE and denoising, this registered most photographs.
//! Area-averaging to about 560 px is a denoiser for free.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::cancel::CancelToken;
use crate::image::{Image, Srgb, read_header, srgb_to_linear};
use crate::poses::{PoseView, PosesError};

/// sRGB level that the median is brought to.
const MEDIAN_LEVEL: f32 = 0.4;

/// Copies longer than this are brought down to [`SMALL_SIDE`]: under 250-300 px features run out.
const LARGEST_SMALL_SIDE: usize = 640;

/// Long side of a small copy, px: where the thresholds of the strategies were measured.
const SMALL_SIDE: usize = 560;

/// Linear light up to which nothing is clipped; above it values approach 1 without reaching it.
const KNEE: f32 = 0.7;

/// Focal lengths that differ by less are one lens, focused nearer or farther.
const SAME_LENS: f64 = 1.05;

/// A photograph whose median is darker than half a code value of 8 bits gets no more gain.
const DARKEST_MEDIAN: f32 = 0.5 / 255.0 / 12.92;

/// Where the copies stand and how they relate to the originals.
#[derive(Clone, Debug)]
pub(super) struct Copies {
    pub dir: PathBuf,
    pub copies: Vec<Copy>,
    /// Whether one camera took them: all have one size, and one focal length where EXIF tells.
    pub one_camera: bool,
    /// How many focal lengths EXIF tells of, those within 5 % taken for one.
    pub zooms: usize,
}

/// One photograph's copy.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Copy {
    /// Relative to the copies' directory.
    pub file: String,
    /// Size of the upright original, px.
    pub original: (usize, usize),
    /// Size of the copy, px.
    pub size: (usize, usize),
}

impl Copies {
    /// Small copies of all views, or full-size ones, under `dir`.
    pub fn write(
        dir: &Path,
        views: &[PoseView],
        small: bool,
        cancel: &CancelToken,
    ) -> Result<Self, PosesError> {
        let copies = views
            .iter()
            .enumerate()
            .map(|(index, view)| Copy::planned(index, view, small))
            .collect::<Result<Vec<_>, _>>()?;
        let share = |(copy, view): (&Copy, &PoseView)| {
            let longest = copy.original.0.max(copy.original.1) as f64;
            view.focal_px.map(|focal| focal / longest)
        };
        let lenses = lenses(&copies.iter().zip(views).map(share).collect::<Vec<_>>());
        let camera = |(copy, lens): (&Copy, &usize)| (copy.size, *lens);
        let cameras: BTreeSet<_> = copies.iter().zip(&lenses).map(camera).collect();
        let one_camera = cameras.len() == 1;
        // COLMAP shares a camera by folder where not all photographs can share one.
        let copies: Vec<Copy> = copies
            .into_iter()
            .zip(&lenses)
            .map(|(copy, lens)| match one_camera {
                true => copy,
                false => Copy {
                    file: format!("{}x{}-{lens}/{}", copy.size.0, copy.size.1, copy.file),
                    ..copy
                },
            })
            .collect();
        copies.par_iter().zip(views).try_for_each(|(copy, view)| {
            cancel.check()?;
            copy.write(dir, view)
        })?;
        Ok(Self {
            dir: dir.to_owned(),
            copies,
            one_camera,
            zooms: lenses.iter().filter(|&&lens| lens > 0).collect::<BTreeSet<_>>().len(),
        })
    }

    /// Whether full-size copies would be no different.
    pub fn are_full_size(&self) -> bool {
        self.copies.iter().all(|copy| copy.size == copy.original)
    }

    /// The focal length of the copies, px, where one camera took them and EXIF tells.
    pub fn focal(&self, views: &[PoseView]) -> Option<f64> {
        let scaled = |(copy, view): (&Copy, &PoseView)| {
            let share =
                copy.size.0.max(copy.size.1) as f64 / copy.original.0.max(copy.original.1) as f64;
            view.focal_px.filter(|f| f.is_finite() && *f > 0.0).map(|f| f * share)
        };
        let mut focals = self.copies.iter().zip(views).map(scaled).collect::<Option<Vec<_>>>()?;
        focals.sort_by(f64::total_cmp);
        let middle = focals.get(focals.len() / 2).copied();
        middle.filter(|_| self.one_camera)
    }
}

/// Which lens each photograph was taken with, by its focal length over the longer side: 1 is the
/// shortest, 0 where EXIF does not tell.
fn lenses(lengths: &[Option<f64>]) -> Vec<usize> {
    let known = |length: &Option<f64>| length.filter(|f| f.is_finite() && *f > 0.0);
    let mut sorted: Vec<f64> = lengths.iter().filter_map(known).collect();
    sorted.sort_by(f64::total_cmp);
    let mut shortest: Vec<f64> = Vec::new();
    for length in sorted {
        if shortest.last().is_none_or(|first| length > SAME_LENS * first) {
            shortest.push(length);
        }
    }
    let lens = |length: &Option<f64>| {
        known(length).map_or(0, |length| shortest.partition_point(|first| *first <= length))
    };
    lengths.iter().map(lens).collect()
}

impl Copy {
    fn planned(index: usize, view: &PoseView, small: bool) -> Result<Self, PosesError> {
        let header =
            read_header(&view.file).map_err(|e| PosesError::bad_file(&view.file, e.to_string()))?;
        let original = (header.width, header.height);
        let longest = original.0.max(original.1);
        let size = if small && longest > LARGEST_SMALL_SIDE {
            let scaled =
                |side: usize| (side as f64 * SMALL_SIDE as f64 / longest as f64).round().max(1.0);
            (scaled(original.0) as usize, scaled(original.1) as usize)
        } else {
            original
        };
        // Our own name: nothing of the user's reaches a command line or a list file.
        Ok(Self { file: format!("v{index:05}.png"), original, size })
    }

    fn write(&self, dir: &Path, view: &PoseView) -> Result<(), PosesError> {
        let unreadable =
            |e: &dyn std::fmt::Display| PosesError::bad_file(&view.file, e.to_string());
        let image = Image::load_at_most(&view.file, self.size.0.max(self.size.1))
            .map_err(|e| unreadable(&e))?;
        let path = dir.join(&self.file);
        let parent = path.parent().unwrap_or(dir);
        std::fs::create_dir_all(parent).map_err(PosesError::io(parent))?;
        brightened(&image).save(&path).map_err(|e| PosesError::bad_file(&path, e.to_string()))
    }
}

/// The photograph at the brightness COLMAP likes. A photograph that is bright already stays.
pub(crate) fn brightened(image: &Image<Srgb>) -> Image<Srgb> {
    let linear = image.to_linear();
    let mut levels: Vec<f32> = (0..linear.pixels())
        .map(|i| (0..3).map(|channel| linear.plane(channel)[i]).sum::<f32>() / 3.0)
        .collect();
    let middle = levels.len() / 2;
    let (_, median, _) = levels.select_nth_unstable_by(middle, f32::total_cmp);
    let gain = (srgb_to_linear(MEDIAN_LEVEL) / median.max(DARKEST_MEDIAN)).max(1.0);
    linear.map(|v| soft_clip(v * gain)).to_srgb()
}

/// The identity up to the knee, then an exponential approach to 1 of the same slope.
fn soft_clip(value: f32) -> f32 {
    if value <= KNEE {
        return value;
    }
    KNEE + (1.0 - KNEE) * (1.0 - (-(value - KNEE) / (1.0 - KNEE)).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dark_photograph_is_lifted_to_the_median_level_without_clipping() {
        let mut dark: Image<Srgb> = Image::new(64, 8);
        for y in 0..8 {
            for x in 0..64 {
                dark.set(x, y, [0.01 + 0.002 * x as f32; 3]);
            }
        }
        let bright = brightened(&dark);
        let mut levels = bright.plane(0).to_vec();
        levels.sort_by(f32::total_cmp);
        assert!((levels[levels.len() / 2] - MEDIAN_LEVEL).abs() < 0.01);
        assert!(levels.windows(2).all(|pair| pair[0] <= pair[1]) && levels[levels.len() - 1] < 1.0);
    }

    #[test]
    fn a_bright_photograph_is_left_as_bright_as_it_is() {
        let mut image: Image<Srgb> = Image::new(4, 4);
        image.data_mut().fill(0.6);
        let out = brightened(&image);
        assert!(out.data().iter().all(|v| (v - 0.6).abs() < 1e-4));
    }

    #[test]
    fn a_lens_is_known_by_its_focal_length() {
        assert_eq!(lenses(&[None, None]), [0, 0]);
        assert_eq!(lenses(&[Some(0.8), Some(0.82), Some(0.81)]), [1, 1, 1]);
        let zoomed = [Some(1.5), Some(0.8), None, Some(0.83), Some(f64::NAN)];
        assert_eq!(lenses(&zoomed), [2, 1, 0, 1, 0]);
    }

    #[test]
    fn black_photographs_do_not_divide_by_zero() {
        let out = brightened(&Image::new(4, 4));
        assert!(out.data().iter().all(|v| *v == 0.0));
    }
}
