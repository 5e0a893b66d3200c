//! Tone curves for a set of views, in either scope.

use super::config::LutScope;
use crate::enhance::{Anchor, Histogram, ToneCurve};
use crate::image::Image;

/// One curve for all views, or one a view.
#[derive(Clone, Debug)]
pub struct Tone {
    curves: Vec<ToneCurve>,
    scene: ToneCurve,
}

impl Tone {
    /// The curves that bring `images` to `anchors`: one anchor for all, or one an image.
    pub fn fit(scope: LutScope, images: &[Image], anchors: &[Anchor]) -> Self {
        let anchor = |view: usize| anchors[view.min(anchors.len() - 1)];
        let curves = match scope {
            LutScope::Scene => vec![ToneCurve::new(&Histogram::pooled(images), anchor(0))],
            LutScope::Image => images
                .iter()
                .enumerate()
                .map(|(view, image)| ToneCurve::new(&Histogram::of(image), anchor(view)))
                .collect(),
        };
        let mean =
            |of: fn(&Anchor) -> f64| anchors.iter().map(of).sum::<f64>() / anchors.len() as f64;
        let middle = Anchor {
            alpha: mean(|a| a.alpha),
            gamma: mean(|a| a.gamma),
        };
        Self {
            curves,
            scene: ToneCurve::new(&Histogram::pooled(images), middle),
        }
    }

    /// The curve of a view.
    fn curve(&self, view: usize) -> &ToneCurve {
        &self.curves[view.min(self.curves.len() - 1)]
    }

    /// The one curve for what no view owns: the colours of the scene. In the scope of an image it
    /// is the curve of the pooled views at the mean of their anchors.
    pub fn scene(&self) -> &ToneCurve {
        &self.scene
    }

    /// Every image through its curve.
    pub fn apply(&self, images: &[Image]) -> Vec<Image> {
        images
            .iter()
            .enumerate()
            .map(|(view, image)| self.curve(view).apply(image))
            .collect()
    }
}
