// The numbers of one optimiser step. The Rust side is `StepUniform` in
// src/core/reconstruct/optimizer.rs. Imported by the training kernels alone.

struct StepUniform {
    // Rates: means (world units), log-scales, quaternions, opacity logits.
    rates: vec4<f32>,
    // Rates of the constant and of the higher harmonics; bias corrections 1 / (1 - beta^t).
    rate_sh0: f32,
    rate_sh: f32,
    bias_m: f32,
    bias_v: f32,
    // Gradients of the regularisers before the activation's derivative, by Gaussian.
    opacity_weight: f32,
    scale_weight: f32,
    // Scale of the exploration noise on the means; 0 switches it off.
    noise: f32,
    seed: u32,
    step: u32,
    // Slots of the intersection buffers: above it the step is void.
    capacity: u32,
}
