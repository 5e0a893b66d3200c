//! The images on which the views of a round train.

use rayon::prelude::*;

use super::config::{LossModel, Options, ShakeModel, TrainOn};
use super::context::Context;
use super::round::Round;
use super::shaken;
use super::views::{View, masks};
use crate::camera::Split;
use crate::deblur::NetworkChoice;
use crate::image::Image;
use crate::noise_levels::NoiseLevels;
use crate::shake::{Response, denoised};

/// The image on which a view trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrainedOn {
    /// H.
    Enhanced,
    /// H with less of its noise and all of its shake, for a kernel.
    Denoised,
    /// D.
    Deblurred,
    /// Their mean: half the noise of H, and half of what deblurring invents in D.
    Mean,
}

/// The image on which a round trains each view, in order. A view with a kernel trains denoised: a
/// scene sharpens noise through its kernel. A view without one trains as deblurred where the
/// network removed a shake; else on the mean of both (docs/decisions/shake.md).
pub fn trained_on(
    options: &Options,
    round: &Round,
    views: &[View],
    with_kernel: &[bool],
    [enhanced, deblurred]: [&[Image]; 2],
) -> Vec<TrainedOn> {
    let is_earned = options.shake == ShakeModel::Late && options.train_on == TrainOn::Auto;
    let lost =
        is_earned.then(|| shaken::lost_shake(enhanced, deblurred, &masks(views), &round.response));
    let is_denoised = is_earned && options.deblur != NetworkChoice::Identity;
    let of = |(index, &has_kernel): (usize, &bool)| {
        if options.trains_on_enhanced(has_kernel) {
            if is_denoised { TrainedOn::Denoised } else { TrainedOn::Enhanced }
        } else if lost.as_ref().is_none_or(|lost| lost[index]) {
            TrainedOn::Deblurred
        } else {
            TrainedOn::Mean
        }
    };
    with_kernel.iter().enumerate().map(of).collect()
}

/// An image on which a view trains.
#[derive(Clone, Debug)]
pub struct TrainingImage {
    pub image: Image,
    /// Its noise; `None` where it is not known or the loss does not ask for it.
    pub noise: Option<NoiseLevels>,
}

/// The training images of the views, encoded by the round's `response`.
pub fn training_images(
    options: &Options,
    trained_on: &[TrainedOn],
    [enhanced, deblurred]: [&[Image]; 2],
    response: &Response,
) -> Vec<TrainingImage> {
    let is_known =
        options.loss == LossModel::NoiseAware && options.deblur != NetworkChoice::Identity;
    let of = |((enhanced, deblurred), on): ((&Image, &Image), &TrainedOn)| {
        let against_clean = |image: Image| {
            let noise = is_known.then(|| NoiseLevels::between(&image, deblurred));
            (image, noise)
        };
        let (image, noise) = match on {
            TrainedOn::Enhanced => against_clean(enhanced.clone()),
            TrainedOn::Denoised => {
                let (image, noise) = denoised(enhanced, deblurred, response);
                (image, is_known.then_some(noise))
            }
            // The faults that a network leaves are no noise.
            TrainedOn::Deblurred => (deblurred.clone(), None),
            TrainedOn::Mean => against_clean(mean(enhanced, deblurred)),
        };
        TrainingImage { image, noise }
    };
    enhanced.par_iter().zip(deblurred).zip(trained_on).map(of).collect()
}

fn mean(one: &Image, other: &Image) -> Image {
    let mut mean = one.clone();
    for (value, other) in mean.data_mut().iter_mut().zip(other.data()) {
        *value = 0.5 * (*value + other);
    }
    mean
}

