//! The limit on a step's intersections.

use fled_gpu::Buffer;

/// The place of the step's count of intersections, and the room for them. A step that was blended
/// from only a part of them does not update the field.
pub struct IntersectionLimit<'a> {
    /// Counters of the step.
    pub counters: &'a Buffer<u32>,
    /// Index of the count of intersections among them.
    pub total_at: u32,
    /// Largest count that fits.
    pub capacity: u32,
}
