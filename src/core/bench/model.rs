//! How many bytes a kernel has to move and how many operations it has to make, from counts.
//!
//! This is the one place that says so. Both are what the work asks for, not what a device was seen
//! to do:
//!
//! - **Bytes**: every value that a dispatch needs from memory counts once when it is read and once
//!   when it is written, as if caches were perfect inside a dispatch; what is fetched through an
//!   index (the row of a splat for every intersection) counts once a fetch. Uniforms do not count.
//!   Where Gaussians may be culled before their harmonics are read, those that touch a tile count:
//!   a lower bound.
//! - **Operations**: additions, multiplications, divisions, minima, roots and exponentials of
//!   floating-point numbers, one each (a fused multiply-add is two). Comparisons, choices, signs
//!   and integers count nothing, so kernels that only sort have 0. What neighbouring invocations
//!   compute twice (the rims of a window) counts once: a kernel that repeats work has a smaller
//!   share of the device for it.
//! - **Nothing is guessed**: `None` where the number depends on what nobody counts, such as the
//!   tiles of a splat's box that are tested and not touched.

use crate::noise::NoiseWork;
use crate::splat::rasterize::{SLOT_ROW, SplatWork};
use crate::splat::rows::GEOMETRY_ROW;
use crate::splat::sort::BLOCK;
use serde::Serialize;

/// Bytes of a number.
const WORD: u64 = 4;
/// Bytes of the projected row of a Gaussian.
const PROJECTED: u64 = 48;
/// Values of a digit of the sort.
const DIGITS: u64 = 16;
/// Operations a pair of pixel and splat, counted in shaders/shared/raster_pixels.wgsl: offset 1,
/// exponent 4, alpha 3, transmittance 2, weight 1, colour 6.
const BLEND: u64 = 17;
/// The same of shaders/shared/raster_pixels_backward.wgsl: offset 1, exponent 4, alpha 3,
/// transmittance 2, weight 1, gradient along the colour 5, rest 2, by alpha 3, v 1, sums of colour
/// 6, v 1, v dx 2, v dx^2 3. Reductions do not count.
const BLEND_BACKWARD: u64 = 34;
/// Operations a value of a separable window of 11, one plane: 6 products and 10 sums, twice.
const WINDOW: u64 = 32;
/// Operations a value in shaders/train/loss_similarity.wgsl: 4 for x^2 + y^2 and x y, four windows,
/// 30 for SSIM, its derivatives and the sum.
const SIMILARITY: u64 = 4 + 4 * WINDOW + 30;
/// In shaders/train/loss_gradient.wgsl: three windows, 12 for the gradient and the sums of errors.
const GRADIENT: u64 = 3 * WINDOW + 12;
/// Operations in shaders/shake: a value and a tap of a pixel of blur.wgsl, the same of
/// blur_backward.wgsl (four neighbours of 6 operations each among them), a value of linearise.wgsl.
const BLUR: [u64; 2] = [9, 7];
const BLUR_BACK: [u64; 2] = [32, 6];
const LINEARISE: u64 = 6;
/// Operations a number in shaders/noise/adam.wgsl beside the sum over segments: m 3, v 4, update 6.
const NOISE_ADAM: u64 = 13;

/// What a step had to do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Work {
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Coefficients of the harmonics a channel.
    pub coefficients: usize,
    /// Pixels of the image.
    pub pixels: usize,
    /// Keys that are sorted by themselves, and in how many passes.
    pub keys: usize,
    /// See `keys`.
    pub key_passes: usize,
    /// What was sorted and blended.
    pub splat: Option<SplatWork>,
    /// What the noise field saw.
    pub noise: Option<NoiseWork>,
    /// Taps of the kernel by which the view is shaken.
    pub taps: Option<usize>,
}

/// What one kernel has to do in a step, all its dispatches together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Cost {
    /// Bytes from and to memory.
    pub bytes: Option<u64>,
    /// Floating-point operations.
    pub operations: Option<u64>,
}

impl Cost {
    fn bytes(bytes: u64) -> Self {
        Self {
            bytes: Some(bytes),
            operations: None,
        }
    }

