//! The pixels of a picture that at least two training views see. The surface behind all others is
//! unknown.

use glam::DVec3;
use rayon::prelude::*;

use super::error::EvaluationError;
use super::subject::Subject;
use fled_core::camera::Camera;
use fled_core::gaussians::Gaussians;
use fled_core::mask::Mask;
use fled_core::render::Renderer;

/// Number of training views that must see a pixel.
const LEAST_VIEWS: usize = 2;
/// Maximum depth at which a view sees a point, relative to the surface that it sees there.
const DEEPER: f64 = 1.1;
/// Minimum coverage of a surface.
const LEAST_COVERAGE: f32 = 0.5;

/// The training views of a run, with the depths that they see.
pub(super) struct Witnesses<'a> {
    scene: &'a Gaussians,
    views: Vec<(Camera, Vec<Option<f64>>)>,
}

impl<'a> Witnesses<'a> {
    /// Renders the depth of a run's scene in its training views.
    ///
    /// # Errors
    /// A device error.
    pub(super) fn new(renderer: &Renderer, run: &'a Subject) -> Result<Self, EvaluationError> {
        let seen = |(_, camera): (&str, Camera)| {
            let depths = depths(renderer, &run.gaussians, &camera)?;
            Ok((camera, depths))
        };
        let views: Result<Vec<_>, EvaluationError> = run.training().map(seen).collect();
        Ok(Self { scene: &run.gaussians, views: views? })
    }

    /// The pixels of a camera's picture that at least two of the training views see.
    ///
    /// # Errors
    /// A device error.
    pub(super) fn mask(
        &self,
        renderer: &Renderer,
        camera: &Camera,
    ) -> Result<Mask, EvaluationError> {
        let depths = depths(renderer, self.scene, camera)?;
        let k = &camera.intrinsics;
        let to_world = camera.world_to_camera.inverse();
        let is_seen = |(i, depth): (usize, &Option<f64>)| {
            let Some(depth) = *depth else {
                return false;
            };
            let (x, y) = ((i % k.width) as f64 + 0.5, (i / k.width) as f64 + 0.5);
            let ray = DVec3::new((x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0);
            let point = to_world.transform_point3(depth * ray);
            let views = self.views.iter();
            let sees = views.filter(|(view, surface)| sees(view, surface, point));
            sees.take(LEAST_VIEWS).count() == LEAST_VIEWS
        };
        let holds = depths.par_iter().enumerate().map(is_seen).collect();
        Ok(Mask::new(k.width, k.height, holds))
    }
}

/// Whether a point lies in a view's picture and not behind the surface there.
fn sees(view: &Camera, surface: &[Option<f64>], point: DVec3) -> bool {
    let Some((pixel, depth)) = view.shows(point) else {
        return false;
    };
    let at = pixel.y as usize * view.intrinsics.width + pixel.x as usize;
    surface[at].is_some_and(|surface| depth <= DEEPER * surface)
}

/// Mean depth of each pixel of a camera's picture, world units, row by row; `None` without a
/// surface.
fn depths(
    renderer: &Renderer,
    scene: &Gaussians,
    camera: &Camera,
) -> Result<Vec<Option<f64>>, EvaluationError> {
    /// Y_0^0, the constant harmonic.
    const Y00: f32 = 0.282_094_8;
    let depth = |mean: &[f32; 3]| {
        let point = DVec3::from(mean.map(f64::from));
        camera.world_to_camera.transform_point3(point).z.max(0.0)
    };
    let all: Vec<f64> = scene.means.iter().map(depth).collect();
    let furthest = all.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let mut painted = scene.with_sh_degree(0);
    // Red: depth as a share of the furthest. Green: coverage.
    for (sh, depth) in painted.sh.chunks_exact_mut(3).zip(&all) {
        let colour = [(depth / furthest) as f32, 1.0, 0.0];
        sh.copy_from_slice(&colour.map(|value| (value - 0.5) / Y00));
    }
    let picture = renderer.render(&painted, camera, 0)?;
    let pixels = picture.plane(0).iter().zip(picture.plane(1));
    let depth = |(depth, covered): (&f32, &f32)| {
        (*covered >= LEAST_COVERAGE).then(|| f64::from(depth / covered) * furthest)
    };
    Ok(pixels.map(depth).collect())
}
