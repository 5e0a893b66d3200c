//! Random scenes for the tests of file formats.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::Gaussians;

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