    /// Of a kernel that computes with integers alone.
    fn integers(bytes: u64) -> Self {
        Self {
            bytes: Some(bytes),
            operations: Some(0),
        }
    }

    fn both(bytes: u64, operations: u64) -> Self {
        Self {
            bytes: Some(bytes),
            operations: Some(operations),
        }
    }
}

impl Work {
    /// The cost of the kernel of this name; unknown for a kernel that is not in the model.
    pub fn cost(&self, kernel: &str) -> Cost {
        let (family, verb) = kernel.split_once('/').unwrap_or(("", kernel));
        match (family, &self.splat, &self.noise) {
            ("sort", _, _) => self.sort(verb),
            ("splat" | "train", Some(splat), _)
                if verb != "loss_similarity" && verb != "loss_gradient" =>
            {
                self.splat(verb, splat)
            }
            ("train", _, _) => self.loss(verb),
            ("noise", _, Some(noise)) => self.noise(verb, noise),
            ("shake", _, _) => self
                .taps
                .map_or(Cost::default(), |taps| self.shake(verb, taps as u64)),
            _ => Cost::default(),
        }
    }

    /// Keys and passes of every sort of the step.
    fn sorts(&self) -> Vec<[u64; 2]> {
        let mut sorts = vec![[self.keys as u64, self.key_passes as u64]];
        if let Some(splat) = &self.splat {
            sorts.push([splat.visible as u64, splat.passes[0] as u64]);
            sorts.push([splat.intersections as u64, splat.passes[1] as u64]);
        }
        sorts
    }

    fn sort(&self, verb: &str) -> Cost {
        let sum = |each: &dyn Fn(u64) -> u64| {
            self.sorts()
                .iter()
                .map(|[n, passes]| passes * each(*n))
                .sum()
        };
        let histogram = |n: u64| WORD * DIGITS * blocks(n);
        match verb {
            "radix_count" => Cost::integers(sum(&|n| WORD * n + histogram(n))),
            "radix_scatter" => Cost::integers(sum(&|n| 4 * WORD * n + histogram(n))),
            "scan" => {
                let sums = self.splat.map_or(0, |s| {
                    blocks(self.gaussians as u64) + blocks(s.visible as u64)
                });
                Cost::integers(sum(&|n| 2 * histogram(n)) + 2 * WORD * sums)
            }
            _ => Cost::default(),
        }
    }

    fn splat(&self, verb: &str, splat: &SplatWork) -> Cost {
        let n = self.gaussians as u64;
        let [visible, slots] = [splat.visible as u64, splat.intersections as u64];
        let [walked, pairs] = [splat.walked as u64 / 2, splat.pairs() as u64];
        let (pixels, tiles) = (self.pixels as u64, splat.tiles as u64);
        let row = WORD * GEOMETRY_ROW as u64;
        let sh = WORD * 3 * self.coefficients as u64;
        // The slot, its Gaussian and the Gaussian's row, of every intersection that is looked at.
        let list = walked * (2 * WORD + PROJECTED) + 8 * tiles;
        match verb {
            // Geometry, harmonics; the count and key of all, the row of the visible.
            "project_forward" => Cost::bytes(n * (row + 2 * WORD) + visible * (sh + PROJECTED)),
            "count_visible" => Cost::integers(n * WORD + WORD * blocks(n)),
            "compact_visible" => Cost::integers(n * WORD + visible * 3 * WORD + WORD * blocks(n)),
            "count_slots" => Cost::integers(visible * 2 * WORD + WORD * blocks(visible)),
            "assign_slots" => Cost::integers(visible * 3 * WORD + WORD * blocks(visible)),
            "emit" => Cost::bytes(visible * (3 * WORD + PROJECTED) + slots * 3 * WORD),
            // Two binary searches a tile, and the range.
            "tile_ranges" => {
                let steps = u64::from(u64::BITS - slots.leading_zeros());
                Cost::integers((tiles + 1) * (2 * WORD * steps + 2 * WORD))
            }
            // Colour and transmittance a pixel.
            "rasterize" | "rasterize_walk" => {
                Cost::both(list + pixels * 4 * WORD + tiles * WORD, pairs * BLEND)
            }
            // Colour and gradient a pixel; a row of nine a slot, whether it is looked at or not.
            "rasterize_backward" | "rasterize_backward_walk" | "rasterize_backward_generic" => {
                let rows = slots * WORD * SLOT_ROW as u64 + (slots - walked.min(slots)) * WORD;
                let operations =
                    (verb != "rasterize_backward_walk").then_some(pairs * BLEND_BACKWARD);
                Cost {
                    bytes: Some(list + pixels * 6 * WORD + tiles * WORD + rows),
                    operations,
                }
            }
            // Rows of slots; parameters and both moments in and out: 11 of the 12 numbers of a row
            // are in use.
            "project_backward_adam" => {
                let numbers = (row - WORD) + sh;
                Cost::bytes(
                    n * (WORD + 6 * numbers) + visible * WORD + slots * WORD * SLOT_ROW as u64,
                )
            }
            _ => Cost::default(),
        }
    }

