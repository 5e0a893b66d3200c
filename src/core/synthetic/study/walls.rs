//! Objects on the walls, and the window.

use std::f64::consts::FRAC_PI_2;

use glam::DVec3;

use super::super::paint::Paint;
use super::super::shape::Shape;
use super::builder::{BRASS, Builder, OAK, PAINTED, WALNUT};

pub(super) fn window(b: &mut Builder) {
    let (middle, height) = ([1.55, -0.55, 2.87], 0.78);
    b.block(middle, [0.88, height, 0.01], Paint::Dusk, [0.5; 3]);
    for x in [-0.9, 0.0, 0.9] {
        b.block([middle[0] + x, -0.55, 2.82], [0.045, 0.86, 0.05], Paint::Wood(1), PAINTED);
    }
    for (y, half) in [(-0.82, 0.05), (-0.2, 0.025), (0.82, 0.05)] {
        b.block([middle[0], middle[1] + y, 2.82], [0.94, half, 0.05], Paint::Wood(0), PAINTED);
    }
    b.block([middle[0], 0.34, 2.74], [1.02, 0.03, 0.14], Paint::Wood(0), PAINTED);
    b.block([middle[0], -1.5, 2.66], [1.35, 0.02, 0.02], Paint::Plain, BRASS);
    for side in [-1.0, 1.0] {
        for fold in 0..5 {
            let x = middle[0] + side * (0.98 + 0.085 * f64::from(fold));
            let half = [0.055, 1.12, 0.05 + 0.015 * f64::from(fold % 2)];
            b.ellipsoid([x, -0.42, 2.68], half, Paint::Woven, [0.30, 0.08, 0.06]);
        }
    }
}

pub(super) fn pictures(b: &mut Builder) {
    let gilt = [0.45, 0.30, 0.10];
    b.block([-0.05, -0.55, 2.85], [0.42, 0.5, 0.035], Paint::Landscape, gilt);
    let right =
        Shape::block(DVec3::new(3.36, -0.35, 0.6), DVec3::new(0.62, 0.46, 0.035), FRAC_PI_2);
    b.add(right, Paint::Fields, WALNUT);
    let left = Shape::block(DVec3::new(-3.36, -0.5, 1.1), DVec3::new(0.55, 0.7, 0.035), FRAC_PI_2);
    b.add(left, Paint::Landscape, gilt);
    // A clock with its pendulum between shelf and window.
    b.block([-0.05, 0.45, 2.8], [0.16, 0.34, 0.08], Paint::Wood(1), OAK);
    b.ellipsoid([-0.05, 0.25, 2.71], [0.11, 0.11, 0.015], Paint::Patterned, [0.62, 0.6, 0.52]);
}
