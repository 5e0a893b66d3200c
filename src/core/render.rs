//! Images of a scene, without training it.

use std::sync::Mutex;

use fled_gpu::{Gpu, GpuError, Recording};

use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::splat::project::{DeviceGaussians, Projection};
use crate::splat::rasterize::{Forward, Specialisation, SplatBuffers, SplatSizes, SplatWork};
use crate::splat::uniform::{CameraUniform, NEAR};

/// Rendering failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SplatError {
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The camera has no pixels.
    #[error("a camera of {width} x {height} pixels")]
    EmptyImage {
        /// px.
        width: usize,
        /// px.
        height: usize,
    },
}

/// Renders scenes over black. Buffers are kept from image to image, and grow when they must.
pub struct Renderer {
    gpu: Gpu,
    forward: Forward,
}

/// A scene on the device, with the buffers of its last image.
pub struct Scene {
    gaussians: DeviceGaussians,
    projection: Projection,
    target: Mutex<Option<Target>>,
}

/// Buffers for one image size and the commands that fill them.
struct Target {
    buffers: SplatBuffers,
    recording: Recording,
}

impl Scene {
    /// How much the last image had to sort and blend; `None` before the first. Waits for the
    /// device.
    ///
    /// # Errors
    /// A device error.
    pub fn work(&self) -> Result<Option<SplatWork>, SplatError> {
        let kept = self
            .target
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        Ok(kept
            .as_ref()
            .map(|target| target.buffers.work())
            .transpose()?)
    }
}

impl Renderer {
    /// A renderer on this device.
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            gpu: gpu.clone(),
            forward: Forward::new(Specialisation::for_adapter(gpu.describe())),
        }
    }

    /// Copies a scene to the device, for [`Renderer::render_scene`].
    ///
    /// # Errors
    /// Out of memory, or more Gaussians than the adapter binds.
    pub fn upload(&self, gaussians: &Gaussians) -> Result<Scene, SplatError> {
        Ok(Scene {
            gaussians: DeviceGaussians::upload(&self.gpu, gaussians, gaussians.len())?,
            projection: Projection::new(&self.gpu, gaussians.len())?,
            target: Mutex::new(None),
        })
    }

    /// The image a camera sees, with spherical harmonics up to `sh_degree`; sRGB-encoded, over
    /// black, not clamped above.
    ///
    /// # Errors
    /// As [`Renderer::upload`], and [`SplatError::EmptyImage`].
    pub fn render(
        &self,
        gaussians: &Gaussians,
        camera: &Camera,
        sh_degree: u32,
    ) -> Result<Image, SplatError> {
        self.draw(&self.upload(gaussians)?, camera, sh_degree)
    }

    /// The image a camera sees, with all spherical harmonics of the scene.
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn render_scene(&self, scene: &Scene, camera: &Camera) -> Result<Image, SplatError> {
        self.draw(scene, camera, scene.gaussians.sh_degree)
    }

    fn draw(&self, scene: &Scene, camera: &Camera, sh_degree: u32) -> Result<Image, SplatError> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        if width == 0 || height == 0 {
            return Err(SplatError::EmptyImage { width, height });
        }
        let allocated = scene.gaussians.sh_degree;
        let uniform = CameraUniform::new(camera, scene.gaussians.count, sh_degree, allocated, NEAR);
        let mut kept = scene
            .target
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        // Most splats touch a few tiles; the exact number is known after the first attempt.
        let mut intersections = (4 * scene.gaussians.count).max(1 << 14);
        if let Some(target) =
            kept.take_if(|t| (t.buffers.sizes().width, t.buffers.sizes().height) != (width, height))
        {
            intersections = intersections.max(target.buffers.sizes().intersections);
        }
        loop {
            let target = match kept.take() {
                Some(target) => target,
                None => self.target(
                    scene,
                    SplatSizes {
                        gaussians: scene.gaussians.count,
                        width,
                        height,
                        intersections,
                    },
                )?,
            };
            scene.projection.camera.write(&[uniform])?;
            target.recording.submit()?;
            let counts = target.buffers.counts()?;
            let image = target.buffers.image.start_read(3 * width * height)?;
            let counts = counts.wait()?;
            if !counts.overflowed() {
                let image = Image::from_planar(width, height, image.wait()?);
                *kept = Some(target);
                return Ok(image);
            }
            // The count is exact; the rest is room for the next camera.
            intersections = counts.intersections + counts.intersections / 2;
        }
    }

    fn target(&self, scene: &Scene, sizes: SplatSizes) -> Result<Target, SplatError> {
        let buffers = SplatBuffers::new(&self.gpu, sizes, false)?;
        let mut recorder = self.gpu.recorder();
        scene.projection.record(&mut recorder, &scene.gaussians)?;
        self.forward
            .record(&mut recorder, &scene.projection, &buffers)?;
        Ok(Target {
            buffers,
            recording: recorder.finish(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::compare::mostly_within;
    use crate::splat::fixtures;
    use crate::splat::reference::{self, Splat};

    #[test]
    fn a_rendered_image_equals_the_reference_from_the_gaussians_on() {
        let gaussians = fixtures::gaussians(300, 2, 21);
        let mut view = fixtures::viewpoint(70, 45);
        (view.sh_degree, view.near) = (2, f64::from(NEAR));
        let splats: Vec<_> = (0..300)
            .map(|i| Splat::from_gaussians(&gaussians, i))
            .collect();
        let (_, expected) = reference::render(&splats, &view);
        let renderer = Renderer::new(fixtures::gpu());
        let image = renderer.render(&gaussians, &view.camera, 2).unwrap();
        mostly_within(image.data(), &expected.image, 1e-4, 1e-3).unwrap();
        view.sh_degree = 0;
        let (_, expected) = reference::render(&splats, &view);
        let image = renderer.render(&gaussians, &view.camera, 0).unwrap();
        mostly_within(image.data(), &expected.image, 1e-4, 1e-3).unwrap();
    }

    #[test]
    fn a_scene_serves_cameras_of_different_sizes_and_grows_on_overflow() {
        let mut gaussians = fixtures::gaussians(200, 0, 2);
        gaussians.log_scales.fill([1.5; 3]);
        gaussians.opacity_logits.fill(-2.0);
        let renderer = Renderer::new(fixtures::gpu());
        let scene = renderer.upload(&gaussians).unwrap();
        // 200 splats over 1,200 tiles: far more than the first guess holds.
        let large = fixtures::viewpoint(640, 480).camera;
        let first = renderer.render_scene(&scene, &large).unwrap();
        let small = renderer
            .render_scene(&scene, &fixtures::viewpoint(64, 48).camera)
            .unwrap();
        assert_eq!((small.width(), small.height()), (64, 48));
        assert!(renderer.render_scene(&scene, &large).unwrap() == first);
        assert!(renderer.render(&gaussians, &large, 0).unwrap() == first);
        assert!(first.data().iter().any(|&v| v > 0.1));
    }

    #[test]
    fn a_camera_without_pixels_is_an_error() {
        let renderer = Renderer::new(fixtures::gpu());
        let camera = fixtures::viewpoint(0, 48).camera;
        let result = renderer.render(&fixtures::gaussians(3, 0, 1), &camera, 0);
        assert!(matches!(
            result,
            Err(SplatError::EmptyImage {
                width: 0,
                height: 48
            })
        ));
    }
}
