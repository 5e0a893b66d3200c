//! The self-test of the networks, run for every library and machine before a capture: they must
//! find the same key points in a picture and in a shifted one.

use super::extractor::Extractor;
use super::matcher::Matcher;
use crate::image::Image;

/// Size of the pictures, px.
const SIZE: [u32; 2] = [160, 128];

/// Shift of the second picture, px: whole cells of the networks, for which the input is the same.
const MOVED: [u32; 2] = [16, 8];

/// Number of key points in each.
const KEY_POINTS: usize = 256;

/// Least number of matches.
const LEAST_MATCHES: usize = 40;

/// Least share of matches within 1.5 px of the shift.
const LEAST_RIGHT: f64 = 0.75;

/// Matches two pictures of a painted plane.
///
/// # Errors
/// A sentence if the networks' results are wrong or they do not run.
pub(super) fn run(extractor: &mut Extractor, matcher: &mut Matcher) -> Result<(), String> {
    let [first, second] = [[0, 0], MOVED].map(picture);
    let first = extractor.key_points(&first, KEY_POINTS)?;
    let second = extractor.key_points(&second, KEY_POINTS)?;
    let matches = matcher.matches(&first, &second)?;
    let is_right = |(a, b): (u32, u32)| {
        let [from, to] = [first.positions[a as usize], second.positions[b as usize]];
        let off: [f32; 2] = [0, 1].map(|axis| from[axis] - to[axis] - MOVED[axis] as f32);
        off[0].hypot(off[1]) < 1.5
    };
    let right = matches.iter().filter(|m| is_right((m.first, m.second))).count();
    let enough = LEAST_MATCHES.max((LEAST_RIGHT * matches.len() as f64) as usize);
    if right >= enough {
        return Ok(());
    }
    Err(format!(
        "of {} matches between a picture and the same one moved {right} are right: this library of \
         ONNX Runtime computes something else",
        matches.len()
    ))
}

/// A section of the plane.
fn picture(corner: [u32; 2]) -> Image {
    let [width, height] = SIZE;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let values: Vec<f32> =
        pixels.map(|(x, y)| plane(corner[0] + x, corner[1] + y) as f32 / 255.0).collect();
    Image::from_planar(width as usize, height as usize, [&*values, &values, &values].concat())
}

fn hash(mut n: u32) -> u32 {
    n ^= n >> 16;
    n = n.wrapping_mul(0x7FEB_352D);
    n ^= n >> 15;
    n = n.wrapping_mul(0x846C_A68B);
    n ^ (n >> 16)
}

/// The level, 0..256, of a pixel of a painted plane with tiles, spots and grain.
pub(super) fn plane(u: u32, v: u32) -> u32 {
    let at = |salt: u32, i: u32, j: u32| hash((salt << 24) + (j << 12) + i);
    let tile = at(1, u / 20, v / 20);
    let spot = at(2, u / 24, v / 24);
    let away = |along: u32, bits: u32| (along % 24) as i32 - 6 - (bits % 12) as i32;
    let (du, dv) = (away(u, spot), away(v, spot >> 8));
    let mut value = 50 + (tile % 110) as i32;
    if du * du + dv * dv < 8 + (spot >> 16) as i32 % 40 {
        value += if spot >> 31 == 1 { 70 } else { -45 };
    }
    value as u32 + at(3, u, v) % 8
}
