//! Splatting: from Gaussians and a camera to an image, and the gradients back.

#[cfg(test)]
pub(crate) mod compare;
#[cfg(test)]
pub(crate) mod fixtures;
pub mod pass;
pub mod processor;
pub mod project;
pub mod rasterize;
pub mod reference;
pub mod rows;
pub mod sort;
pub mod uniform;
