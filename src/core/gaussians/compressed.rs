//! Scenes as compressed PLY files: PlayCanvas' layout, which SuperSplat, Babylon.js, Spark and
//! other viewers read. 16 bytes per Gaussian and one for each higher harmonic, instead of 68 and
//! four in the full layout.
//!
//! Each 256 Gaussians share the ranges in which their numbers are quantised. They are sorted along
//! a space-filling curve, so that each range is small and the error of a number does not depend on
//! the world's scale.

use std::io::{self, Write};

use super::ply::{Scene, comments, in_file};
use super::{Gaussians, Y00};

/// Gaussians that share their ranges.
const CHUNK: usize = 256;

/// The ranges of a chunk, in file order.
const RANGES: [[&str; 3]; 3] =
    [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]];

/// Bits of a coordinate along the curve: 63 in total.
const CURVE_BITS: u32 = 21;

/// Higher harmonics are clamped to plus and minus this.
const LARGEST_HARMONIC: f32 = 4.0;

/// Size of this many Gaussians in bytes, without the header.
pub fn bytes_of(count: usize, sh_degree: u32) -> u64 {
    let harmonics = 3 * ((sh_degree + 1) * (sh_degree + 1) - 1);
    let ranges = 4 * 2 * RANGES.as_flattened().len();
    (count * (16 + harmonics as usize) + count.div_ceil(CHUNK) * ranges) as u64
}

/// Writes the file; Gaussians that are not [usable](Gaussians::is_usable) are left out.
///
/// # Errors
/// Those of the writer.
pub fn write_to(scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
    let gaussians = &*in_file(&scene.gaussians, &scene.normalisation);
    let order = along_curve(gaussians);
    out.write_all(header(order.len(), scene).as_bytes())?;
    let chunks: Vec<Chunk> = order.chunks(CHUNK).map(|rows| Chunk::of(gaussians, rows)).collect();
    for range in chunks.iter().flat_map(|chunk| &chunk.ranges) {
        for value in range.least.iter().chain(&range.greatest) {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    for (chunk, rows) in chunks.iter().zip(order.chunks(CHUNK)) {
        for word in rows.iter().flat_map(|&row| chunk.pack(gaussians, row)) {
            out.write_all(&word.to_le_bytes())?;
        }
    }
    let row = 3 * gaussians.coefficients();
    for index in order {
        let higher = &gaussians.sh[index * row + 3..(index + 1) * row];
        for channel in 0..3 {
            let bytes: Vec<u8> = higher.iter().skip(channel).step_by(3).map(byte).collect();
            out.write_all(&bytes)?;
        }
    }
    out.flush()
}

fn header(count: usize, scene: &Scene) -> String {
    let coefficients = scene.gaussians.coefficients();
    let format = "ply\nformat binary_little_endian 1.0\n".to_owned();
    let mut lines = vec![
        format
            + &comments(&scene.normalisation)
            + &format!("element chunk {}", count.div_ceil(CHUNK)),
    ];
    for names in RANGES {
        for end in ["min", "max"] {
            lines.extend(names.map(|name| format!("property float {end}_{name}")));
        }
    }
    lines.push(format!("element vertex {count}"));
    let packed = ["position", "rotation", "scale", "color"];
    lines.extend(packed.map(|name| format!("property uint packed_{name}")));
    if coefficients > 1 {
        lines.push(format!("element sh {count}"));
        let higher = 3 * (coefficients - 1);
        lines.extend((0..higher).map(|n| format!("property uchar f_rest_{n}")));
    }
    lines.push("end_header\n".to_owned());
    lines.join("\n")
}

/// A higher harmonic as one of 256 steps.
fn byte(value: &f32) -> u8 {
    let share = value / (2.0 * LARGEST_HARMONIC) + 0.5;
    // The cast clamps values outside the range.
    (share * 256.0) as u8
}

/// Indices of the usable Gaussians along the Morton curve: neighbours on it are close in space.
pub(super) fn along_curve(gaussians: &Gaussians) -> Vec<usize> {
    let usable: Vec<usize> =
        (0..gaussians.len()).filter(|&index| gaussians.is_usable(index)).collect();
    let bounds = Range::of(usable.iter().map(|&index| gaussians.means[index]));
    let mut keyed: Vec<(u64, usize)> = usable
        .into_iter()
        .map(|index| {
            let shares = bounds.shares(gaussians.means[index]);
            let [x, y, z] = shares.map(|share| spread(unorm(share, CURVE_BITS)));
            (x | y << 1 | z << 2, index)
        })
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, index)| index).collect()
}

