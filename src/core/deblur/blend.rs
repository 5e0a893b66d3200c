//! A guide for networks without channels for one.

use crate::deblur::{DeblurError, DeblurInfo, Deblurrer, same_size};
use crate::image::Image;

/// Feeds a network the mean of view and guide, so that a network without guide channels profits
/// from the render all the same (method.md, 3: `guide = blend`).
pub struct Blend<D: Deblurrer + ?Sized> {
    inner: Box<D>,
}

impl<D: Deblurrer + ?Sized> Blend<D> {
    /// Wraps a network.
    pub fn new(inner: Box<D>) -> Self {
        Self { inner }
    }
}

impl<D: Deblurrer + ?Sized> Deblurrer for Blend<D> {
    fn deblur(&mut self, blurry: &Image, guide: Option<&Image>) -> Result<Image, DeblurError> {
        same_size(blurry, guide)?;
        let Some(guide) = guide else { return self.inner.deblur(blurry, None) };
        let mix = blurry.data().iter().zip(guide.data()).map(|(b, g)| 0.5 * (b + g)).collect();
        self.inner.deblur(&Image::from_planar(blurry.width(), blurry.height(), mix), None)
    }

    fn describe(&self) -> DeblurInfo {
        self.inner.describe()
    }

    fn take_warnings(&mut self) -> Vec<String> {
        self.inner.take_warnings()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deblur::Identity;

    #[test]
    fn half_of_the_view_and_half_of_the_guide_reach_the_network() {
        let mut blend = Blend::new(Box::new(Identity));
        let view = Image::from_planar(1, 1, vec![0.0, 0.2, 1.0]);
        let guide = Image::from_planar(1, 1, vec![1.0, 0.4, 0.0]);
        let mixed = blend.deblur(&view, Some(&guide)).expect("same size");
        for (got, want) in mixed.data().iter().zip([0.5, 0.3, 0.5]) {
            assert!((got - want).abs() < 1e-6, "{mixed:?}");
        }
        assert_eq!(blend.deblur(&view, None).expect("no guide"), view);
    }
}