    fn loss(&self, verb: &str) -> Cost {
        let values = 3 * self.pixels as u64;
        // The target has two bytes a value.
        match verb {
            "loss_similarity" => Cost::both(values * (WORD + 2 + 3 * WORD), values * SIMILARITY),
            "loss_gradient" => Cost::both(values * (WORD + 2 + 3 * WORD + WORD), values * GRADIENT),
            _ => Cost::default(),
        }
    }

    fn shake(&self, verb: &str, taps: u64) -> Cost {
        let (pixels, values) = (self.pixels as u64, 3 * self.pixels as u64);
        let operations = |[value, tap]: [u64; 2]| values * value + pixels * taps * tap;
        match verb {
            "linearise" => Cost::both(values * 2 * WORD, values * LINEARISE),
            // Light in, the blurred value and its slope out.
            "blur" => Cost::both(values * 3 * WORD, operations(BLUR)),
            "scale" => Cost::both(values * 3 * WORD, values),
            "blur_backward" => Cost::both(values * 3 * WORD, operations(BLUR_BACK)),
            _ => Cost::default(),
        }
    }

    fn noise(&self, verb: &str, noise: &NoiseWork) -> Cost {
        let [cells, pixels] = [noise.cells as u64, noise.pixels as u64];
        let [chunks, segments] = [noise.chunks as u64, noise.segments as u64];
        let parameters = WORD * noise.parameters as u64;
        let forwards = if chunks > 1 { 2 } else { 1 };
        let layers = |first: usize, each: fn(u64, u64) -> u64| -> u64 {
            noise
                .layers
                .iter()
                .skip(first)
                .map(|[i, o]| each(*i as u64, *o as u64))
                .sum()
        };
        let products = |first| cells * layers(first, |i, o| 2 * i * o);
        let activations = |first, each| cells * WORD * layers(first, each);
        let four = 4 * WORD;
        match verb {
            "layer_forward" | "layer_forward_subgroup" => Cost::both(
                forwards * (activations(0, |i, o| i + o) + chunks * parameters),
                forwards * products(0),
            ),
            // The first chunk writes the gradients, the others add to them.
            "layer_weights" | "layer_weights_subgroup" => Cost::both(
                activations(0, |i, o| i + o)
                    + parameters * segments * (2 * chunks).saturating_sub(1),
                products(0),
            ),
            // The first layer's inputs need no derivative; the others are read for their ReLU and
            // written.
            "layer_backward" | "layer_backward_subgroup" => Cost::both(
                activations(1, |i, o| 2 * i + o) + chunks * parameters,
                products(1),
            ),
            // The position's encoding, and the direction's beside the features.
            "encode" => {
                let width = |layer: usize, side: usize| {
                    noise.layers.get(layer).map_or(0, |l| l[side] as u64)
                };
                let direction = width(5, 0).saturating_sub(width(4, 1));
                Cost::bytes(forwards * cells * WORD * (width(0, 0) + direction))
            }
            "activate" => Cost::bytes(cells * 2 * four),
            "compose" => Cost::bytes(pixels * 6 * WORD + cells * four),
            "gather" => Cost::bytes(pixels * 3 * WORD + cells * 2 * four),
            "output_delta" => Cost::bytes(cells * 3 * four),
            "adam" => {
                let numbers = noise.parameters as u64;
                Cost::both(
                    parameters * (segments + 6),
                    numbers * (segments + NOISE_ADAM),
                )
            }
            // In mode `Grid` alone: the mean of the map and the sum of its gradient.
            "reduce" => Cost::bytes(2 * cells * four),
            _ => Cost::default(),
        }
    }
}

