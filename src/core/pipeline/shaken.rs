//! Decides before training whether a capture is shaken.
//!
//! A deblurring network removes the shake of a shaken view, and only noise from a still one: the
//! kernel from its result back to the view is a path in one case and a dot in the other. Measured
//! in docs/decisions/shake.md.

use std::collections::BTreeSet;

use rayon::prelude::*;

use super::config::{Options, ShakeModel, TrainOn};
use super::context::Context;
use super::dependencies::RunDependencies;
use super::enhance::Brightening;
use super::error::PipelineError;
use super::restore::Restoration;
use super::tools::Tools;
use super::views::{View, longest_side};
use crate::cancel::CancelToken;
use crate::deblur::{NetworkChoice, Restorer};
use crate::event::Stage;
use crate::image::Image;
use crate::mask::Mask;
use crate::metrics::CaptureShake;
use crate::run_folder::KeptImages;
use crate::shake::{self, Response};

/// The median significance from which a capture is shaken: most views have some shake, and more of
/// them than the network can tell from noise are shown to be shaken by the first round's renders.
const SOFT_FROM: f64 = 0.57;
/// The share of significantly shaken views from which it is, whatever the others are.
const SHAKEN_SHARE: f64 = 0.25;
/// Longest side of the images by which the verdict is found, px. What the network and the kernels
/// tell apart was measured at this size: of a shake of 12 px, which is 4.4 px here, the network
/// removes little in images of 1,600 px, and the capture would count as still.
pub const VERDICT_SIDE: u32 = 560;
/// Longest side of the working images of a capture that is shaken, but not strongly, px. Its shake
/// is at most 3 px at [`VERDICT_SIDE`] and so 4.4 px here, the longest that kernels and networks
/// were measured with.
const SHAKEN_SIDE: u32 = 820;
/// Longest side of the working images of a strongly shaken capture, px. Shake leaves no detail for
/// larger images, but each of their pixels is as noisy: scenes of 560 px are worse at any size
/// (docs/decisions/shake.md).
const STRONG_SIDE: u32 = 420;
/// The median significance in images of [`STRONG_SIDE`] from which a shake is strong.
const STRONG_FROM: f64 = 1.25;
/// Most views that tell whether a shake is strong.
const MAX_ASKED: usize = 12;

/// For each view, the significance of the kernel from its deblurred image back to it.
fn significances(
    enhanced: &[Image],
    deblurred: &[Image],
    masks: &[Option<&Mask>],
    response: &Response,
) -> Vec<f64> {
    let of = |((view, sharper), mask): ((&Image, &Image), &Option<&Mask>)| {
        let kernel = shake::estimate(sharper, view, response, *mask);
        kernel.significance(view.width().max(view.height()))
    };
    enhanced.par_iter().zip(deblurred).zip(masks).map(of).collect()
}

/// For each view, whether deblurring removed a significant shake.
pub fn lost_shake(
    enhanced: &[Image],
    deblurred: &[Image],
    masks: &[Option<&Mask>],
    response: &Response,
) -> Vec<bool> {
    let of_views = significances(enhanced, deblurred, masks, response);
    of_views.into_iter().map(|significance| significance >= 1.0).collect()
}

/// Whether the options require a verdict before the rounds: only where both the kernels and the
/// network depend on it.
pub fn is_needed(options: &Options) -> bool {
    options.shake == ShakeModel::Late
        && options.train_on == TrainOn::Auto
        && options.deblur != NetworkChoice::Identity
}

/// The views found shaken, of those with a pose.
#[derive(Clone, Debug)]
pub struct Shaken {
    names: BTreeSet<String>,
    verdict: CaptureShake,
    is_strong: bool,
    /// Longest side of all views, px; below the option for small photographs.
    longest: u32,
}

