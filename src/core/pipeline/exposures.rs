//! The exposure of each photograph, found before the rounds: a coarse scene tells which pixels of
//! two views show the same surface. Measured in docs/decisions/exposure.md.

use std::collections::BTreeMap;

use super::config::{Exposure, Options};
use super::context::Context;
use super::error::PipelineError;
use super::reconstruct::points;
use super::views::View;
use crate::camera::{Camera, Split};
use crate::capture::Capture;
use crate::device::Device;
use crate::enhance::{Anchor, Histogram, ToneCurve, automatic};
use crate::exposure::{self, Gains, Ratio, Surface};
use crate::gaussians::Gaussians;
use crate::image::{Image, Linear, Shot};
use crate::mask::{Mask, counted as counted_pixels};
use crate::metrics::{CaptureExposure, ColourFit, ViewExposure};
use crate::noise::NoiseMode;
use crate::poses::Poses;
use crate::reconstruct::{
    self, Background, Densify, Pace, TrainConfig, TrainHooks, TrainStart, TrainingView,
};
use crate::render::{Depth, Renderer};

/// Longest side of the images of the coarse scene, px.
const SIDE: usize = 160;
/// Its optimiser steps and largest number of Gaussians.
const STEPS: u32 = 300;
const CAP: usize = 4_000;
/// Standard deviation of exposures that are taken for equal, stops.
const ALIKE: f64 = 0.02;
/// Residuals of the pairs up to which the gains are used whole, and from which they are not used:
/// in stops, and relative to the standard deviation of the exposures.
const TRUSTED: (f64, f64) = (0.075, 0.095);
const TRUSTED_SHARE: (f64, f64) = (0.33, 0.42);
/// By how much the error on pixels that were left out may grow where the pairs agree exactly, as a
/// share: equal scenes of other points differ by one to two per cent. It falls to nothing at this
/// residual, stops: the less the pairs agree, the more must those pixels confirm.
const WORSE: (f64, f64) = (0.05, 0.06);
/// Side of the squares of pixels that are left out of the coarse scenes, px, and one in how many.
const SQUARE: usize = 8;
const LEFT_OUT: u64 = 10;
/// Views with EXIF, and the correlation of its exposures with the solved ones, from which it is a
/// prior.
const MIN_EXIF: usize = 6;
const MIN_CORRELATION: f64 = 0.5;

/// The gains of the views, by name; none for views in the neutral exposure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Exposures {
    gains: BTreeMap<String, Gains>,
    /// The share of solved gains that is used; 0 leaves photographs as taken.
    share: f64,
}

impl Exposures {
    /// Brings photographs as taken to the neutral exposure.
    pub fn even(&self, views: &mut [View]) {
        for view in views {
            if let Some(gains) = self.gains.get(&view.name) {
                view.dark = gains.even(&view.dark);
            }
        }
    }

    /// Forgets the exposure of a view whose pose changed, so that it is solved again.
    pub fn forget(&mut self, view: &str) {
        self.gains.remove(view);
    }

    /// Brings views that a round's scene placed to the exposure of the others. Returns what was
    /// solved for, by the name of the view.
    ///
    /// # Errors
    /// [`PipelineError::Render`].
    pub fn even_late(
        &mut self,
        device: &Device,
        scene: &Gaussians,
        views: &mut [View],
        capture: &Capture,
    ) -> Result<Vec<(String, ViewExposure)>, PipelineError> {
        let is_new = |view: &View| view.is_late && !self.gains.contains_key(&view.name);
        let late: Vec<bool> = views.iter().map(is_new).collect();
        if self.share == 0.0 || !late.contains(&true) {
            return Ok(Vec::new());
        }
        let known: Vec<Option<Gains>> =
            late.iter().map(|late| (!late).then(Gains::default)).collect();
        let small = Small::of(views);
        let depths = small.depths(&Renderer::new(device), scene)?;
        let ratios = exposure::ratios(&small.surfaces(&depths));
        let found = exposure::solve(&known, &ratios, &vec![0.0; views.len()]).gains;
        let mut solved = Vec::new();
        for (view, gains) in
            views.iter_mut().zip(found).zip(late).filter_map(|(of, late)| late.then_some(of))
        {
            let used = gains.scaled(self.share);
            view.dark = used.even(&view.dark);
            self.gains.insert(view.name.clone(), used);
            solved.push((view.name.clone(), of_view(&gains, shot(capture, view))));
        }
        Ok(solved)
    }
}

