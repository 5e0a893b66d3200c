//! A short training that shows whether a device can train.

use std::time::Instant;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::{
    Background, Densify, Pace, Point, ReconstructError, Response, TrainConfig, TrainHooks,
    TrainStart, TrainingView, initialise, train,
};
use crate::camera::{Camera, Intrinsics};
use crate::cancel::CancelToken;
use crate::device::Device;
use crate::image::Image;
use crate::metrics::psnr;
use crate::noise::NoiseMode;

/// Size of the images, px.
const SIZE: [usize; 2] = [96, 64];
/// Steps of the training.
const STEPS: u32 = 10;
/// Points, and the most Gaussians.
const POINTS: usize = 200;
/// Least agreement with the processor, dB. After 50 steps real devices have 45 and more.
const LEAST_DB: f64 = 35.0;

/// Why a device cannot train.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// It fails.
    #[error("it cannot train: {0}")]
    Fails(#[from] ReconstructError),
    /// It computes nonsense.
    #[error("after {STEPS} steps its render has values that are not finite")]
    NotFinite,
    /// It computes something else.
    #[error("after {STEPS} steps its render differs from the processor's: {psnr_db:.1} dB")]
    Differs {
        /// Agreement, dB.
        psnr_db: f64,
    },
}

/// Trains ten steps, with shake, and renders a view; compares the render with the processor's where
/// the processor can train. Returns the seconds on the device.
///
/// # Errors
/// [`TrialError`].
pub fn trial(device: &Device) -> Result<f64, TrialError> {
    let begin = Instant::now();
    let render = trained_view(device)?;
    let seconds = begin.elapsed().as_secs_f64();
    let is_gpu = matches!(device, Device::Gpu(_));
    let expected = match Device::new(crate::device::PROCESSOR) {
        Ok(processor) if is_gpu => Some(trained_view(&processor)?),
        _ => None,
    };
    judge(&render, expected.as_ref())?;
    Ok(seconds)
}

fn judge(render: &Image, expected: Option<&Image>) -> Result<(), TrialError> {
    if !render.data().iter().all(|value| value.is_finite()) {
        return Err(TrialError::NotFinite);
    }
    match expected.map(|expected| psnr(render, expected)) {
        Some(psnr_db) if psnr_db < LEAST_DB => Err(TrialError::Differs { psnr_db }),
        _ => Ok(()),
    }
}

fn trained_view(device: &Device) -> Result<Image, ReconstructError> {
    let cameras = [-0.3, 0.0, 0.3].map(camera_at);
    let views: Vec<_> = cameras.iter().enumerate().map(|(n, camera)| view(n, *camera)).collect();
    let config = TrainConfig {
        shake: Some(Response::srgb()),
        refine_poses: None,
        steps: STEPS,
        cap: POINTS,
        sh_degree: 1,
        noise: NoiseMode::Off,
        resolution_schedule: false,
        pace: Pace::Adapted,
        warm: false,
        background: Background::Black,
        densify: Densify::Mcmc,
        seed: 1,
        extent: 1.0,
    };
    let first = initialise(&points(), &cameras, config.cap, &config.schedule());
    let mut hooks = TrainHooks {
        cancel: &CancelToken::new(),
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: None,
        look: None,
    };
    let trained = train(device, &views, TrainStart::Fresh(first), &config, &mut hooks)?;
    let mut scene = device.scene(&trained.gaussians)?;
    Ok(scene.render(&cameras[0], config.sh_degree)?)
}

/// A camera three units from the middle of the points.
fn camera_at(angle: f64) -> Camera {
    let [width, height] = SIZE;
    let focal = 1.1 * width as f64;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let intrinsics = Intrinsics { width, height, fx: focal, fy: focal, cx, cy };
    let eye = DVec3::new(3.0 * angle.sin(), -0.3, -3.0 * angle.cos());
    Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y)
}

/// A photograph of coloured waves.
fn view(number: usize, camera: Camera) -> TrainingView {
    let [width, height] = SIZE;
    let value = |at: usize| {
        let (x, y) = (at % width, at / width % height);
        0.5 + 0.4 * ((x + 2 * y + 7 * (at / (width * height))) as f32 / 9.0).sin()
    };
    let planes = (0..3 * width * height).map(value).collect();
    TrainingView {
        name: number.to_string(),
        camera,
        image: Image::from_planar(width, height, planes),
        mask: None,
        noise: None,
        has_kernel: true,
    }
}

fn points() -> Vec<Point> {
    let mut random = Pcg64::seed_from_u64(1);
    let mut point = || Point {
        position: [0; 3].map(|_| random.random::<f32>() - 0.5),
        colour: [0; 3].map(|_| random.random()),
    };
    (0..POINTS).map(|_| point()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::fixtures;

    #[test]
    fn every_device_of_the_tests_passes() {
        for device in fixtures::devices() {
            let seconds = trial(&device).expect("it trains");
            assert!(seconds > 0.0, "{device}");
        }
    }

    #[test]
    fn a_device_that_computes_nonsense_or_something_else_fails() {
        let render = trained_view(&Device::Processor).expect("it trains");
        assert!(judge(&render, Some(&render)).is_ok());
        let poisoned = judge(&render.map(|_| f32::NAN), None);
        assert!(matches!(poisoned, Err(TrialError::NotFinite)), "{poisoned:?}");
        let other = judge(&render.map(|value| 0.5 * value), Some(&render));
        assert!(matches!(other, Err(TrialError::Differs { .. })), "{other:?}");
    }
}
