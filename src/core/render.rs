//! Rendering of a scene without training.

mod depth;

use std::sync::{Mutex, MutexGuard, PoisonError};

use fled_gpu::GpuError;

use crate::camera::Camera;
use crate::device::{Device, Scene};
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::splat::rasterize::SplatCounts;
pub use depth::Depth;

/// Rendering failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SplatError {
    /// A device error.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The camera has no pixels.
    #[error("a camera of {width} x {height} pixels")]
    EmptyImage {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
}

/// Renders scenes over black. Buffers are reused between images, and grow on demand.
pub struct Renderer {
    device: Device,
}

/// Gaussians on the device, with the buffers of their last image.
pub struct UploadedGaussians {
    scene: Mutex<Box<dyn Scene>>,
    sh_degree: u32,
}

impl UploadedGaussians {
    /// The counts of the last image, all 0 before the first. Waits for the device.
    ///
    /// # Errors
    /// A device error.
    pub fn counts(&self) -> Result<SplatCounts, SplatError> {
        Ok(self.scene().counts()?)
    }

    fn scene(&self) -> MutexGuard<'_, Box<dyn Scene>> {
        self.scene.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Renderer {
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone() }
    }

    /// Uploads a scene to the device, for [`Renderer::render_scene`].
    ///
    /// # Errors
    /// Out of memory, or more Gaussians than the adapter can bind.
    pub fn upload(&self, gaussians: &Gaussians) -> Result<UploadedGaussians, SplatError> {
        Ok(UploadedGaussians {
            scene: Mutex::new(self.device.scene(gaussians)?),
            sh_degree: gaussians.sh_degree,
        })
    }

    /// Renders a scene through a camera, with spherical harmonics up to `sh_degree`; sRGB-encoded,
    /// over black, not clamped above.
    ///
    /// # Errors
    /// As [`Renderer::upload`], and [`SplatError::EmptyImage`].
    pub fn render(
        &self,
        gaussians: &Gaussians,
        camera: &Camera,
        sh_degree: u32,
    ) -> Result<Image, SplatError> {
        draw(&self.upload(gaussians)?, camera, sh_degree)
    }

    /// Renders an uploaded scene through a camera, with all of its spherical harmonics.
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn render_scene(
        &self,
        scene: &UploadedGaussians,
        camera: &Camera,
    ) -> Result<Image, SplatError> {
        draw(scene, camera, scene.sh_degree)
    }

    /// Renders the depth of a scene through a camera.
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn depth(&self, gaussians: &Gaussians, camera: &Camera) -> Result<Depth, SplatError> {
        let unit = depth::unit(gaussians, camera);
        let far = depth::as_colours(gaussians, camera, unit);
        Ok(Depth::of(&self.render(&far, camera, 0)?, unit))
    }
}

fn draw(scene: &UploadedGaussians, camera: &Camera, sh_degree: u32) -> Result<Image, SplatError> {
    let [width, height] = camera.size();
    if width == 0 || height == 0 {
        return Err(SplatError::EmptyImage { width, height });
    }
    Ok(scene.scene().render(camera, sh_degree)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::compare::mostly_within;
    use crate::splat::fixtures;
    use crate::splat::reference::{self, Splat};
    use crate::splat::uniform::NEAR;

    #[test]
    fn a_rendered_image_matches_the_reference_on_both_devices() {
        let gaussians = fixtures::gaussians(300, 2, 21);
        let mut view = fixtures::viewpoint(70, 45);
        (view.sh_degree, view.near) = (2, f64::from(NEAR));
        let splats: Vec<_> = (0..300).map(|i| Splat::from_gaussians(&gaussians, i)).collect();
        let (_, expected) = reference::render(&splats, &view);
        let expected_flat = {
            view.sh_degree = 0;
            reference::render(&splats, &view).1
        };
        for device in fixtures::devices() {
            let renderer = Renderer::new(&device);
            for (degree, expected) in [(2, &expected), (0, &expected_flat)] {
                let image = renderer.render(&gaussians, &view.camera, degree).unwrap();
                mostly_within(image.data(), &expected.image, 1e-4, 1e-3).unwrap();
            }
        }
    }

    #[test]
    fn a_scene_serves_cameras_of_any_size_and_grows_on_overflow() {
        let mut gaussians = fixtures::gaussians(200, 0, 2);
        gaussians.log_scales.fill([1.5; 3]);
        gaussians.opacity_logits.fill(-2.0);
        for device in fixtures::devices() {
            let renderer = Renderer::new(&device);
            let scene = renderer.upload(&gaussians).unwrap();
            // 200 splats over 1,200 tiles: far more than the initial guess.
            let large = fixtures::viewpoint(640, 480).camera;
            let first = renderer.render_scene(&scene, &large).unwrap();
            let small = renderer.render_scene(&scene, &fixtures::viewpoint(64, 48).camera);
            let small = small.unwrap();
            assert_eq!((small.width(), small.height()), (64, 48));
            assert!(renderer.render_scene(&scene, &large).unwrap() == first);
            assert!(renderer.render(&gaussians, &large, 0).unwrap() == first);
            assert!(first.data().iter().any(|&v| v > 0.1));
        }
    }

    #[test]
    fn a_camera_without_pixels_is_an_error() {
        let renderer = Renderer::new(&Device::Processor);
        let camera = fixtures::viewpoint(0, 48).camera;
        let result = renderer.render(&fixtures::gaussians(3, 0, 1), &camera, 0);
        assert!(matches!(result, Err(SplatError::EmptyImage { width: 0, height: 48 })));
    }
}
