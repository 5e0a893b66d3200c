//! The training images of a round.

use crate::camera::Camera;
use crate::image::Image;

/// One training image.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// Name for messages.
    pub name: String,
    /// Its camera, at the size of the image.
    pub camera: Camera,
    /// sRGB-encoded.
    pub image: Image,
    /// Whether a kernel may explain its shake, if the round has kernels.
    pub has_kernel: bool,
}
