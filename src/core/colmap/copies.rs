//! Pose copies: the dark originals, prepared for COLMAP.
//!
//! One gain per photograph in linear light, so that the median level is sRGB 0.4, and a soft clip
//! ([`brightened`]): compared with gamma, weaker gain, the original, CLAHE and denoising, this
//! registered most photographs. Area-averaging to about 560 px also denoises.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::exposure::brightened;
use super::files::empty;
use crate::cancel::CancelToken;
use crate::capture::on_few_threads;
use crate::mask::Mask;
use crate::poses::{PoseView, PosesError};

/// Longer copies are reduced to [`SMALL_SIDE`]: below 250-300 px there are too few features.
const LARGEST_SMALL_SIDE: usize = 640;

/// Long side of a small copy, px: the thresholds of the strategies were measured at it.
const SMALL_SIDE: usize = 560;

/// Focal lengths that differ by less are one lens at different focus distances.
const SAME_LENS: f64 = 1.05;

/// How copies differ from their originals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Brightened, and reduced to [`SMALL_SIDE`].
    Small,
    /// Brightened, at the prepared image's size.
    Full,
    /// Small, at the original brightness.
    Plain,
}

/// Where the copies are stored and how they relate to the originals.
#[derive(Clone, Debug)]
pub(super) struct Copies {
    pub dir: PathBuf,
    pub copies: Vec<Copy>,
    /// Whether one camera took them: all have one size and, if in EXIF, one focal length.
    pub one_camera: bool,
    /// The unmasked pixels of each copy with a mask.
    pub masks: Arc<[Option<Mask>]>,
    /// Number of focal lengths in EXIF, with those within 5 % counted as one.
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
    /// Copies of all views under `dir`.
    pub fn write(
        dir: &Path,
        views: &[PoseView],
        kind: Kind,
        cancel: &CancelToken,
    ) -> Result<Self, PosesError> {
        // COLMAP reads everything in a folder: no copy of an earlier search may be left.
        empty(dir)?;
        let copies: Vec<Copy> = views.iter().map(|view| Copy::planned(view, kind)).collect();
        let share = |(copy, view): (&Copy, &PoseView)| {
            let longest = copy.original.0.max(copy.original.1) as f64;
            view.focal_px.map(|focal| focal / longest)
        };
        let lenses = lenses(&copies.iter().zip(views).map(share).collect::<Vec<_>>());
        let camera = |(copy, lens): (&Copy, &usize)| (copy.size, *lens);
        let cameras: BTreeSet<_> = copies.iter().zip(&lenses).map(camera).collect();
        let one_camera = cameras.len() == 1;
        // COLMAP shares a camera per folder if not all photographs can share one.
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
        let written = copies.par_iter().zip(views).map(|(copy, view)| {
            cancel.check()?;
            copy.write(dir, view, kind)
        });
        let masks = on_few_threads(|| written.collect::<Result<Vec<Option<Mask>>, PosesError>>())?;
        let written = Self {
            dir: dir.to_owned(),
            copies,
            masks: masks.into(),
            one_camera,
            zooms: lenses.iter().filter(|&&lens| lens > 0).collect::<BTreeSet<_>>().len(),
        };
        written.write_masks()?;
        Ok(written)
    }

    /// The folder of the copies' masks, each named after its copy plus `.png`; `None` without any.
    pub fn mask_dir(&self) -> Option<PathBuf> {
        self.masks.iter().any(Option::is_some).then(|| self.dir.with_extension("masks"))
    }

    /// If one copy has a mask, all get one.
    fn write_masks(&self) -> Result<(), PosesError> {
        let Some(dir) = self.mask_dir() else {
            return Ok(());
        };
        empty(&dir)?;
        self.copies.par_iter().zip(&*self.masks).try_for_each(|(copy, mask)| {
            let path = dir.join(format!("{}.png", copy.file));
            let parent = path.parent().unwrap_or(&dir);
            std::fs::create_dir_all(parent).map_err(PosesError::io(parent))?;
            let picture = match mask {
                Some(mask) => mask.picture(),
                None => Mask::full(copy.size.0, copy.size.1).picture(),
            };
            picture.save(&path).map_err(|e| PosesError::bad_file(&path, e.to_string()))
        })
    }

