// A part of the Gaussians, as many as the adapter binds at once. The Rust side is `PartUniform` in
// src/core/splat/project.rs. An array in parts is indexed from the part's first Gaussian.

struct PartUniform {
    first: u32,
    rows: u32,
    pad_0: u32,
    pad_1: u32,
}