/// The bits of a number, each followed by two zero bits.
fn spread(value: u32) -> u64 {
    (0..CURVE_BITS).fold(0, |spread, bit| spread | u64::from(value >> bit & 1) << (3 * bit))
}

/// A share of one as an integer of `bits` bits.
fn unorm(share: f64, bits: u32) -> u32 {
    let most = (1_u32 << bits) - 1;
    (share.clamp(0.0, 1.0) * f64::from(most)).round() as u32
}

/// Minimum and maximum of three numbers.
struct Range {
    least: [f32; 3],
    greatest: [f32; 3],
}

impl Range {
    fn of(rows: impl Iterator<Item = [f32; 3]>) -> Self {
        let nothing = Self { least: [f32::INFINITY; 3], greatest: [f32::NEG_INFINITY; 3] };
        rows.fold(nothing, |range, row| Self {
            least: std::array::from_fn(|i| range.least[i].min(row[i])),
            greatest: std::array::from_fn(|i| range.greatest[i].max(row[i])),
        })
    }

    /// The relative positions of numbers in their ranges, 0 to 1.
    fn shares(&self, values: [f32; 3]) -> [f64; 3] {
        std::array::from_fn(|i| {
            let (least, greatest) = (f64::from(self.least[i]), f64::from(self.greatest[i]));
            let width = greatest - least;
            let above = f64::from(values[i]) - least;
            if width > 0.0 { above / width } else { 0.0 }
        })
    }
}

/// The ranges of some Gaussians: means, scales, colours.
struct Chunk {
    ranges: [Range; 3],
}

impl Chunk {
    fn of(gaussians: &Gaussians, rows: &[usize]) -> Self {
        let of = |values: &dyn Fn(usize) -> [f32; 3]| Range::of(rows.iter().map(|&r| values(r)));
        Self {
            ranges: [
                of(&|row| gaussians.means[row]),
                of(&|row| gaussians.log_scales[row]),
                of(&|row| colour(gaussians, row)),
            ],
        }
    }

    /// Mean, rotation, scales, colour with opacity.
    fn pack(&self, gaussians: &Gaussians, row: usize) -> [u32; 4] {
        let [means, scales, colours] = &self.ranges;
        let [r, g, b] = colours.shares(colour(gaussians, row));
        // Readers compute a logit, so neither opacity nor transparency may be 0.
        let opacity = unorm(gaussians.opacity(row), 8).clamp(1, 254);
        let rgb = [r, g, b].map(|share| unorm(share, 8));
        [
            pack_11_10_11(means.shares(gaussians.means[row])),
            pack_rotation(gaussians.rotation(row)),
            pack_11_10_11(scales.shares(gaussians.log_scales[row])),
            rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | opacity,
        ]
    }
}

/// The base colour, sRGB, not clamped.
fn colour(gaussians: &Gaussians, row: usize) -> [f32; 3] {
    let at = row * 3 * gaussians.coefficients();
    std::array::from_fn(|channel| 0.5 + Y00 * gaussians.sh[at + channel])
}

fn pack_11_10_11([x, y, z]: [f64; 3]) -> u32 {
    unorm(x, 11) << 21 | unorm(y, 10) << 11 | unorm(z, 11)
}

/// The index of the largest of w, x, y, z, then the three others, which are below the root of a
/// half.
fn pack_rotation(quat: [f64; 4]) -> u32 {
    let largest = (1..4).fold(0, |best, i| if quat[i].abs() > quat[best].abs() { i } else { best });
    // A rotation equals its negative: make the largest positive, so it need not be stored.
    let sign = quat[largest].signum();
    let others = (0..4).filter(|&i| i != largest);
    others.fold(largest as u32, |packed, i| {
        let share = quat[i] * sign * std::f64::consts::FRAC_1_SQRT_2 + 0.5;
        packed << 10 | unorm(share, 10)
    })
}

#[cfg(test)]
mod tests;
