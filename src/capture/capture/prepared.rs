//! Prepared images: what the pipeline reads in place of photographs.
//!
//! A photograph is decoded once, when its capture is opened, and kept as linear light at no more
//! than [`PREPARED_SIDE`] px. A file is two little-endian `u32` (width and height, px) and three
//! planes of half floats, one for a mask: nothing to compress in noise, no encoder to wait for, and
//! light below black or above white has a place. Half floats err by 2^-12 of a value, a tenth of a
//! level of 8 bits at most.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use half::f16;
use half::slice::HalfFloatSliceExt;
use serde::{Deserialize, Serialize};

use crate::image::{Image, ImageError, Linear, Srgb};
use crate::mask::Mask;

/// Longest side of prepared images, px, unless a run works on larger ones.
pub const PREPARED_SIDE: usize = 2_048;

/// Longest side that a prepared image may have, px.
const MAX_SIDE: usize = 65_535;

/// Bytes before the planes.
const HEADER: usize = 8;

/// A photograph, upright, in linear light of sRGB primaries; 1 is the file's white.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PreparedImage {
    /// Where the file is: the folder of the manifest, which may be moved.
    #[serde(skip)]
    folder: PathBuf,
    /// The file's name.
    file: String,
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Three, or one that stands for three.
    planes: usize,
}

impl PreparedImage {
    /// Writes an image to `path`, whose name is UTF-8.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn write(image: &Image<Linear>, path: &Path) -> io::Result<Self> {
        Self::write_planes(image, 3, path)
    }

    /// Writes the first plane of an image whose planes are equal.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub fn write_grey(image: &Image<Linear>, path: &Path) -> io::Result<Self> {
        Self::write_planes(image, 1, path)
    }

    fn write_planes(image: &Image<Linear>, planes: usize, path: &Path) -> io::Result<Self> {
        let pixels = image.width() * image.height();
        let mut bytes = Vec::with_capacity(HEADER + 2 * planes * pixels);
        for length in [image.width(), image.height()] {
            bytes.extend((length as u32).to_le_bytes());
        }
        let mut halves = vec![f16::ZERO; image.width()];
        for row in image.data()[..planes * pixels].chunks(image.width()) {
            halves.convert_from_f32_slice(row);
            bytes.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
        }
        fs::write(path, bytes)?;
        let folder = path.parent().unwrap_or(path).to_owned();
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { folder, file, width: image.width(), height: image.height(), planes })
    }

    /// Reads the image at its own size.
    ///
    /// # Errors
    /// [`ImageError::Io`]; [`ImageError::Damaged`] for a file of another size.
    pub fn load(&self) -> Result<Image<Linear>, ImageError> {
        let path = self.path();
        let io = |source| ImageError::Io { path: path.clone(), source };
        let bytes = fs::read(&path).map_err(io)?;
        let mut image = Image::new(self.width, self.height);
        let size = [self.width, self.height].map(|length| (length as u32).to_le_bytes()).concat();
        if bytes.len() as u64 != self.bytes() || !bytes.starts_with(&size) {
            let message = format!("{} is not a whole prepared image", path.display());
            return Err(ImageError::Damaged { message });
        }
        let mut halves = vec![f16::ZERO; self.width];
        let rows = bytes[HEADER..].chunks_exact(2 * self.width);
        for (row, bytes) in image.data_mut().chunks_exact_mut(self.width).zip(rows) {
            for (half, bytes) in halves.iter_mut().zip(bytes.chunks_exact(2)) {
                *half = f16::from_le_bytes([bytes[0], bytes[1]]);
            }
            halves.convert_to_f32_slice(row);
        }
        let (first, others) = image.data_mut().split_at_mut(self.width * self.height);
        if self.planes == 1 {
            others.chunks_exact_mut(first.len()).for_each(|plane| plane.copy_from_slice(first));
        }
        Ok(image)
    }

    /// Reads the image with its longest side brought down to `side` px, encoded as sRGB. Never
    /// enlarges.
    ///
    /// # Errors
    /// As [`PreparedImage::load`].
    pub fn load_at_most(&self, side: usize) -> Result<Image<Srgb>, ImageError> {
        let image = self.load()?;
        let (width, height) = image.size_at_most(side);
        Ok(if (width, height) == (self.width, self.height) {
            image.to_srgb()
        } else {
            image.resize_area(width, height).to_srgb()
        })
    }

    /// The pixels that count of a photograph of this size, if this is how much each of them counts.
    /// `undistort` moves them as it does the photograph's, at any size.
    ///
    /// # Errors
    /// As [`PreparedImage::load`].
    pub fn load_mask(
        &self,
        (width, height): (usize, usize),
        undistort: impl Fn(&Image<Linear>) -> Image<Linear>,
    ) -> Result<Mask, ImageError> {
        let shares = self.load()?.resize_area(width, height);
        Ok(Mask::of_shares(&undistort(&shares)))
    }

    /// Finds the image in this folder.
    pub(super) fn place_in(&mut self, folder: &Path) {
        self.folder = folder.to_owned();
    }

    /// Whether the file is there and has the size of the image.
    pub(super) fn is_whole(&self) -> bool {
        // A manifest may come from elsewhere.
        let is_name = !self.file.contains(['/', '\\']);
        let is_size = |side| (1..=MAX_SIDE).contains(&side);
        let is_plain = is_name && is_size(self.width) && is_size(self.height);
        is_plain
            && matches!(self.planes, 1 | 3)
            && self.path().metadata().is_ok_and(|metadata| metadata.len() == self.bytes())
    }

    /// Length of the file.
    fn bytes(&self) -> u64 {
        (HEADER + 2 * self.planes * self.width * self.height) as u64
    }

    /// Gives the file another name in its folder.
    ///
    /// # Errors
    /// Whatever the file system says.
    pub(super) fn rename(self, file: String) -> io::Result<Self> {
        fs::rename(self.path(), self.folder.join(&file))?;
        Ok(Self { file, ..self })
    }

    pub(super) fn remove(&self) {
        // A leftover file does no harm: the manifest does not name it.
        let _ = fs::remove_file(self.path());
    }

    fn path(&self) -> PathBuf {
        self.folder.join(&self.file)
    }
}
