//! The state of one view while its photograph is compared with renders.

use fled_cpu::loss::Noise;

use super::TrainingView;
use super::schedule::reduced_size;
use crate::camera::Camera;
use crate::image::Image;
use crate::mask::Mask;
use crate::noise_levels::NoiseLevels;
use crate::register::Motion;
use crate::shake::ShakeKernel;

/// The photograph of a view as the loss compares it with renders.
pub(super) struct Target {
    pub(super) image: Image,
    /// The pixels that count; all without one.
    pub(super) mask: Option<Mask>,
    pub(super) noise: Noise,
}

/// One view as given, and the model of its camera and shake.
pub(super) struct Observed<'a> {
    given: &'a TrainingView,
    /// The corrected camera, at the size in training.
    camera: Camera,
    /// From the given camera to the corrected one.
    motion: Motion,
    /// At the size in training; still without shake.
    pub(super) kernel: ShakeKernel,
}

impl<'a> Observed<'a> {
    /// The view as given, at its full size.
    pub(super) fn new(given: &'a TrainingView) -> Self {
        let (camera, motion) = (given.camera, Motion::default());
        Self { given, camera, motion, kernel: ShakeKernel::still() }
    }

    pub(super) fn given(&self) -> &'a TrainingView {
        self.given
    }

    /// Width and height in training, px.
    pub(super) fn size(&self) -> [usize; 2] {
        self.camera.size()
    }

    /// Reduces the image by `divisor`, and resets the kernel, which depends on the resolution.
    pub(super) fn reduce(&mut self, divisor: usize) {
        let image = &self.given.image;
        let size = reduced_size(image.width(), image.height(), divisor);
        self.camera = self.full_camera().resized(size.0, size.1);
        self.kernel = ShakeKernel::still();
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

    /// The photograph for the loss, black where it is masked.
    pub(super) fn target(&self) -> Target {
        let size = self.size();
        let (photograph, mask) = (self.photograph(size), self.mask(size));
        // Windows at the border of a mask would see the colours behind it.
        let black = || Image::new(size[0], size[1]);
        let shown = mask.as_ref().map(|mask| mask.composite(&photograph, &black()));
        let noise = self.noise(&photograph);
        Target { image: shown.unwrap_or(photograph), mask, noise }
    }

    /// The noise of the photograph at this size: a mean of pixels has as much less noise as its
    /// side is shorter.
    fn noise(&self, photograph: &Image) -> Noise {
        let Some(NoiseLevels(deviations)) = self.given.noise else {
            return Noise::NONE;
        };
        let scale = photograph.width() as f32 / self.given.image.width() as f32;
        Noise::new(deviations.map(|deviation| deviation * scale))
    }
}
