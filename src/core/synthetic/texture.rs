//! Albedo: painted corners and blobs at every scale, so that features exist near and far, sharp and
//! blurred; or photographs on the walls.

use glam::{DVec2, IVec2};

use crate::image::{Image, Linear};

/// A reproducible number in 0..1 for a cell and a salt.
pub(super) fn hash(cell: IVec2, salt: u32) -> f64 {
    let mut h = (cell.x as u32).wrapping_mul(0x9e37_79b1)
        ^ (cell.y as u32).wrapping_mul(0x85eb_ca77).rotate_left(13)
        ^ salt.wrapping_mul(0xc2b2_ae3d);
    for _ in 0..2 {
        h ^= h >> 15;
        h = h.wrapping_mul(0x2c1b_3c6d);
        h ^= h >> 12;
        h = h.wrapping_mul(0x297a_2d39);
    }
    h ^= h >> 15;
    f64::from(h) / f64::from(u32::MAX)
}

/// The cell of `p` in a grid with cells of `size`, and the position in it, 0..1.
pub(super) fn cell(p: DVec2, size: f64) -> (IVec2, DVec2) {
    let scaled = p / size;
    let floor = scaled.floor();
    (floor.as_ivec2(), scaled - floor)
}

/// Smooth values between 0 and 1, which change by up to one over a distance of 1.
fn smooth(p: DVec2, salt: u32) -> f64 {
    let (corner, inside) = cell(p, 1.0);
    let share = inside * inside * (3.0 - 2.0 * inside);
    let row = |y: i32| {
        let at = |x: i32| hash(corner + IVec2::new(x, y), salt);
        at(0) + share.x * (at(1) - at(0))
    };
    row(0) + share.y * (row(1) - row(0))
}

/// Like `smooth`, with detail down to an eighth: 0 to 1, rarely near either.
pub(super) fn rough(p: DVec2, salt: u32) -> f64 {
    let octave = |n: i32| smooth(p * 2f64.powi(n), salt.wrapping_add(n as u32)) * 0.5f64.powi(n);
    (0..4).map(octave).sum::<f64>() / 1.875
}

/// One layer: each cell has a disc or a rotated square of random position, size and tone, or
/// nothing.
fn shapes(p: DVec2, size: f64, salt: u32) -> Option<[f64; 3]> {
    let (cell, inside) = cell(p, size);
    let random = |k: u32| hash(cell, salt.wrapping_mul(31).wrapping_add(k));
    if random(0) < 0.25 {
        return None;
    }
    let centre = DVec2::new(0.35 + 0.3 * random(1), 0.35 + 0.3 * random(2));
    let radius = 0.15 + 0.18 * random(3);
    let offset = DVec2::from_angle(random(4) * std::f64::consts::TAU).rotate(inside - centre);
    let within = match random(5) < 0.5 {
        true => offset.length() < radius,
        false => offset.abs().max_element() < 0.8 * radius,
    };
    within.then(|| {
        let tone = if random(6) < 0.5 { 0.03 + 0.12 * random(7) } else { 0.55 + 0.4 * random(7) };
        [random(8), random(9), random(10)].map(|tint| tone * (0.6 + 0.4 * tint))
    })
}

/// Albedo, linear light, at `p` in world units of a surface. The finest layer is on top.
///
/// Cell sizes differ by factors of about 2.4, from a quarter of a wall to the few centimetres that
/// a close camera resolves; `scale` multiplies them all.
pub(super) fn albedo(p: DVec2, base: [f64; 3], salt: u32, scale: f64) -> [f64; 3] {
    let layers = [1.9, 0.8, 0.34, 0.145];
    let seen = layers.iter().enumerate().rev().find_map(|(index, size)| {
        let turned = DVec2::from_angle(0.5 * index as f64 + f64::from(salt)).rotate(p);
        shapes(turned, size * scale, salt.wrapping_add(17 * index as u32))
    });
    seen.unwrap_or(base)
}

/// Albedo, linear light, at `p` in world units of a surface tiled with one of `photographs`
/// (selected by `salt`), every second one mirrored so that no seam shows. A photograph's pixel is
/// `TEXEL * scale` world units wide.
pub(super) fn wallpaper(
    p: DVec2,
    photographs: &[Image<Linear>],
    salt: u32,
    scale: f64,
) -> [f64; 3] {
    let random = |k: i32| hash(IVec2::new(k, -1), salt);
    let photograph =
        &photographs[(random(0) * photographs.len() as f64) as usize % photographs.len()];
    let along = |position: f64, side: usize| {
        let side = side as f64;
        let turned = position.rem_euclid(2.0 * side);
        turned.min(2.0 * side - turned)
    };
    let texels = p / (TEXEL * scale) + 1000.0 * DVec2::new(random(1), random(2));
    let (x, y) = (along(texels.x, photograph.width()), along(texels.y, photograph.height()));
    photograph.sample(x as f32, y as f32).map(|value| WALLPAPER_WHITE * f64::from(value))
}

/// Side of a photograph's pixel on a wall, world units.
const TEXEL: f64 = 0.01;

/// Albedo of a surface where its photograph is white.
const WALLPAPER_WHITE: f64 = 0.9;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roughness_is_bounded_and_has_no_steps() {
        let at = |i: i32| rough(DVec2::new(0.01 * f64::from(i), 0.3), 5);
        let values: Vec<f64> = (-500..500).map(at).collect();
        assert!(values.iter().all(|v| (0.0..=1.0).contains(v)));
        let steps = values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        assert!(steps.fold(0.0, f64::max) < 0.05);
        let (low, high) = (
            values.iter().copied().fold(1.0, f64::min),
            values.iter().copied().fold(0.0, f64::max),
        );
        assert!(low < 0.45 && high > 0.65, "{low} to {high}");
    }

    #[test]
    fn wallpaper_has_no_seams_and_may_be_one_pixel() {
        let mut photograph = Image::<Linear>::new(5, 3);
        for (x, y) in (0..15).map(|i| (i % 5, i / 5)) {
            photograph.set(x, y, [0.2 * x as f32, 0.4 * y as f32, 0.5]);
        }
        let at = |p: DVec2| wallpaper(p, std::slice::from_ref(&photograph), 7, 1.0);
        // Neighbouring points differ by no more than in the photograph, over three repetitions of
        // it.
        for step in 0..300 {
            let p = 0.001 * f64::from(step) * DVec2::ONE;
            let (a, b) = (at(p), at(p + 0.001));
            let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < 0.1 * 0.4 * WALLPAPER_WHITE + 1e-6, "{apart} at {p}");
        }
        let reds: Vec<f64> =
            (0..100).map(|i| at(DVec2::new(0.003 * f64::from(i), 0.0))[0]).collect();
        let (low, high) =
            (reds.iter().copied().fold(1.0, f64::min), reds.iter().copied().fold(0.0, f64::max));
        assert!(low < 0.01 && high > 0.7, "the whole photograph is shown: {low} to {high}");
        let grey = Image::from_planar(1, 1, vec![0.5; 3]);
        assert_eq!(wallpaper(DVec2::new(-3.0, 8.0), &[grey], 1, 1.0), [0.45; 3]);
    }
}
