//! Random scenes for the tests of file formats, and how far two scenes are apart.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{Gaussians, Y00};

/// Gaussians in a cube with this side, with harmonics of this degree.
pub fn scattered(count: usize, side: f32, sh_degree: u32) -> Gaussians {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut number = |from: f32, to: f32| random.random_range(from..to);
    let row = 3 * ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let mut scene = Gaussians { sh_degree, ..Gaussians::default() };
    for _ in 0..count {
        scene.means.push([0; 3].map(|_| number(0.0, side)));
        scene.quats.push([0; 4].map(|_| number(-1.0, 1.0)));
        scene.log_scales.push([0; 3].map(|_| number(-7.0, -1.0)));
        scene.opacity_logits.push(number(-5.0, 5.0));
        scene.sh.extend((0..row).map(|_| number(-1.5, 1.5)));
    }
    scene
}

fn normalised(quat: [f32; 4]) -> [f32; 4] {
    let length = quat.iter().map(|q| q * q).sum::<f32>().sqrt();
    quat.map(|q| q / length)
}

/// The largest difference of each part: means, scales, colours, opacities, rotations, harmonics.
pub fn differences(a: &Gaussians, b: &Gaussians) -> [f32; 6] {
    let most = |pairs: &mut dyn Iterator<Item = (f32, f32)>| {
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    let flat = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        let pairs = a.as_flattened().iter().zip(b.as_flattened());
        most(&mut pairs.map(|(a, b)| (*a, *b)))
    };
    let sigmoid = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    let opacities = a.opacity_logits.iter().zip(&b.opacity_logits);
    let cosine = |(a, b): (&[f32; 4], &[f32; 4])| {
        let (a, b) = (normalised(*a), normalised(*b));
        (0..4).map(|i| a[i] * b[i]).sum::<f32>().abs().min(1.0)
    };
    let turns = a.quats.iter().zip(&b.quats).map(cosine);
    let row = 3 * a.coefficients();
    let sh = a.sh.iter().zip(&b.sh).enumerate();
    let of = |base: bool| {
        let pairs = sh.clone().filter(move |(i, _)| (i % row < 3) == base);
        most(&mut pairs.map(|(_, (a, b))| (*a, *b)))
    };
    [
        flat(&a.means, &b.means),
        flat(&a.log_scales, &b.log_scales),
        Y00 * of(true),
        most(&mut opacities.map(|(a, b)| (sigmoid(*a), sigmoid(*b)))),
        // Radians.
        2.0 * turns.fold(1.0, f32::min).acos(),
        of(false),
    ]
}