/// Reports on which images the views train.
pub fn report(
    context: &mut Context<'_>,
    round: u32,
    views: &[View],
    with_kernel: &[bool],
    trained_on: &[TrainedOn],
) {
    let trained = |index: &usize| views[*index].split == Split::Train;
    let trained: Vec<usize> = (0..views.len()).filter(trained).collect();
    let on = |kind| trained.iter().filter(|&&i| trained_on[i] == kind).count();
    let line = format!(
        "{} views train, {} of them through a kernel of their shake: {} enhanced, {} denoised, {} \
         deblurred, and {} as the mean of enhanced and deblurred",
        trained.len(),
        trained.iter().filter(|&&i| with_kernel[i]).count(),
        on(TrainedOn::Enhanced),
        on(TrainedOn::Denoised),
        on(TrainedOn::Deblurred),
        on(TrainedOn::Mean),
    );
    context.sink.log(format!("round {round}: {line}"));
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::camera::{Camera, Intrinsics};
    use crate::enhance::Anchor;
    use crate::photo_path::PhotoPath;
    use crate::pipeline::config::LutScope;
    use crate::pipeline::tone::Tone;
    use crate::shake::shaken_image;
    use crate::shake::{ShakeKernel, Tap};
    use glam::DVec3;
    use rand::{RngExt, SeedableRng};

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
        let tap = |x| Tap::even([x, 0], 1.0 / 9.0);
        let kernel = ShakeKernel::new((-4..=4).map(tap).collect());
        shaken_image(image, &kernel, &Response::srgb())
    }

    pub(in crate::pipeline) fn view(name: &str) -> View {
        let intrinsics =
            Intrinsics { width: 200, height: 160, fx: 200.0, fy: 200.0, cx: 100.0, cy: 80.0 };
        View {
            name: name.to_owned(),
            path: PhotoPath::default(),
            camera: Camera::look_at(intrinsics, DVec3::NEG_Z, DVec3::ZERO, DVec3::Y),
            dark: sharp(),
            gt: None,
            mask: None,
            split: Split::Train,
            is_late: false,
        }
    }

    #[test]
    fn views_train_deblurred_where_shake_was_removed_else_as_mean() {
        use TrainedOn::{Deblurred, Denoised, Enhanced, Mean};
        let dark = sharp();
        let anchor = Anchor::exposure(0.0);
        let round = Round::new(1, anchor, Tone::fit(LutScope::Scene, &[&dark], &[anchor]));
        let (enhanced, deblurred) = ([along_x(&sharp()), sharp()], [sharp(), sharp()]);
        let views = [view("a"), view("b")];
        let of = |options: &Options, with_kernel: [bool; 2]| {
            trained_on(options, &round, &views, &with_kernel, [&enhanced, &deblurred])
        };
        let auto = Options::default();
        assert_eq!(of(&auto, [false, false]), [Deblurred, Mean]);
        assert_eq!(of(&auto, [true, true]), [Denoised, Denoised]);
        let network_less = Options { deblur: NetworkChoice::Identity, ..auto.clone() };
        assert_eq!(of(&network_less, [true, true]), [Enhanced, Enhanced]);
        let paper = Options { train_on: TrainOn::Deblurred, ..auto };
        assert_eq!(of(&paper, [false, true]), [Deblurred, Deblurred]);
    }

    #[test]
    fn training_images_are_enhanced_deblurred_or_between() {
        let [dark, bright] = [0.2, 0.6].map(|value| [sharp().map(|_| value)]);
        let options = Options::default();
        let of = |on| training_images(&options, &[on], [&dark, &bright], &Response::srgb());
        let value = |on| of(on)[0].image.data()[7];
        assert_eq!(value(TrainedOn::Enhanced), 0.2);
        assert_eq!(value(TrainedOn::Deblurred), 0.6);
        assert!((value(TrainedOn::Mean) - 0.4).abs() < 1e-6);
    }

    #[test]
    fn the_noise_of_a_mean_is_half_of_that_of_the_photograph() {
        let clean = sharp();
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let mut photograph = clean.clone();
        for value in photograph.data_mut() {
            *value += 0.1 * ((0..12).map(|_| random.random::<f32>()).sum::<f32>() - 6.0);
        }
        let photographs = [photograph];
        let deblurred = [clean];
        let of = |options: &Options, on| {
            let both: [&[Image]; 2] = [&photographs, &deblurred];
            training_images(options, &[on], both, &Response::srgb())[0].noise
        };
        let usual = Options::default();
        let found = of(&usual, TrainedOn::Mean).expect("measured").at(0.2);
        assert!((found - 0.05).abs() < 0.003, "{found}");
        let left = of(&usual, TrainedOn::Denoised).expect("measured").at(0.2);
        assert!(left > 0.0 && left < 0.02, "{left}");
        assert_eq!(of(&usual, TrainedOn::Deblurred), None);
        let plain = Options { loss: LossModel::Plain, ..Options::default() };
        let network_less = Options { deblur: NetworkChoice::Identity, ..Options::default() };
        assert_eq!(
            [&plain, &network_less].map(|options| of(options, TrainedOn::Mean)),
            [None, None]
        );
    }
}
