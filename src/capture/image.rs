//! Images as planar `f32`, with their transfer function in the type.
//!
//! Reading takes JPEG, PNG, WebP, TIFF, HEIC and raw files, turned upright ([`decode`]);
//! writing gives PNG and JPEG, whole or not at all ([`encode`]). Everything between stays `f32`.

mod colour;
mod decode;
mod encode;
mod exif;
pub(crate) mod hdr;
mod raw;
mod resize;
mod signature;
mod transfer;

use std::marker::PhantomData;

pub use ::image::metadata::Orientation;
#[cfg(test)]
pub(crate) use decode::DECODED;
pub(crate) use decode::shares;
pub use decode::{Header, ImageError, MAX_FILE_BYTES, MAX_PIXELS, read_header};
pub use encode::{EncodeFormat, write_atomic};
pub use exif::Shot;
#[cfg(test)]
pub(crate) use exif::tests::block as exif_block;
pub use hdr::HdrTransfer;
pub use raw::RawHeader;
#[cfg(test)]
pub(crate) use raw::dng;
pub use raw::libraw::version as libraw_version;
pub(crate) use resize::at_most;
pub use signature::Unread;
pub(crate) use signature::named_like_a_photograph;
pub use transfer::{linear_to_srgb, srgb_to_linear};

/// sRGB-encoded values, 0..=1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Srgb;

/// Linear light, 0..=1 before any gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Linear;

/// An RGB image, planar: `data[(channel * height + y) * width + x]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<E = Srgb> {
    width: usize,
    height: usize,
    data: Vec<f32>,
    encoding: PhantomData<E>,
}

impl<E> Image<E> {
    /// A black image.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![0.0; 3 * width * height], encoding: PhantomData }
    }

    /// From planar values, [3, height, width].
    ///
    /// # Panics
    /// When the length is not `3 * width * height`: a fault of the caller.
    pub fn from_planar(width: usize, height: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), 3 * width * height, "planar data of {width}x{height}");
        Self { width, height, data, encoding: PhantomData }
    }

    /// Width in px.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in px.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Pixels in a plane.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// All values, [3, height, width].
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// All values, mutable.
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// One channel, [height, width].
    pub fn plane(&self, channel: usize) -> &[f32] {
        let n = self.pixels();
        &self.data[channel * n..(channel + 1) * n]
    }

    /// One channel, mutable.
    pub fn plane_mut(&mut self, channel: usize) -> &mut [f32] {
        let n = self.pixels();
        &mut self.data[channel * n..(channel + 1) * n]
    }

    /// RGB at a pixel.
    pub fn get(&self, x: usize, y: usize) -> [f32; 3] {
        let (n, i) = (self.pixels(), y * self.width + x);
        [self.data[i], self.data[n + i], self.data[2 * n + i]]
    }

    /// Sets RGB at a pixel.
    pub fn set(&mut self, x: usize, y: usize, rgb: [f32; 3]) {
        let (n, i) = (self.pixels(), y * self.width + x);
        for (channel, value) in rgb.into_iter().enumerate() {
            self.data[channel * n + i] = value;
        }
    }

    /// Every value mapped.
    pub fn map(&self, f: impl Fn(f32) -> f32) -> Self {
        Self::from_planar(self.width, self.height, self.data.iter().map(|&v| f(v)).collect())
    }

    /// Rec. 709 luma of the values as they are encoded, [height, width].
    pub fn luma(&self) -> Vec<f32> {
        let (red, green, blue) = (self.plane(0), self.plane(1), self.plane(2));
        red.iter()
            .zip(green)
            .zip(blue)
            .map(|((r, g), b)| 0.2126 * r + 0.7152 * g + 0.0722 * b)
            .collect()
    }
}