/// The views at the size of the coarse scene.
struct Small<'a> {
    views: &'a [View],
    cameras: Vec<Camera>,
    photographs: Vec<Image>,
    light: Vec<Image<Linear>>,
    /// The pixels that count.
    masks: Vec<Option<Mask>>,
}

impl<'a> Small<'a> {
    fn of(views: &'a [View]) -> Self {
        let size = |view: &View| view.dark.size_at_most(SIDE);
        let light = |view: &View| {
            let (width, height) = size(view);
            view.dark.to_linear().resize_area(width, height)
        };
        let camera = |view: &View| {
            let (width, height) = size(view);
            view.camera.resized(width, height)
        };
        let mask = |view: &View| {
            let (width, height) = size(view);
            view.mask.as_ref().map(|mask| mask.resized(width, height))
        };
        let light: Vec<Image<Linear>> = views.iter().map(light).collect();
        Self {
            views,
            cameras: views.iter().map(camera).collect(),
            photographs: light.iter().map(Image::to_srgb).collect(),
            light,
            masks: views.iter().map(mask).collect(),
        }
    }

    /// The depth of a scene in each view.
    fn depths(&self, renderer: &Renderer, scene: &Gaussians) -> Result<Vec<Depth>, PipelineError> {
        self.cameras.iter().map(|camera| Ok(renderer.depth(scene, camera)?)).collect()
    }

    fn surfaces<'b>(&'b self, depths: &'b [Depth]) -> Vec<Surface<'b>> {
        let surface = |(index, depth): (usize, &'b Depth)| Surface {
            camera: &self.cameras[index],
            photograph: &self.light[index],
            depth: depth.values(),
            mask: self.masks[index].as_ref(),
        };
        depths.iter().enumerate().map(surface).collect()
    }

    /// Indices of the training views.
    fn training(&self) -> impl Iterator<Item = usize> + Clone + '_ {
        let trains = |index: &usize| self.views[*index].split == Split::Train;
        (0..self.views.len()).filter(trains)
    }

    /// The photographs in the neutral exposure, at the target brightness.
    fn brightened(&self, gains: &[Gains]) -> Vec<Image> {
        let evened = |(photograph, gains): (&Image, &Gains)| gains.even(photograph);
        let evened: Vec<Image> = self.photographs.iter().zip(gains).map(evened).collect();
        let counted = evened.iter().zip(&self.masks);
        let counted: Vec<_> =
            counted.map(|(image, mask)| counted_pixels(image, mask.as_ref())).collect();
        let pooled = Histogram::pooled(counted.iter().map(|image| &**image));
        let target: Anchor = automatic(&pooled);
        let curve = ToneCurve::new(&pooled, target);
        evened.iter().map(|image| curve.apply(image)).collect()
    }
}

