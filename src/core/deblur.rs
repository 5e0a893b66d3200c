//! Deblurring one view at a time, with or without a clean render as a guide.
//!
//! A [`Restorer`] is a network in ONNX Runtime, or [`Identity`] for none. Inputs and outputs are
//! sRGB-encoded images in 0..=1 of the same size.

mod choice;
mod error;
mod golden;
mod model;
mod onnx;
mod open;
mod tiling;

pub use choice::NetworkChoice;
pub use error::DeblurError;
pub use model::{BUILT_IN, Model, network_names};
pub use onnx::Onnx;
pub use open::{OpenOptions, Opened, open, open_enhancer};

use crate::image::Image;
use golden::Golden;

/// Restores images: removes blur and noise from a view, or brightens it.
pub trait Restorer: Send {
    /// The restored view, of the size of `blurry`, every value finite and in 0..=1.
    ///
    /// `guide` is the view with the detail of its clean render, or that render itself, of the same
    /// size and brightness.
    /// Without one, a guided network receives `blurry` twice; a network without channels for a
    /// guide ignores it.
    ///
    /// # Errors
    /// [`DeblurError::GuideSize`] when the sizes differ, [`DeblurError::Inference`] when running it
    /// fails.
    fn restore(&mut self, blurry: &Image, guide: Option<&Image>) -> Result<Image, DeblurError>;

    /// The facts for the report of the run.
    fn describe(&self) -> RestorerInfo;

    /// Returns the warnings about non-fatal problems since the last call, a sentence each.
    fn take_warnings(&mut self) -> Vec<String> {
        Vec::new()
    }
}

/// The facts of a restorer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RestorerInfo {
    /// [`BUILT_IN`], a file name, or `identity`.
    pub id: String,
    /// SHA-256 of the model file, lower-case hexadecimal; empty without a file.
    pub sha256: String,
    /// The execution provider in use: `cuda` or `cpu`, or `none` without a network.
    pub provider: String,
    /// Input channels: 6 takes a guide, 3 does not, 0 is no network.
    pub channels: u32,
    /// The preparation of its input, on which the output also depends. Empty without a network.
    pub feeding: String,
}

/// Returns its input, for a run without a network that only brightens the views.
#[derive(Clone, Copy, Debug, Default)]
pub struct Identity;

impl Restorer for Identity {
    fn restore(&mut self, blurry: &Image, guide: Option<&Image>) -> Result<Image, DeblurError> {
        same_size(blurry, guide)?;
        Ok(blurry.clone())
    }

    fn describe(&self) -> RestorerInfo {
        RestorerInfo {
            id: choice::IDENTITY.to_owned(),
            sha256: String::new(),
            provider: "none".to_owned(),
            channels: 0,
            feeding: String::new(),
        }
    }
}

fn same_size(blurry: &Image, guide: Option<&Image>) -> Result<(), DeblurError> {
    let size = |image: &Image| (image.width(), image.height());
    match guide {
        Some(guide) if size(guide) != size(blurry) => {
            Err(DeblurError::GuideSize { blurry: size(blurry), guide: size(guide) })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identity_returns_the_view_and_ignores_the_guide() {
        let view = Image::from_planar(2, 1, vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
        assert_eq!(Identity.restore(&view, None).expect("no guide"), view);
        assert_eq!(Identity.restore(&view, Some(&Image::new(2, 1))).expect("a guide"), view);
        assert_eq!(Identity.describe().channels, 0);
    }

    #[test]
    fn a_guide_of_another_size_is_refused() {
        let refused =
            Identity.restore(&Image::new(4, 2), Some(&Image::new(2, 4))).expect_err("sizes differ");
        assert!(
            matches!(refused, DeblurError::GuideSize { blurry: (4, 2), guide: (2, 4) }),
            "{refused}"
        );
    }
}