impl Shaken {
    /// `views` are names and the significance of their shake.
    pub fn of<'a>(views: impl Iterator<Item = (&'a str, f64)>) -> Self {
        let views: Vec<_> = views.collect();
        let shaken = views.iter().filter(|(_, ratio)| *ratio >= 1.0);
        let names: BTreeSet<_> = shaken.map(|(name, _)| (*name).to_owned()).collect();
        let middle = middle(views.iter().map(|(_, ratio)| *ratio).collect());
        let is_shaken =
            names.len() as f64 >= SHAKEN_SHARE * views.len() as f64 || middle >= SOFT_FROM;
        let verdict = if is_shaken { CaptureShake::Shaken } else { CaptureShake::Still };
        Self { names, verdict, is_strong: false, longest: u32::MAX }
    }

    /// Names of the shaken views.
    pub fn names(&self) -> BTreeSet<String> {
        self.names.clone()
    }

    pub fn count(&self) -> u32 {
        self.names.len() as u32
    }

    pub fn verdict(&self) -> CaptureShake {
        self.verdict
    }

    /// Longest side of the working images before the verdict, px.
    pub fn size_before(&self, options: &Options) -> u32 {
        options.longest_side().min(self.longest)
    }

    /// Longest side of the working images, px.
    pub fn size(&self, options: &Options) -> u32 {
        let most = match self.verdict {
            _ if !options.size.is_open() => u32::MAX,
            CaptureShake::Still => u32::MAX,
            CaptureShake::Shaken if self.is_strong => STRONG_SIDE,
            CaptureShake::Shaken => SHAKEN_SIDE,
        };
        self.size_before(options).min(most)
    }
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Runs the stage before the rounds: finds the shaken views at the target brightness. `None` if the
/// options leave nothing to decide.
///
/// # Errors
/// [`PipelineError::Deblur`], [`PipelineError::Io`], [`PipelineError::Cancelled`].
pub fn shaken(
    context: &mut Context<'_>,
    tools: &mut Tools<'_>,
    options: &Options,
    views: &[View],
    brightening: &Brightening,
    depends_on: &RunDependencies,
) -> Result<Option<Shaken>, PipelineError> {
    if !is_needed(options) {
        return Ok(None);
    }
    let small: Vec<Image>;
    let images: &[Image] = if longest_side(views) > VERDICT_SIDE {
        small = brightening.target.par_iter().map(reduced).collect();
        &small
    } else {
        &brightening.target
    };
    let restoration = Restoration {
        stage: Stage::Deblur,
        round: 0,
        kept: KeptImages::Deblurred,
        views,
        images,
        guides: None,
    };
    let on = depends_on.round(0, None).deblur;
    let deblurred = restoration.by(tools.deblurrer, context, &on)?;
    let response = &brightening.last().response;
    let sizes = images.iter().map(|image| (image.width(), image.height()));
    let masks: Vec<Option<Mask>> = { views.iter().zip(sizes) }
        .map(|(view, (width, height))| Some(view.mask.as_ref()?.resized(width, height)))
        .collect();
    let masks: Vec<_> = masks.iter().map(Option::as_ref).collect();
    let ratios = significances(images, &deblurred, &masks, response);
    let mut shaken = Shaken::of(views.iter().map(|view| &view.name[..]).zip(ratios));
    shaken.longest = longest_side(views);
    if shaken.verdict == CaptureShake::Shaken && shaken.longest > STRONG_SIDE {
        let network = &mut *tools.deblurrer;
        shaken.is_strong = is_strong(network, &brightening.target, response, context.cancel)?;
        for warning in network.take_warnings() {
            context.sink.warn(Stage::Deblur.name(), warning);
        }
    }
    let found = format!("{} of {} views are shaken", shaken.count(), views.len());
    let consequence = match shaken.verdict() {
        CaptureShake::Still => "plain splatting, cameras as found".to_owned(),
        CaptureShake::Shaken => format!(
            "from the second round on, blur kernels model the shake of views whose renders show \
             one, in images of {} px",
            shaken.size(options)
        ),
    };
    context.sink.log(format!("{found}: {consequence}"));
    Ok(Some(shaken))
}

/// The image by which a view is judged.
fn reduced(image: &Image) -> Image {
    let (width, height) = image.size_at_most(VERDICT_SIDE as usize);
    image.resize_area(width, height)
}

