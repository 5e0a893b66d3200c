//! A scene on the device and its renderer: the one place that repeats a drawing until its
//! intersections fit.

use fled_gpu::{Buffer, Gpu, GpuError, Recorder, Recording, Submission};

use super::project::Projection;
use super::rasterize::{Forward, SlotRows, Specialisation, SplatBuffers, SplatCounts, SplatSizes};
use super::rows::DeviceGaussians;
use super::uniform::{CameraUniform, NEAR, TILE};
use crate::camera::Camera;
use crate::image::Image;

/// Initial guess of the intersections per Gaussian: most splats touch a few tiles.
pub const TILES_PER_SPLAT: usize = 4;
/// Additional intersections, for small scenes of large splats.
pub const SPARE_INTERSECTIONS: usize = 1 << 14;

/// The forward half of splatting. The number of an image's intersections is known only after
/// drawing; if they did not fit, the buffers grow and the image is drawn again.
pub struct ForwardPass {
    gpu: Gpu,
    pub gaussians: DeviceGaussians,
    /// The projection of the scene by the last camera.
    pub projection: Projection,
    buffers: SplatBuffers,
    forward: Forward,
    gradients: bool,
    /// Number of times the buffers were created.
    generation: u64,
}

/// Commands that stay valid as long as the buffers for which they were recorded.
pub struct PassRecording {
    recording: Recording,
    generation: u64,
}

impl PassRecording {
    /// Submits the commands to the device.
    ///
    /// # Errors
    /// A device error.
    pub fn submit(&self) -> Result<Submission, GpuError> {
        self.recording.submit()
    }
}

impl ForwardPass {
    /// Draws `gaussians` into images of at most `size` = [width, height] px. `gradients`: whether
    /// to allocate the buffers of a backward pass.
    ///
    /// # Errors
    /// Out of memory, or more than the adapter can bind.
    pub fn new(
        gpu: &Gpu,
        gaussians: DeviceGaussians,
        size: [usize; 2],
        gradients: bool,
    ) -> Result<Self, GpuError> {
        let sizes = SplatSizes {
            gaussians: gaussians.capacity,
            width: size[0],
            height: size[1],
            intersections: guess(gpu, gaussians.capacity, size, gradients),
        };
        Ok(Self {
            projection: Projection::new(gpu, gaussians.capacity)?,
            buffers: SplatBuffers::new(gpu, sizes, gradients)?,
            forward: Forward::new(Specialisation::for_adapter(gpu.describe())),
            generation: 0,
            gpu: gpu.clone(),
            gaussians,
            gradients,
        })
    }

    /// The buffers, with the results of the last submission.
    pub fn buffers(&self) -> &SplatBuffers {
        &self.buffers
    }

    /// The uniform of `camera`, with harmonics up to `degree`. The near plane is the same for
    /// training and rendering: a splat culled only in training would be a floater in the views.
    pub fn seen_from(&self, camera: &Camera, degree: u32) -> CameraUniform {
        let allocated = self.gaussians.sh_degree;
        CameraUniform::new(camera, self.gaussians.count, degree, allocated, NEAR)
    }

    /// A recorder that first projects and blends the scene.
    ///
    /// # Errors
    /// A shader or binding error.
    pub fn recorder(&self) -> Result<Recorder, GpuError> {
        let mut recorder = self.gpu.recorder();
        self.projection.record(&mut recorder, &self.gaussians)?;
        self.forward.record(&mut recorder, &self.projection, &self.buffers)?;
        Ok(recorder)
    }

    /// Keeps a recording for repeated submission with the current buffers.
    pub fn keep(&self, recorder: Recorder) -> PassRecording {
        PassRecording { recording: recorder.finish(), generation: self.generation }
    }

    /// Whether the buffers of a recording are still in use.
    pub fn serves(&self, recording: &PassRecording) -> bool {
        recording.generation == self.generation
    }

    /// The image of `camera`, with harmonics up to `degree`. `submit` submits the drawing and
    /// returns the buffer of the resulting image, planar [3, height, width]; it is called again
    /// whenever the intersections did not fit.
    ///
    /// # Errors
    /// A device error, and those of `submit`.
    pub fn image(
        &mut self,
        camera: &Camera,
        degree: u32,
        mut submit: impl FnMut(&Self) -> Result<Buffer<f32>, GpuError>,
    ) -> Result<Image, GpuError> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let uniform = self.seen_from(camera, degree);
        loop {
            self.projection.camera.write(&[uniform])?;
            let image = submit(self)?;
            let counts = self.buffers.counts()?;
            let image = image.start_read(3 * width * height)?;
            let counts = counts.wait()?;
            if !counts.overflowed() {
                return Ok(Image::from_planar(width, height, image.wait()?));
            }
            self.make_room(&counts)?;
        }
    }

    /// Grows the buffers until these intersections fit, with a margin for the next camera.
    ///
    /// # Errors
    /// Out of memory, or more than the adapter can bind.
    pub fn make_room(&mut self, counts: &SplatCounts) -> Result<(), GpuError> {
        let (needed, now) = (counts.intersections, self.buffers.sizes().intersections);
        if needed <= now {
            return Ok(());
        }
        let wanted = (now * 3 / 2).max(needed + needed / 10);
        self.set_room(bounded(&self.gpu, wanted, self.gradients).max(needed))
    }

    /// Recreates the buffers with room for this number of intersections.
    ///
    /// # Errors
    /// As [`ForwardPass::make_room`].
    pub fn set_room(&mut self, intersections: usize) -> Result<(), GpuError> {
        let sizes = SplatSizes { intersections, ..self.buffers.sizes() };
        self.make_buffers(sizes)
    }

    /// Recreates the buffers for images of another size, if it differs.
    ///
    /// # Errors
    /// As [`ForwardPass::make_room`].
    pub fn set_size(&mut self, [width, height]: [usize; 2]) -> Result<(), GpuError> {
        let sizes = self.buffers.sizes();
        let guess = guess(&self.gpu, sizes.gaussians, [width, height], self.gradients);
        let intersections = sizes.intersections.max(guess);
        self.make_buffers(SplatSizes { width, height, intersections, ..sizes })
    }

    fn make_buffers(&mut self, sizes: SplatSizes) -> Result<(), GpuError> {
        if sizes == self.buffers.sizes() {
            return Ok(());
        }
        self.buffers = self.buffers.resized(&self.gpu, sizes, self.gradients)?;
        self.generation += 1;
        Ok(())
    }
}

/// Room for the intersections of the first image.
fn guess(gpu: &Gpu, gaussians: usize, size: [usize; 2], gradients: bool) -> usize {
    let tiles = size.map(|side| side.div_ceil(TILE as usize)).iter().product::<usize>();
    let most = tiles * gaussians.max(1);
    bounded(gpu, most.min(TILES_PER_SPLAT * gaussians + SPARE_INTERSECTIONS), gradients)
}

/// The rows of a backward pass are the first to reach the adapter's binding limit.
fn bounded(gpu: &Gpu, intersections: usize, gradients: bool) -> usize {
    if gradients { intersections.min(SlotRows::most(gpu)) } else { intersections }
}
