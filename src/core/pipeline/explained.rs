//! Which views of a round have a kernel that explains their shake, and what each is trained on.

use super::config::{Options, ShakeModel, TrainOn};
use super::context::Context;
use super::round::Round;
use super::shaken::{self, Shaken};
use super::views::View;
use crate::camera::Split;
use crate::image::Image;
use crate::metrics::report::ViewScore;

/// Of every view, in their order, whether a kernel explains its shake in a round. `shaken`: what
/// was found before the rounds; `before`: what the renders of the round before tell.
pub fn explained(
    options: &Options,
    views: &[View],
    shaken: Option<&Shaken>,
    before: Option<&[ViewScore]>,
) -> Vec<bool> {
    let tells = |view: &View| match before {
        Some(before) => {
            let row = before.iter().find(|row| row.name == view.name);
            row.and_then(|row| row.is_shaken).unwrap_or(false)
        }
        None => shaken.is_some_and(|shaken| shaken.is_mostly_still() && shaken.tells(view)),
    };
    views
        .iter()
        .map(|view| options.shake.explains(tells(view)))
        .collect()
}

/// Of every view, in their order, whether a round trains on D in place of H. A view that has no
/// kernel is deblurred where the network took a shake out of it. Out of a still view it takes
/// texture: fox loses 1.2 dB by it (docs/results.md).
pub fn trained_deblurred(
    options: &Options,
    round: &Round,
    explained: &[bool],
    enhanced: &[Image],
    deblurred: &[Image],
) -> Vec<bool> {
    let is_earned = options.shake == ShakeModel::Late && options.train_on == TrainOn::Auto;
    let told = is_earned.then(|| shaken::told(enhanced, deblurred, &round.response));
    let of = |(index, &explained): (usize, &bool)| {
        let told = told.as_ref().is_none_or(|told| told[index]);
        !options.trains_on_enhanced(explained) && told
    };
    explained.iter().enumerate().map(of).collect()
}

/// Those of H and D that the views are trained on.
pub fn training_images(
    trained_deblurred: &[bool],
    enhanced: &[Image],
    deblurred: &[Image],
) -> Vec<Image> {
    let pairs = enhanced.iter().zip(deblurred).zip(trained_deblurred);
    pairs
        .map(|((enhanced, deblurred), &is_deblurred)| {
            if is_deblurred { deblurred } else { enhanced }.clone()
        })
        .collect()
}

/// Tells what the views of a round are trained on.
pub fn tell(
    context: &mut Context<'_>,
    round: u32,
    views: &[View],
    explained: &[bool],
    trained_deblurred: &[bool],
) {
    let count = |of: &[bool]| {
        let pairs = views.iter().zip(of);
        pairs
            .filter(|(view, of)| view.split == Split::Train && **of)
            .count()
    };
    let all = count(&vec![true; views.len()]);
    let (kernels, deblurred) = (count(explained), count(trained_deblurred));
    let enhanced = all - deblurred;
    let line = format!(
        "{all} views train: {enhanced} enhanced, {kernels} of them through a kernel of their \
         shake, and {deblurred} deblurred"
    );
    context.sink.log(format!("round {round}: {line}"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Intrinsics};
    use crate::enhance::Anchor;
    use crate::pipeline::config::LutScope;
    use crate::pipeline::tone::Tone;
    use crate::shake::reference::shaken_image;
    use crate::shake::{Response, ShakeKernel, Tap};
    use glam::DVec3;

    /// Discs of many sizes.
    fn sharp() -> Image {
        let mut image = Image::new(200, 160);
        for (x, y) in (0..200 * 160).map(|i| (i % 200, i / 200)) {
            let (u, v) = ((x % 23) as f64 - 11.0, (y % 19) as f64 - 9.0);
            let is_inside = u.hypot(v) < 3.0 + ((x / 23 + y / 19) % 4) as f64;
            let value = if is_inside { 0.8 } else { 0.2 };
            image.set(x, y, [value; 3]);
        }
        image
    }

    fn along_x(image: &Image) -> Image {
        let tap = |x| Tap {
            offset: [x, 0],
            weight: 1.0 / 9.0,
        };
        let kernel = ShakeKernel::new((-4..=4).map(tap).collect());
        shaken_image(image, &kernel, &Response::srgb())
    }

    fn view(name: &str) -> View {
        let intrinsics = Intrinsics {
            width: 200,
            height: 160,
            fx: 200.0,
            fy: 200.0,
            cx: 100.0,
            cy: 80.0,
        };
        View {
            name: name.to_owned(),
            camera: Camera::look_at(intrinsics, DVec3::NEG_Z, DVec3::ZERO, DVec3::Y),
            dark: sharp(),
            gt: None,
            split: Split::Train,
            is_late: false,
        }
    }

    #[test]
    fn a_kernel_is_for_the_few_that_are_told_shaken_then_for_those_that_renders_tell() {
        let options = Options::default();
        let views = ["a", "b", "c"].map(view);
        let told = |names: &[&str]| Shaken::of(names.iter().copied(), views.len());
        let first = |names: &[&str]| explained(&options, &views, Some(&told(names)), None);
        assert_eq!(first(&["b"]), [false, true, false]);
        assert_eq!(
            first(&["a", "b"]),
            [false; 3],
            "no sharp scene to find them in"
        );
        let score = |name: &str, is_shaken| ViewScore {
            name: name.to_owned(),
            registered: true,
            split: Some(Split::Train),
            reference: None,
            psnr_db: None,
            psnr_cc_db: None,
            ssim: None,
            shake_px: None,
            is_shaken: Some(is_shaken),
            fit: None,
        };
        let before = [score("c", true), score("a", false)];
        let later = explained(&options, &views, Some(&told(&["b"])), Some(&before));
        assert_eq!(later, [false, false, true]);
    }

    #[test]
    fn views_train_deblurred_where_the_network_took_a_shake_out_of_them() {
        let dark = sharp();
        let anchor = Anchor::exposure(0.0);
        let round = Round::new(1, anchor, Tone::fit(LutScope::Scene, &[&dark], &[anchor]));
        let (enhanced, deblurred) = ([along_x(&sharp()), sharp()], [sharp(), sharp()]);
        let of = |options: &Options, explained: [bool; 2]| {
            trained_deblurred(options, &round, &explained, &enhanced, &deblurred)
        };
        let auto = Options::default();
        assert_eq!(of(&auto, [false, false]), [true, false]);
        assert_eq!(of(&auto, [true, true]), [false, false]);
        let paper = Options {
            train_on: TrainOn::Deblurred,
            ..auto
        };
        assert_eq!(of(&paper, [false, true]), [true, true]);
    }
}