/// Whether the shake of a shaken capture is strong, by smaller images: there it stands out of the
/// noise.
fn is_strong(
    network: &mut dyn Restorer,
    views: &[Image],
    response: &Response,
    cancel: &CancelToken,
) -> Result<bool, PipelineError> {
    let mut enhanced = Vec::with_capacity(MAX_ASKED);
    let mut deblurred = Vec::with_capacity(MAX_ASKED);
    for view in views.iter().step_by(views.len().div_ceil(MAX_ASKED)) {
        cancel.check()?;
        let (width, height) = view.size_at_most(STRONG_SIDE as usize);
        let small = view.resize_area(width, height);
        deblurred.push(network.restore(&small, None)?);
        enhanced.push(small);
    }
    let masks = vec![None; enhanced.len()];
    let significances = significances(&enhanced, &deblurred, &masks, response);
    Ok(middle(significances) >= STRONG_FROM)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deblur::{DeblurError, RestorerInfo};
    use crate::pipeline::config::Setting;
    use crate::shake::shaken_image;
    use crate::shake::{ShakeKernel, Tap};

    /// Knows the sharp image.
    struct Perfect(Image);

    impl Restorer for Perfect {
        fn restore(&mut self, blurry: &Image, _: Option<&Image>) -> Result<Image, DeblurError> {
            Ok(self.0.resize_area(blurry.width(), blurry.height()))
        }

        fn describe(&self) -> RestorerInfo {
            unreachable!("nothing is reported")
        }
    }

    /// Views with these ratios.
    fn of(ratios: &[f64]) -> Shaken {
        let names = ["a", "b", "c", "d", "e", "f"];
        Shaken::of(names.into_iter().zip(ratios.iter().copied()))
    }

    #[test]
    fn a_quarter_of_shaken_views_or_a_soft_median_make_a_capture_shaken() {
        assert_eq!(of(&[1.0, 1.2, 0.1]).verdict(), CaptureShake::Shaken);
        assert_eq!(of(&[0.1, 0.1, 0.1, 1.2]).verdict(), CaptureShake::Shaken);
        assert_eq!(of(&[0.7, 0.6, 0.5]).verdict(), CaptureShake::Shaken);
        assert_eq!(of(&[0.5, 0.4, 0.3, 0.2, 1.5]).verdict(), CaptureShake::Still);
        assert_eq!(of(&[0.5, 0.4, 0.3, 0.2, 1.5]).count(), 1);
    }

    #[test]
    fn only_a_size_left_open_shrinks_with_shake() {
        let sizes = |is_strong| {
            let shaken = Shaken { is_strong, ..of(&[1.5]) };
            [Setting::Given(280), Setting::Auto, Setting::Fitted(900), Setting::Given(1120)]
                .map(|size| shaken.size(&Options { size, ..Options::default() }))
        };
        assert_eq!(sizes(false), [280, 560, 820, 1120]);
        assert_eq!(sizes(true), [280, 420, 420, 1120]);
        let small = Shaken { longest: 400, is_strong: true, ..of(&[1.5]) };
        assert_eq!(small.size(&Options::default()), 400, "its images stay as they are");
    }

    #[test]
    fn a_shake_is_strong_by_its_length_in_smaller_images() {
        let (width, height) = (560, 420);
        let value = |at: usize| {
            let (x, y) = (at % width, at / width % height);
            ((x / 9 * 31 + y / 7 * 17 + at / (width * height) * 5) % 11) as f32 / 11.0
        };
        let planes = (0..3 * width * height).map(value).collect();
        let sharp = Image::from_planar(width, height, planes);
        let is_long = |reach: i32| {
            let taps = (-reach..=reach).map(|x| Tap::even([x, 0], 1.0)).collect();
            let view = shaken_image(&sharp, &ShakeKernel::new(taps), &Response::srgb());
            let network = &mut Perfect(sharp.clone());
            is_strong(network, &[view], &Response::srgb(), &CancelToken::new())
        };
        // A path of 2 n + 1 px has an elongation of the square root of n (n + 1) / 3 px.
        assert!(!is_long(2).expect("no failure"), "1.4 px, 1.1 px of 420");
        assert!(is_long(5).expect("no failure"), "3.2 px, 2.4 px of 420");
    }

    #[test]
    fn shake_is_estimated_only_where_it_decides_anything() {
        let asked = |change: fn(&mut Options)| {
            let mut options = Options::default();
            change(&mut options);
            is_needed(&options)
        };
        assert!(asked(|_| {}));
        assert!(!asked(|options| options.shake = ShakeModel::Kernel));
        assert!(!asked(|options| options.train_on = TrainOn::Deblurred));
        assert!(!asked(|options| options.deblur = NetworkChoice::Identity));
    }
}
