//! Splatting: from Gaussians and a camera to an image, and the gradients back.

pub mod reference;
pub mod sort;
pub mod uniform;
