//! Masks: the pixels of a picture that count.
//!
//! A mask is supplied with a capture, as a separate picture ([`MaskPicture`]) or as a photograph's
//! alpha, or with an evaluation. Masked pixels do not affect poses, training and scores.

use std::borrow::Cow;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::capture::CaptureView;
use crate::image::shares::{self, Shares};
use crate::image::{Image, ImageError, Linear, Orientation, read_header};

/// Smallest unmasked share of a pixel's area at which it counts: a resized pixel mixes the colours
/// of its area. All of it, up to rounding.
const LEAST_SHARE: f32 = 0.999;

/// A subset of a picture's pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    width: usize,
    height: usize,
    holds: Vec<bool>,
}

impl Mask {
    /// `holds` marks the picture's pixels row by row.
    ///
    /// # Panics
    /// When the length is not `width * height`: a fault of the caller.
    pub fn new(width: usize, height: usize, holds: Vec<bool>) -> Self {
        assert_eq!(holds.len(), width * height, "a mask of another size");
        Self { width, height, holds }
    }

    /// All pixels.
    pub fn full(width: usize, height: usize) -> Self {
        Self::new(width, height, vec![true; width * height])
    }

    /// The pixels that count in full, from each pixel's share.
    pub fn of_shares<E>(shares: &Image<E>) -> Self {
        let holds = shares.plane(0).iter().map(|share| *share >= LEAST_SHARE);
        Self::new(shares.width(), shares.height(), holds.collect())
    }

    /// The intersection of both masks.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        let both = self.holds.iter().zip(&other.holds).map(|(a, b)| *a && *b);
        Self::new(self.width, self.height, both.collect())
    }

    /// The other pixels.
    #[must_use]
    pub fn inverted(&self) -> Self {
        Self::new(self.width, self.height, self.holds.iter().map(|holds| !holds).collect())
    }

    /// At another size of the same aspect.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        Self::of_shares(&self.picture().resize_area(width, height))
    }

    /// `image`, with the pixels of `other` outside the mask.
    pub fn composite(&self, image: &Image, other: &Image) -> Image {
        let holds = self.holds.iter().cycle();
        let values = image.data().iter().zip(other.data()).zip(holds);
        let values =
            values.map(|((inside, outside), holds)| if *holds { *inside } else { *outside });
        Image::from_planar(self.width, self.height, values.collect())
    }

    /// As a picture: white for the mask's pixels, else black.
    pub fn picture(&self) -> Image {
        let plane = self.holds.iter().map(|&holds| f32::from(u8::from(holds)));
        let plane: Vec<f32> = plane.collect();
        Image::from_planar(self.width, self.height, plane.repeat(3))
    }

    /// Whether the mask includes the pixel at x and y.
    pub fn holds(&self, x: usize, y: usize) -> bool {
        self.holds[y * self.width + x]
    }

    /// Whether the mask includes the pixel around a point, px from the left and top edge; false
    /// outside.
    pub fn holds_at(&self, [x, y]: [f32; 2]) -> bool {
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside && self.holds(x as usize, y as usize)
    }

    /// Whether the mask includes each pixel, row by row.
    pub fn pixels(&self) -> &[bool] {
        &self.holds
    }

    /// Width and height, px.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Share of the picture's pixels.
    pub fn share(&self) -> f64 {
        self.count() as f64 / self.holds.len().max(1) as f64
    }

    /// The pixels of a picture within the mask, in one row.
    ///
    /// # Panics
    /// When the sizes differ: a fault of the caller.
    pub fn pixels_of<E>(&self, image: &Image<E>) -> Image<E> {
        assert_eq!(
            (image.width(), image.height()),
            (self.width, self.height),
            "picture and mask: sizes differ"
        );
        let of_plane = |plane: usize| {
            let values = image.plane(plane).iter().zip(&self.holds);
            values.filter(|(_, holds)| **holds).map(|(value, _)| *value)
        };
        let values = (0..3).flat_map(of_plane).collect();
        Image::from_planar(self.count(), 1, values)
    }

    fn count(&self) -> usize {
        self.holds.iter().filter(|holds| **holds).count()
    }
}

/// The pixels of a picture that count, in one row; the whole picture without a mask.
pub fn counted<'a, E: Clone>(image: &'a Image<E>, mask: Option<&Mask>) -> Cow<'a, Image<E>> {
    mask.map_or(Cow::Borrowed(image), |mask| Cow::Owned(mask.pixels_of(image)))
}

/// A picture that masks a photograph.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MaskPicture {
    /// The file.
    pub file: PathBuf,
    /// Whether white hides, as in instant-ngp; else black does, as in COLMAP and nerfstudio.
    pub white_hides: bool,
}

impl MaskPicture {
    /// The pixels that count of a photograph, at this size of its aspect. `undistort` moves them as
    /// it does the photograph's, at any size.
    ///
    /// # Errors
    /// [`ImageError`].
    pub fn load(
        &self,
        photograph: &CaptureView,
        (width, height): (usize, usize),
        undistort: impl Fn(&Image<Linear>) -> Image<Linear>,
    ) -> Result<Mask, ImageError> {
        let upright = (photograph.width, photograph.height);
        let orientation = Orientation::from_exif(photograph.orientation);
        let orientation = orientation.unwrap_or(Orientation::NoTransforms);
        let shares = self.shares(orientation, upright)?.at(width, height);
        Ok(Mask::of_shares(&undistort(&shares)))
    }

    /// The counted share of each of its pixels, rotated like the stored pixels of a photograph that
    /// is turned upright by `orientation`. A picture that fits only the `upright` photograph, width
    /// and height in px, is upright itself.
    ///
    /// # Errors
    /// [`ImageError`].
    pub(crate) fn shares(
        &self,
        orientation: Orientation,
        upright: (usize, usize),
    ) -> Result<Shares, ImageError> {
        let header = read_header(&self.file)?;
        // Ignore the mask's own EXIF, which tools may have copied from a photograph.
        let stored = match header.orientation.to_exif() {
            5..=8 => (header.height, header.width),
            _ => (header.width, header.height),
        };
        let turned = match orientation.to_exif() {
            5..=8 => (stored.1, stored.0),
            _ => stored,
        };
        let orientation = match (fits(turned, upright), fits(stored, upright)) {
            (true, _) => orientation,
            (false, true) => Orientation::NoTransforms,
            (false, false) => return Err(ImageError::OtherShape),
        };
        let shares = shares::of_picture(&self.file, orientation)?;
        Ok(if self.white_hides { shares.inverted() } else { shares })
    }
}

/// Whether two sizes have the same proportions, within 1 %.
fn fits(one: (usize, usize), other: (usize, usize)) -> bool {
    let ratio = (one.0 * other.1) as f64 / (one.1 * other.0).max(1) as f64;
    (ratio - 1.0).abs() < 0.01
}
