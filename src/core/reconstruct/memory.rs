//! How much memory training needs on a device.

use crate::splat::pass::{SPARE_INTERSECTIONS, TILES_PER_SPLAT};
use crate::splat::rasterize::SLOT_ROW;
use crate::splat::rows::{GEOMETRY_ROW, sh_row};

/// Bytes of a float, a count or an index.
const WORD: u64 = 4;
/// Words of a Gaussian for drawing: its projection (14), its first intersection, and the two pairs
/// of keys and payloads that sort it by depth.
const DRAWN: u64 = 19;
/// Words of an intersection for drawing: the pairs that sort it by tile, and its Gaussian.
const INTERSECTED: u64 = 5;
/// How many times as many intersections as at first there is room for at the peak: the buffers grow
/// when an image has more than they hold.
const GROWN: u64 = 2;
/// Words of a pixel for drawing: colour and transmittance.
const SHOWN: u64 = 4;
/// Words of a pixel for comparing: prediction, gradient and derivatives of the loss, and of the
/// shake light, factor, blurred render and its gradient.
const COMPARED: u64 = 9 + 8;

/// Bytes that training needs at its peak for `gaussians` of this degree, images of at most
/// `largest` pixels, and views of `all` pixels together. What the user looks at meanwhile is drawn
/// in buffers of its own.
pub fn device_bytes(gaussians: u64, sh_degree: u32, largest: u64, all: u64) -> u64 {
    // The parameters with Adam's two moments.
    let parameters = 3 * (GEOMETRY_ROW + sh_row(sh_degree)) as u64;
    let at_first = TILES_PER_SPLAT as u64 * gaussians + SPARE_INTERSECTIONS as u64;
    // A photograph is packed into one word a pixel.
    let words = gaussians * (parameters + 2 * DRAWN)
        + GROWN * at_first * (2 * INTERSECTED + SLOT_ROW as u64)
        + largest * (2 * SHOWN + COMPARED)
        + all;
    WORD * words
}