/// Finds the exposures of the photographs. `None` where the options leave them as taken.
///
/// # Errors
/// [`PipelineError::Reconstruct`], [`PipelineError::Render`], [`PipelineError::Cancelled`].
pub fn find(
    context: &mut Context<'_>,
    device: &Device,
    options: &Options,
    capture: &Capture,
    poses: &Poses,
    views: &[View],
) -> Result<(Exposures, Option<CaptureExposure>), PipelineError> {
    if options.exposure == Exposure::AsTaken {
        return Ok((Exposures::default(), None));
    }
    let small = Small::of(views);
    let shots: Vec<Option<Shot>> = views.iter().map(|view| shot(capture, view)).collect();
    let as_taken = vec![Gains::default(); views.len()];
    let first = CoarseScene::of(context, device, poses, &small, &as_taken)?;
    let mut found = solved(&small, &first.ratios, &shots);
    let mut verdict = Verdict::of(&found);
    let mut error = None;
    if verdict == Verdict::Used {
        let second = CoarseScene::of(context, device, poses, &small, &found.gains)?;
        found = solved(&small, &second.ratios, &shots);
        let is_worse = second.error > (1.0 + found.tolerance()) * first.error;
        verdict = if is_worse { Verdict::NotConfirmed } else { Verdict::of(&found) };
        error = Some([first.error, second.error]);
    }
    let share = if verdict == Verdict::Used { found.trust() } else { 0.0 };
    let applied: Vec<Gains> = found.gains.iter().map(|gains| gains.scaled(share)).collect();
    let report = CaptureExposure {
        share,
        verdict: verdict.to_string(),
        spread_stops: found.spread(&small),
        residual_stops: found.residual,
        pairs: first.ratios.len() as u32,
        exif_slope: found.exif_slope,
        left_out_error: error,
        views: views
            .iter()
            .zip(&found.gains)
            .zip(&shots)
            .map(|((view, gains), shot)| (view.name.clone(), of_view(gains, *shot)))
            .collect(),
    };
    context.sink.log(format!("exposure: {}", report.in_words()));
    let named = views.iter().map(|view| view.name.clone()).zip(applied);
    Ok((Exposures { gains: named.collect(), share }, Some(report)))
}

/// The EXIF exposure of a view's photograph.
fn shot(capture: &Capture, view: &View) -> Option<Shot> {
    let photograph = capture.views.iter().find(|photograph| photograph.name == view.name);
    photograph.and_then(|photograph| photograph.shot)
}

fn of_view(gains: &Gains, shot: Option<Shot>) -> ViewExposure {
    ViewExposure {
        stops: gains.exposure(),
        tint: gains.tint(),
        seconds: shot.map(|shot| shot.seconds),
        iso: shot.map(|shot| shot.iso),
        f_number: shot.and_then(|shot| shot.f_number),
    }
}

/// What becomes of the solved gains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Used,
    Alike,
    NoPairs,
    Contradictory,
    NotConfirmed,
}

impl Verdict {
    fn of(found: &Found) -> Self {
        match found.residual {
            None => Self::NoPairs,
            Some(_) if found.deviation < ALIKE => Self::Alike,
            Some(_) if found.trust() == 0.0 => Self::Contradictory,
            Some(_) => Self::Used,
        }
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Used => "evened",
            Self::Alike => "left as taken: all are exposed alike",
            Self::NoPairs => "left as taken: no two photographs show enough common surface",
            Self::Contradictory => "left as taken: the photographs do not agree on one gain each",
            Self::NotConfirmed => {
                "left as taken: pixels that were left out fit worse in one exposure"
            }
        })
    }
}

/// The solved gains.
struct Found {
    gains: Vec<Gains>,
    residual: Option<f64>,
    /// Standard deviation of the exposures of the training views, stops.
    deviation: f64,
    exif_slope: Option<f64>,
}

impl Found {
    /// The share of the gains that is used.
    fn trust(&self) -> f64 {
        let Some(residual) = self.residual else { return 0.0 };
        let within = |(whole, none): (f64, f64), value: f64| {
            ((none - value) / (none - whole)).clamp(0.0, 1.0)
        };
        let relative = residual / self.deviation.max(f64::MIN_POSITIVE);
        within(TRUSTED, residual).min(within(TRUSTED_SHARE, relative))
    }

    /// By how much the error on pixels that were left out may grow, as a share.
    fn tolerance(&self) -> f64 {
        let (share, none_at) = WORSE;
        self.residual.map_or(0.0, |residual| share * (1.0 - residual / none_at).max(0.0))
    }

