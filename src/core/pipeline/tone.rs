//! Tone curves for a set of views, in either scope.

use rayon::prelude::*;

use super::config::LutScope;
use crate::enhance::{self, Anchor, Histogram, ToneCurve};
use crate::image::Image;

/// Number of views that share one search for an anchor.
const SEARCHED_VIEWS: usize = 6;

/// One curve for all views, or one per view.
#[derive(Clone, Debug)]
pub struct Tone {
    curves: Vec<ToneCurve>,
    scene: ToneCurve,
}

impl Tone {
    /// The curves that bring `images` to `anchors`: one anchor for all, or one per image.
    pub fn fit(scope: LutScope, images: &[&Image], anchors: &[Anchor]) -> Self {
        let pooled = Histogram::pooled(images.iter().copied());
        let of_image = |(view, image): (usize, &&Image)| {
            let anchor = anchors[view.min(anchors.len() - 1)];
            ToneCurve::new(&Histogram::of(image), anchor)
        };
        let curves = match scope {
            LutScope::Scene => vec![ToneCurve::new(&pooled, anchors[0])],
            LutScope::Image => images.iter().enumerate().map(of_image).collect(),
        };
        let scene = ToneCurve::new(&pooled, Anchor::mean(anchors));
        Self { curves, scene }
    }

    /// The curve of a view.
    fn curve(&self, view: usize) -> &ToneCurve {
        &self.curves[view.min(self.curves.len() - 1)]
    }

    /// The one curve for the scene, whose colours belong to no view. In the scope of an image it is
    /// the curve of the pooled views at the mean of their anchors.
    pub fn scene(&self) -> &ToneCurve {
        &self.scene
    }

    /// Applies its curve to the image of a view.
    pub fn apply_to(&self, view: usize, image: &Image) -> Image {
        self.curve(view).apply(image)
    }

    /// Applies its curve to every image.
    pub fn apply<'a>(&self, images: impl IntoIterator<Item = &'a Image>) -> Vec<Image> {
        let images = images.into_iter().enumerate();
        images.map(|(view, image)| self.apply_to(view, image)).collect()
    }
}

/// The anchors for which E(R; P) is closest to `wanted`, of the same family as `like`: one search
/// over a few views, or one per view.
pub fn search(
    scope: LutScope,
    like: Anchor,
    seed: u64,
    images: &[&Image],
    wanted: &[Image],
) -> Vec<Anchor> {
    match scope {
        LutScope::Scene => {
            let few = enhance::spread_indices(images.len(), SEARCHED_VIEWS);
            let pairs: Vec<_> = few.into_iter().map(|i| (images[i], &wanted[i])).collect();
            let pooled = Histogram::pooled(images.iter().copied());
            vec![enhance::match_anchor(&pairs, &pooled, like, seed).anchor]
        }
        LutScope::Image => images
            .par_iter()
            .zip(wanted)
            .map(|(image, wanted)| {
                let histogram = Histogram::of(image);
                enhance::match_anchor(&[(image, wanted)], &histogram, like, seed).anchor
            })
            .collect(),
    }
}