    /// Whether a point of this copy, px, is masked.
    pub fn hides(&self, copy: usize, point: [f32; 2]) -> bool {
        self.masks[copy].as_ref().is_some_and(|mask| !mask.holds_at(point))
    }

    /// Whether full-size copies would be the same.
    pub fn are_full_size(&self) -> bool {
        self.copies.iter().all(|copy| copy.original.0.max(copy.original.1) <= LARGEST_SMALL_SIDE)
    }

    /// The focal length of the copies, px, if one camera took them and EXIF has it.
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

/// The lens of each photograph, from its focal length over the longer side: 1 is the shortest, 0 if
/// EXIF has none.
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
    fn planned(view: &PoseView, kind: Kind) -> Self {
        let original = view.original;
        let longest = original.0.max(original.1);
        let size = if kind != Kind::Full && longest > LARGEST_SMALL_SIDE {
            let scaled =
                |side: usize| (side as f64 * SMALL_SIDE as f64 / longest as f64).round().max(1.0);
            (scaled(original.0) as usize, scaled(original.1) as usize)
        } else {
            (view.prepared.width, view.prepared.height)
        };
        // The name of a view is safe in a list file: no text of the user gets there.
        Self { file: format!("{}.png", view.name), original, size }
    }

    /// Writes the copy; returns its mask.
    fn write(&self, dir: &Path, view: &PoseView, kind: Kind) -> Result<Option<Mask>, PosesError> {
        let unreadable = |e: &dyn std::fmt::Display| {
            PosesError::bad_file(Path::new(view.path.as_str()), e.to_string())
        };
        let image = view.prepared.load().map_err(|e| unreadable(&e))?;
        let image = image.resize_area(self.size.0, self.size.1).to_srgb();
        let path = dir.join(&self.file);
        let parent = path.parent().unwrap_or(dir);
        std::fs::create_dir_all(parent).map_err(PosesError::io(parent))?;
        let mask = view.mask.as_ref().map(|mask| mask.load_mask(self.size, Clone::clone));
        let mask = mask.transpose();
        let mask = mask.map_err(|e| unreadable(&e))?;
        let copy = if kind == Kind::Plain { image } else { brightened(&image, mask.as_ref()) };
        copy.save(&path).map_err(|e| PosesError::bad_file(&path, e.to_string()))?;
        Ok(mask)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::PreparedImage;
    use crate::image::{Image, Linear};
    use crate::photo_path::PhotoPath;

    #[test]
    fn a_copy_has_its_planned_size_although_the_prepared_image_was_rounded_too() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let image = Image::<Linear>::new(1_538, 2_048).map(|_| 0.1);
        let prepared = PreparedImage::write(&image, &folder.path().join("a.half"));
        let mask = PreparedImage::write(&image.map(|_| 1.0), &folder.path().join("mask.half"));
        let view = PoseView {
            name: "a".to_owned(),
            path: PhotoPath::new("a.png"),
            prepared: prepared.expect("written"),
            original: (3_472, 4_624),
            focal_px: None,
            mask: Some(mask.expect("written")),
        };
        let (dir, cancel) = (folder.path().join("copies"), CancelToken::new());
        let copies = Copies::write(&dir, &[view], Kind::Small, &cancel).expect("copies");
        let copy = &copies.copies[0];
        assert_eq!(copy.size, (420, 560));
        let written = Image::load(&dir.join(&copy.file)).expect("read");
        assert_eq!((written.width(), written.height()), copy.size);
    }

    #[test]
    fn a_lens_is_identified_by_its_focal_length() {
        assert_eq!(lenses(&[None, None]), [0, 0]);
        assert_eq!(lenses(&[Some(0.8), Some(0.82), Some(0.81)]), [1, 1, 1]);
        let zoomed = [Some(1.5), Some(0.8), None, Some(0.83), Some(f64::NAN)];
        assert_eq!(lenses(&zoomed), [2, 1, 0, 1, 0]);
    }
}
