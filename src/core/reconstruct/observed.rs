//! The state of one view while its photograph is compared with renders.

use fled_gpu::{Buffer, Gpu, GpuError};

use super::TrainingView;
use super::loss::{upload_mask, upload_target};
use super::schedule::reduced_size;
use crate::camera::Camera;
use crate::image::Image;
use crate::mask::Mask;
use crate::register::Motion;
use crate::shake::DeviceKernel;
use crate::splat::pass::PassRecording;

/// One view as given, and the model of its camera and shake.
pub(super) struct Observed<'a> {
    given: &'a TrainingView,
    /// The corrected camera, at the size in training.
    camera: Camera,
    /// From the given camera to the corrected one.
    motion: Motion,
    /// `None` without shake.
    pub(super) kernel: Option<DeviceKernel>,
    /// The packed photograph for the loss, created on first use.
    target: Option<Buffer<u32>>,
    /// The packed mask for the loss, created on first use; `None` without one.
    kept: Option<Buffer<u32>>,
    /// The recording of a step without the noise field.
    pub(super) recording: Option<PassRecording>,
}

impl<'a> Observed<'a> {
    /// The view as given, at its full size.
    pub(super) fn new(given: &'a TrainingView, kernel: Option<DeviceKernel>) -> Self {
        Self {
            camera: given.camera,
            motion: Motion::default(),
            target: None,
            kept: None,
            recording: None,
            given,
            kernel,
        }
    }

    pub(super) fn given(&self) -> &'a TrainingView {
        self.given
    }

    /// Width and height in training, px.
    pub(super) fn size(&self) -> [usize; 2] {
        let k = &self.camera.intrinsics;
        [k.width, k.height]
    }

    /// Reduces the image by `divisor`.
    pub(super) fn reduce(&mut self, divisor: usize) {
        let image = &self.given.image;
        let size = reduced_size(image.width(), image.height(), divisor);
        self.camera = self.full_camera().resized(size.0, size.1);
        (self.target, self.kept, self.recording) = (None, None, None);
    }

    pub(super) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The corrected camera, at the full size of the image.
    pub(super) fn full_camera(&self) -> Camera {
        self.motion.moved(&self.given.camera)
    }

    /// The camera at this size in px after `motion` of the given camera.
    pub(super) fn camera_after(&self, motion: &Motion, [width, height]: [usize; 2]) -> Camera {
        motion.moved(&self.given.camera).resized(width, height)
    }

    pub(super) fn motion(&self) -> Motion {
        self.motion
    }

    pub(super) fn move_to(&mut self, motion: Motion) {
        self.camera = self.camera_after(&motion, self.size());
        self.motion = motion;
    }

    /// The photograph at this size in px.
    pub(super) fn photograph(&self, [width, height]: [usize; 2]) -> Image {
        self.given.image.resize_area(width, height)
    }

    /// The pixels that count at this size in px; `None` where all do.
    pub(super) fn mask(&self, [width, height]: [usize; 2]) -> Option<Mask> {
        self.given.mask.as_ref().map(|mask| mask.resized(width, height))
    }

    /// The packed mask for the loss, where there is one.
    pub(super) fn kept(&mut self, gpu: &Gpu) -> Result<Option<Buffer<u32>>, GpuError> {
        if self.kept.is_none()
            && let Some(mask) = self.mask(self.size())
        {
            self.kept = Some(upload_mask(gpu, &mask)?);
        }
        Ok(self.kept.clone())
    }

    /// The packed photograph for the loss, black where it is masked.
    pub(super) fn target(&mut self, gpu: &Gpu) -> Result<Buffer<u32>, GpuError> {
        let target = match self.target.take() {
            Some(target) => target,
            None => {
                let size = self.size();
                let photograph = self.photograph(size);
                let black = || Image::new(size[0], size[1]);
                // Windows at the border of a mask would see the colours behind it.
                let shown = self.mask(size).map(|mask| mask.composite(&photograph, &black()));
                upload_target(gpu, &shown.unwrap_or(photograph))?
            }
        };
        Ok(self.target.insert(target).clone())
    }
}