    /// Least and largest exposure of a training view, stops.
    fn spread(&self, small: &Small<'_>) -> [f64; 2] {
        let stops = small.training().map(|index| self.gains[index].exposure());
        [stops.clone().fold(0.0, f64::min), stops.fold(0.0, f64::max)]
    }
}

/// Solves for the gains of the training views among themselves, then for those of held-out views,
/// which decide nothing about the others.
fn solved(small: &Small<'_>, ratios: &[Ratio], shots: &[Option<Shot>]) -> Found {
    let trains: Vec<bool> = small.views.iter().map(|view| view.split == Split::Train).collect();
    let known: Vec<Option<Gains>> =
        trains.iter().map(|trains| (!trains).then(Gains::default)).collect();
    let among = |ratio: &&Ratio| ratio.views.iter().all(|view| trains[*view]);
    let training: Vec<Ratio> = ratios.iter().filter(among).copied().collect();
    let nothing = vec![0.0; small.views.len()];
    let plain = centred(exposure::solve(&known, &training, &nothing), small);
    let exif = exif_stops(small, shots);
    let slope = exif.as_ref().and_then(|exif| slope(small, &plain.gains, exif));
    let prior = match (&exif, slope) {
        (Some(exif), Some(slope)) => exif.iter().map(|stops| slope * stops).collect(),
        _ => nothing,
    };
    let solution = centred(exposure::solve(&known, &training, &prior), small);
    let of_training: Vec<Option<Gains>> = solution
        .gains
        .iter()
        .zip(&trains)
        .map(|(gains, trains)| trains.then_some(*gains))
        .collect();
    let all = exposure::solve(&of_training, ratios, &prior);
    let stops: Vec<f64> = small.training().map(|index| all.gains[index].exposure()).collect();
    let squares: f64 = stops.iter().map(|stops| stops.powi(2)).sum();
    Found {
        gains: all.gains,
        residual: solution.residual,
        deviation: (squares / stops.len().max(1) as f64).sqrt(),
        exif_slope: slope,
    }
}

/// With a zero mean over the training views.
fn centred(mut solution: exposure::Solution, small: &Small<'_>) -> exposure::Solution {
    let count = small.training().count().max(1) as f64;
    for channel in 0..3 {
        let sum: f64 = small.training().map(|index| solution.gains[index].stops[channel]).sum();
        small.training().for_each(|index| solution.gains[index].stops[channel] -= sum / count);
    }
    solution
}

/// The exposures that EXIF records, with a zero mean over the training views; `None` unless all
/// views have one.
fn exif_stops(small: &Small<'_>, shots: &[Option<Shot>]) -> Option<Vec<f64>> {
    let shots: Vec<Shot> = shots.iter().copied().collect::<Option<_>>()?;
    let has_aperture = shots.iter().all(|shot| shot.f_number.is_some());
    let stops: Vec<f64> = shots.iter().map(|shot| shot.stops(has_aperture)).collect();
    let training: Vec<f64> = small.training().map(|index| stops[index]).collect();
    let mean = training.iter().sum::<f64>() / training.len().max(1) as f64;
    Some(stops.iter().map(|stops| stops - mean).collect())
}

/// The slope of the solved exposures over EXIF's: the curve of a camera may be steeper than sRGB's.
/// `None` if the two have too little to do with each other.
fn slope(small: &Small<'_>, gains: &[Gains], exif: &[f64]) -> Option<f64> {
    let pairs = small.training().map(|index| (exif[index], gains[index].exposure()));
    let sum = |of: fn((f64, f64)) -> f64| pairs.clone().map(of).sum::<f64>();
    let (squares, products) = (sum(|(x, _)| x * x), sum(|(x, y)| x * y));
    let correlation = products / (squares * sum(|(_, y)| y * y)).sqrt();
    let is_known = pairs.clone().count() >= MIN_EXIF && correlation >= MIN_CORRELATION;
    is_known.then(|| products / squares)
}