/// Blocks of the sort.
fn blocks(n: u64) -> u64 {
    n.div_ceil(BLOCK as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPLAT: SplatWork = SplatWork {
        visible: 1_500,
        intersections: 5_000,
        tiles: 20,
        walked: 8_000,
        passes: [8, 2],
    };

    fn work() -> Work {
        let (gaussians, coefficients, pixels) = (2_000, 16, 5_120);
        Work {
            gaussians,
            coefficients,
            pixels,
            splat: Some(SPLAT),
            ..Work::default()
        }
    }

    #[test]
    fn bytes_of_the_kernels_equal_a_count_by_hand() {
        let bytes = |kernel| work().cost(kernel).bytes;
        // 2,000 x (48 + 8) + 1,500 x (192 + 48).
        assert_eq!(bytes("splat/project_forward"), Some(472_000));
        // 4,000 x (4 + 4 + 48) + 20 x 8 ranges + 5,120 x 16 + 20 x 4.
        assert_eq!(bytes("splat/rasterize"), Some(306_160));
        // The same list, 5,120 x 24, 20 x 4, 5,000 rows of 36, 1,000 slots that nobody looked at.
        assert_eq!(bytes("splat/rasterize_backward"), Some(531_120));
        // 2,000 x (4 + 6 x (44 + 192)) + 1,500 x 4 + 5,000 x 36.
        assert_eq!(bytes("train/project_backward_adam"), Some(3_026_000));
        // 8 x (1,500 x 16 + 64 x 2) + 2 x (5,000 x 16 + 64 x 5).
        assert_eq!(bytes("sort/radix_scatter"), Some(353_664));
        // 15,360 values: prediction 4, target 2, derivatives 12.
        assert_eq!(bytes("train/loss_similarity"), Some(276_480));
    }

    #[test]
    fn operations_equal_a_count_by_hand() {
        let operations = |kernel| work().cost(kernel).operations;
        assert_eq!(operations("splat/rasterize"), Some(4_000 * 256 * 17));
        assert_eq!(operations("train/loss_gradient"), Some(15_360 * 108));
        assert_eq!(operations("sort/scan"), Some(0));
    }

    #[test]
    fn the_noise_field_multiplies_every_weight_for_every_cell() {
        let noise = NoiseWork {
            pixels: 640,
            cells: 10,
            chunks: 1,
            segments: 1,
            parameters: 72,
            layers: vec![[4, 8], [8, 4]],
        };
        let one = Work {
            noise: Some(noise.clone()),
            ..Work::default()
        };
        // 10 cells x 2 x (32 + 32), and only the second layer backwards.
        assert_eq!(one.cost("noise/layer_forward").operations, Some(1_280));
        assert_eq!(one.cost("noise/layer_backward").operations, Some(640));
        // 10 x 4 x (12 + 12) + 72 x 4.
        assert_eq!(one.cost("noise/layer_forward").bytes, Some(1_248));
        let two = Work {
            noise: Some(NoiseWork { chunks: 2, ..noise }),
            ..Work::default()
        };
        assert_eq!(two.cost("noise/layer_forward").operations, Some(2_560));
        assert_eq!(two.cost("noise/layer_weights").operations, Some(1_280));
    }

    #[test]
    fn a_shaken_view_costs_by_the_tap() {
        let of = |taps| {
            Work {
                pixels: 100,
                taps,
                ..Work::default()
            }
            .cost("shake/blur")
        };
        // 300 values of 12 bytes and 9 operations; 100 pixels of 5 taps of 7 operations.
        assert_eq!(of(Some(5)), Cost::both(3_600, 6_200));
        assert_eq!(of(None), Cost::default());
    }

    #[test]
    fn what_nobody_counts_is_not_known() {
        assert_eq!(work().cost("splat/emit").operations, None);
        assert_eq!(work().cost("train/relocate"), Cost::default());
        assert_eq!(Work::default().cost("splat/rasterize"), Cost::default());
    }
}
