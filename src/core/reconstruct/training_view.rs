//! What a round is trained on.

use crate::camera::Camera;
use crate::image::Image;

/// One image to train on.
#[derive(Clone, Debug)]
pub struct TrainingView {
    /// For messages.
    pub name: String,
    /// Its camera, at the size of the image.
    pub camera: Camera,
    /// sRGB-encoded.
    pub image: Image,
    /// Whether a kernel may explain its shake, where the round has kernels at all.
    pub has_kernel: bool,
}
