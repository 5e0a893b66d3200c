//! The score by which rounds are compared.

use std::borrow::Cow;

use crate::camera::Split;
use crate::image::Image;
use crate::mask::{Mask, counted};
use crate::metrics;
use crate::pipeline::views::View;
use crate::shake::{self, Response, shaken_image};

/// How well a render explains its view, both at the target brightness.
#[derive(Clone, Copy, Debug)]
pub struct Likeness {
    /// Root mean square distance by which the view's shake moves light, px.
    pub shake_px: f64,
    /// Whether the shake differs significantly from none.
    pub is_shaken: bool,
    /// Colour-fitted PSNR of the render, shaken as its view is, against the view, dB. A curve
    /// matches the round's brightness to the target's; the colour fit removes the error of that
    /// curve, which is no fault of the scene.
    pub psnr_cc_db: f64,
    /// Correlation of the two; low where the view's pose is wrong.
    pub fit: f64,
}

impl Likeness {
    /// That of a render and its view. The render is first shaken as its view is, or the sharper of
    /// two scenes would look like the worse one. This also applies to a scene trained without
    /// kernels, whose views are no less shaken.
    pub fn of(render: &Image, view: &Image, mask: Option<&Mask>, response: &Response) -> Self {
        let kernel = shake::estimate(render, view, response, mask);
        let shaken = shaken_image(render, &kernel, response);
        let [kept, reference] = [&shaken, view].map(|image| counted(image, mask));
        // Structures that are the same add no difference.
        let filled =
            mask.map_or(Cow::Borrowed(view), |mask| Cow::Owned(mask.composite(view, &shaken)));
        Self {
            shake_px: kernel.spread(),
            is_shaken: kernel.significance(view.width().max(view.height())) >= 1.0,
            psnr_cc_db: metrics::psnr_colour_corrected(&kept, &reference),
            fit: metrics::correlation(&shaken, &filled),
        }
    }
}

/// Mean colour-fitted PSNR of the likenesses, dB, over the held-out views if there are any, and
/// without late views, so that a round does not lose by having more views. The noise of the views
/// adds the same amount to every round's squared error, so only the scene makes a difference; in
/// SSIM the noise drowns it. Ground truth is never used: a capture with it must deliver the same
/// scene as one without.
pub fn score(views: &[View], likenesses: &[Likeness]) -> f64 {
    let of = |split: Split| -> Vec<f64> {
        let pairs = views.iter().zip(likenesses);
        pairs
            .filter(|(view, _)| view.split == split && !view.is_late)
            .map(|(_, likeness)| likeness.psnr_cc_db)
            .collect()
    };
    let held_out = of(Split::HeldOut);
    let compared = if held_out.is_empty() { of(Split::Train) } else { held_out };
    compared.iter().sum::<f64>() / compared.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Intrinsics};
    use crate::photo_path::PhotoPath;
    use crate::shake::{ShakeKernel, Tap};
    use glam::DVec3;

    const SIDE: usize = 64;

    /// Discs of many sizes.
    fn sharp() -> Image {
        let mut image = Image::new(SIDE, SIDE);
        for (x, y) in (0..SIDE * SIDE).map(|i| (i % SIDE, i / SIDE)) {
            let (u, v) = ((x % 13) as f64 - 6.0, (y % 11) as f64 - 5.0);
            let inside = u.hypot(v) < 2.0 + ((x / 13 + y / 11) % 3) as f64;
            image.set(x, y, if inside { [0.8, 0.6, 0.3] } else { [0.2, 0.25, 0.4] });
        }
        image
    }

    fn along(length: i32) -> ShakeKernel {
        let weight = 1.0 / (2 * length + 1) as f32;
        ShakeKernel::new((-length..=length).map(|x| Tap::even([x, 0], weight)).collect())
    }

    fn blurred(image: &Image, length: i32) -> Image {
        shaken_image(image, &along(length), &Response::srgb())
    }

    #[test]
    fn the_sharper_scene_wins_because_its_render_is_shaken_first() {
        let side = SIDE as f64;
        let intrinsics = Intrinsics {
            width: SIDE,
            height: SIDE,
            fx: side,
            fy: side,
            cx: side / 2.0,
            cy: side / 2.0,
        };
        let camera = Camera::look_at(intrinsics, DVec3::NEG_Z, DVec3::ZERO, DVec3::Y);
        let view = View {
            name: "a".to_owned(),
            path: PhotoPath::default(),
            camera,
            dark: sharp(),
            gt: None,
            mask: None,
            split: Split::HeldOut,
            is_late: false,
        };
        let target = blurred(&sharp(), 1);
        let of = |render: &Image| {
            let likeness = Likeness::of(render, &target, None, &Response::srgb());
            score(std::slice::from_ref(&view), &[likeness])
        };
        let (sharp, soft) = (sharp(), blurred(&sharp(), 2));
        assert!(of(&sharp) > of(&soft) + 1.0);
    }
}
