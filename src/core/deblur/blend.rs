//! A guide for networks without channels for one.

use crate::deblur::{DeblurError, Restorer, RestorerInfo, same_size};
use crate::image::Image;

/// Feeds a network the guide in its view's place, so that a network without guide channels profits
/// from the render all the same. Not the mean of view and render: a guide is a
/// mix of the two already.
pub struct Blend<D: Restorer + ?Sized> {
    inner: Box<D>,
}

impl<D: Restorer + ?Sized> Blend<D> {
    /// Wraps a network.
    pub fn new(inner: Box<D>) -> Self {
        Self { inner }
    }
}

impl<D: Restorer + ?Sized> Restorer for Blend<D> {
    fn restore(&mut self, blurry: &Image, guide: Option<&Image>) -> Result<Image, DeblurError> {
        same_size(blurry, guide)?;
        let Some(guide) = guide else {
            return self.inner.restore(blurry, None);
        };
        self.inner.restore(guide, None)
    }

    fn describe(&self) -> RestorerInfo {
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
    fn the_guide_reaches_the_network_in_the_views_place() {
        let mut blend = Blend::new(Box::new(Identity));
        let view = Image::from_planar(1, 1, vec![0.0, 0.2, 1.0]);
        let guide = Image::from_planar(1, 1, vec![1.0, 0.4, 0.0]);
        assert_eq!(
            blend.restore(&view, Some(&guide)).expect("same size"),
            guide
        );
        assert_eq!(blend.restore(&view, None).expect("no guide"), view);
    }
}
