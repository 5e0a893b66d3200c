//! What is known of one view while its photograph is compared with renders.

use fled_gpu::{Buffer, Gpu, GpuError};

use super::TrainingView;
use super::loss::upload_target;
use super::schedule::reduced_size;
use crate::camera::Camera;
use crate::image::Image;
use crate::register::Motion;
use crate::shake::DeviceKernel;
use crate::splat::pass::PassRecording;

/// One view: as it was given, and how the scene becomes its photograph.
pub(super) struct Observed<'a> {
    given: &'a TrainingView,
    /// At the size that is trained, where the view was taken from as far as is known.
    camera: Camera,
    /// From the camera as it was given to where the view was taken from.
    motion: Motion,
    /// How it is shaken; `None` where nothing is taken for shaken.
    pub(super) kernel: Option<DeviceKernel>,
    /// The photograph as the loss reads it; made when it is first asked for.
    target: Option<Buffer<u32>>,
    /// A step without the noise field.
    pub(super) recording: Option<PassRecording>,
}

impl<'a> Observed<'a> {
    /// As it was given, at its full size.
    pub(super) fn new(given: &'a TrainingView, kernel: Option<DeviceKernel>) -> Self {
        Self {
            camera: given.camera,
            motion: Motion::default(),
            target: None,
            recording: None,
            given,
            kernel,
        }
    }

    pub(super) fn given(&self) -> &'a TrainingView {
        self.given
    }

    /// Width and height that are trained, px.
    pub(super) fn size(&self) -> [usize; 2] {
        let k = &self.camera.intrinsics;
        [k.width, k.height]
    }

    /// Reduces the image by `divisor`.
    pub(super) fn reduce(&mut self, divisor: usize) {
        let image = &self.given.image;
        let size = reduced_size(image.width(), image.height(), divisor);
        self.camera = self.full_camera().resized(size.0, size.1);
        (self.target, self.recording) = (None, None);
    }

    pub(super) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The camera at the size of the image as it was given.
    pub(super) fn full_camera(&self) -> Camera {
        self.motion.moved(&self.given.camera)
    }

    /// The camera at the size that is trained if the view had been taken from elsewhere.
    pub(super) fn camera_after(&self, motion: &Motion) -> Camera {
        let [width, height] = self.size();
        motion.moved(&self.given.camera).resized(width, height)
    }

    pub(super) fn motion(&self) -> Motion {
        self.motion
    }

    pub(super) fn move_to(&mut self, motion: Motion) {
        self.camera = self.camera_after(&motion);
        self.motion = motion;
    }

    /// The photograph at the size that is trained.
    pub(super) fn photograph(&self) -> Image {
        let [width, height] = self.size();
        self.given.image.resize_area(width, height)
    }

    /// The image that the loss compares with.
    pub(super) fn target(&mut self, gpu: &Gpu) -> Result<Buffer<u32>, GpuError> {
        let target = match self.target.take() {
            Some(target) => target,
            None => upload_target(gpu, &self.photograph())?,
        };
        Ok(self.target.insert(target).clone())
    }
}
