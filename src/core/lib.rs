//! The FLED-GS pipeline: from dark, noisy, shaken photographs of a static scene to a bright,
//! sharp 3D Gaussian splatting scene.
//!
//! Data flows one way: [`pipeline`] drives [`colmap`], [`enhance`], [`deblur`], [`reconstruct`]
//! (which drives [`splat`], [`noise`], [`shake`] and [`register`]), [`exposure`], [`metrics`] and
//! [`render`]. [`export`] and [`video`] hand a result on; [`mesh`] makes triangles of it.
//! Siblings never import each other; all may use [`image`], [`camera`], [`poses`], [`photo_path`],
//! [`gaussians`], [`event`], [`cancel`], [`plain`] and [`reading`]. The crate uses no HTTP, no SQL,
//! no async runtime and no environment variables.

#[cfg(test)]
mod agreement;
pub mod colmap;
pub mod deblur;
pub mod device;
pub mod enhance;
pub mod event;
pub mod export;
pub mod exposure;
pub mod features;
pub mod gaussians;
pub mod given_poses;
pub mod inference;
pub mod mesh;
pub mod metrics;
pub mod noise;
pub mod noise_levels;
pub mod pipeline;
pub mod poses;
mod random;
pub mod reading;
pub mod reconstruct;
pub mod register;
pub mod render;
pub mod run_folder;
pub mod shake;
pub mod splat;
pub mod synthetic;
pub mod video;

pub use fled_capture::{camera, cancel, capture, dataset, group, image, mask, photo_path, plain};
use fled_capture::{ffmpeg, linear};
