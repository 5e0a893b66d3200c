//! How many intersections a step may have.

use fled_gpu::Buffer;

/// Where the step's count of intersections lies, and how many fit: a step that was blended from a
/// part of them teaches the field nothing.
pub struct IntersectionLimit<'a> {
    /// Counters of the step.
    pub counters: &'a Buffer<u32>,
    /// Where among them their number stands.
    pub total_at: u32,
    /// Most that fit.
    pub capacity: u32,
}
