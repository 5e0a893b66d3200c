//! Splatting and its training on processors: projection, blending, loss, shake, the noise
//! field and optimisers in f32, each with its backward pass.
//!
//! The core's f64 reference is the specification, as for the kernels in WGSL. The same input gives
//! the same bits on every x86-64 processor with AVX2, with any number of threads: each sum has a
//! fixed order, fused multiplications are explicit, and exponentials and logarithms are polynomials
//! of this crate.

pub mod bins;
pub mod blend;
pub mod loss;
pub mod noise;
pub mod population;
pub mod project;
pub mod roofline;
pub mod shake;
mod simd;
pub mod update;
mod vector;

pub use simd::{LANES, Lanes, is_supported, vectors};

/// The camera of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Rigid transform from world to camera (OpenCV axes), three rows of four.
    pub rows: [[f32; 4]; 3],
    /// Focal lengths, px.
    pub focal: [f32; 2],
    /// Principal point, px.
    pub centre: [f32; 2],
    /// Width and height, px.
    pub size: [usize; 2],
    /// Centre of projection, world units.
    pub position: [f32; 3],
    /// Active degree of the spherical harmonics.
    pub sh_degree: u32,
    /// Colour behind all splats, RGB in the image's encoding.
    pub background: [f32; 3],
    /// Depth below which splats are culled, world units.
    pub near: f32,
}

#[cfg(test)]
mod tests;