/// What a coarse scene of the photographs tells.
struct CoarseScene {
    /// The ratios of the photographs' light, as taken.
    ratios: Vec<Ratio>,
    /// Root mean square difference of render and photograph over the pixels that were left out,
    /// after a colour fit of each view, in values at the target brightness.
    error: f64,
}

impl CoarseScene {
    /// Trains on the photographs, evened by these gains.
    fn of(
        context: &Context<'_>,
        device: &Device,
        poses: &Poses,
        small: &Small<'_>,
        gains: &[Gains],
    ) -> Result<Self, PipelineError> {
        let images = small.brightened(gains);
        let left_out = |(index, image)| left_out(index, image);
        let left_out: Vec<Mask> = images.iter().enumerate().map(left_out).collect();
        let scene = trained(context, device, poses, small, &images, &left_out)?;
        let renderer = Renderer::new(device);
        let depths = small.depths(&renderer, &scene)?;
        let uploaded = renderer.upload(&scene)?;
        let (mut sum, mut count) = (0.0, 0);
        for index in small.training() {
            let judged = &left_out[index];
            let judged =
                small.masks[index].as_ref().map_or_else(|| judged.clone(), |mask| mask.and(judged));
            let render = renderer.render_scene(&uploaded, &small.cameras[index])?;
            let [render, photograph] =
                [&render, &images[index]].map(|image| judged.pixels_of(image));
            let fitted = ColourFit::between(&render, &photograph).apply(&render);
            let pairs = fitted.data().iter().zip(photograph.data());
            sum += pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            count += photograph.data().len();
        }
        let error = (sum / count.max(1) as f64).sqrt();
        Ok(Self { ratios: exposure::ratios(&small.surfaces(&depths)), error })
    }
}

/// The Gaussians of a coarse scene of the training views.
fn trained(
    context: &Context<'_>,
    device: &Device,
    poses: &Poses,
    small: &Small<'_>,
    images: &[Image],
    left_out: &[Mask],
) -> Result<Gaussians, PipelineError> {
    let view = |index: usize| {
        let kept = left_out[index].inverted();
        TrainingView {
            name: small.views[index].name.clone(),
            camera: small.cameras[index],
            image: images[index].clone(),
            mask: Some(match &small.masks[index] {
                Some(mask) => mask.and(&kept),
                None => kept,
            }),
            noise: None,
            has_kernel: false,
        }
    };
    let training: Vec<TrainingView> = small.training().map(view).collect();
    let config = TrainConfig {
        steps: STEPS,
        shake: None,
        refine_poses: None,
        cap: CAP,
        sh_degree: 0,
        noise: NoiseMode::Off,
        resolution_schedule: true,
        pace: Pace::Adapted,
        warm: false,
        background: Background::Random,
        densify: Densify::Mcmc,
        // The photographs are the same for every seed of a run.
        seed: 0,
        extent: reconstruct::scene_extent(&small.cameras, &points::as_given(poses)),
    };
    let seen = training.iter().map(|view| (&view.camera, &view.image, view.mask.as_ref()));
    let points = points::coloured(poses, seen);
    let first = reconstruct::initialise(&points, &small.cameras, CAP, &config.schedule());
    let mut hooks = TrainHooks {
        cancel: context.cancel,
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: None,
        look: None,
    };
    let start = TrainStart::Fresh(first);
    Ok(reconstruct::train(device, &training, start, &config, &mut hooks)?.gaussians)
}

/// The squares of a view's pixels that are left out, other ones in every view.
fn left_out(view: usize, image: &Image) -> Mask {
    let (width, height) = (image.width(), image.height());
    let is_out = |at: usize| {
        let [x, y, view] = [at % width / SQUARE, at / width / SQUARE, view].map(|n| n as u64);
        // Consecutive numbers spread evenly over the range by the golden ratio.
        let mixed = (x + 31 * y + 977 * view).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        (mixed >> 32) % LEFT_OUT == 0
    };
    Mask::new(width, height, (0..width * height).map(is_out).collect())
}
