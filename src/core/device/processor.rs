//! Scenes on the processor.

use fled_cpu::View;
use fled_cpu::bins::Bins;
use fled_cpu::blend::Canvas;
use fled_cpu::population::Population;
use fled_cpu::project::Projection;
use fled_cpu::shake::Shake;
use fled_gpu::GpuError;

use super::scene::{Scene, Shaken};
use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::splat::processor;
use crate::splat::rasterize::SplatCounts;
use crate::splat::uniform::{CameraUniform, NEAR};

/// A scene with the state of its last image.
pub struct ProcessorScene {
    pub population: Population,
    pub projection: Projection,
    pub bins: Bins,
    pub canvas: Canvas,
    pub shake: Shake,
}

impl ProcessorScene {
    /// For renders.
    pub fn new(gaussians: &Gaussians) -> Self {
        Self::of(processor::population(gaussians))
    }

    /// Of Gaussians that may be in training.
    pub fn of(population: Population) -> Self {
        Self {
            population,
            projection: Projection::default(),
            bins: Bins::default(),
            canvas: Canvas::default(),
            shake: Shake::default(),
        }
    }

    /// Draws the scene into the canvas.
    pub fn draw(&mut self, camera: &Camera, degree: u32, background: [f32; 3]) -> View {
        let (count, allocated) = (self.population.len(), self.population.sh_degree());
        let uniform = CameraUniform::new(camera, count, degree, allocated, NEAR);
        let view = processor::view(&uniform.before(background));
        self.projection.run(&self.population, &view);
        self.bins.run(&self.projection, view.size);
        self.canvas.run(&self.projection, &self.bins, &view);
        view
    }
}

impl Scene for ProcessorScene {
    fn render(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError> {
        let view = self.draw(camera, degree, [0.0; 3]);
        Ok(Image::from_planar(view.size[0], view.size[1], self.canvas.image.clone()))
    }

    fn render_shaken(
        &mut self,
        camera: &Camera,
        degree: u32,
        shaken: Shaken<'_>,
    ) -> Result<Image, GpuError> {
        let view = self.draw(camera, degree, [0.0; 3]);
        let kernel = shaken.kernel.on_processor(view.size);
        self.shake.forward(&self.canvas.image, &kernel, &shaken.response.on_processor());
        Ok(Image::from_planar(view.size[0], view.size[1], self.shake.blurred.clone()))
    }

    fn counts(&self) -> Result<SplatCounts, GpuError> {
        let intersections = self.bins.intersections();
        Ok(SplatCounts { visible: self.bins.visible(), intersections, capacity: intersections })
    }
}
