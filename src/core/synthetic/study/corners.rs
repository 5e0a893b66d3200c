//! Furniture along the walls: a cabinet, a lamp, a plant.

use std::f64::consts::TAU;

use glam::{DMat3, DVec3};

use super::super::paint::Paint;
use super::super::shape::Shape;
use super::builder::{BRASS, Builder, OAK, WALNUT};

pub(super) fn cabinet(b: &mut Builder) {
    b.block([1.6, 0.98, 2.56], [1.0, 0.4, 0.27], Paint::Wood(0), OAK);
    b.block([1.6, 0.56, 2.55], [1.06, 0.025, 0.31], Paint::Wood(0), OAK);
    for (index, x) in [0.95, 1.6, 2.25].into_iter().enumerate() {
        b.block([x, 0.98, 2.28], [0.29, 0.33, 0.012], Paint::Wood(1), [0.42, 0.25, 0.12]);
        let knob = x + if index == 0 { 0.2 } else { -0.2 };
        b.ball([knob, 0.95, 2.25], 0.025, Paint::Plain, BRASS);
    }
    // A globe, a small lamp, a vase, and lying books.
    b.block([0.8, 0.5, 2.5], [0.09, 0.02, 0.09], Paint::Wood(0), WALNUT);
    b.ball([0.8, 0.28, 2.5], 0.19, Paint::Patterned, [0.10, 0.22, 0.34]);
    b.block([2.35, 0.42, 2.5], [0.02, 0.12, 0.02], Paint::Plain, BRASS);
    b.ellipsoid([2.35, 0.2, 2.5], [0.16, 0.13, 0.16], Paint::Glow, [1.0, 0.72, 0.38]);
    b.ellipsoid([1.85, 0.38, 2.45], [0.09, 0.17, 0.09], Paint::Patterned, [0.28, 0.34, 0.42]);
    for level in 0..3 {
        let y = 0.51 - 0.055 * f64::from(level);
        let turn = b.random(-0.4, 0.4);
        let cloth = b.cloth();
        b.turned([1.35, y, 2.45], [0.17, 0.026, 0.12], turn, Paint::Book, cloth);
    }
}

pub(super) fn floor_lamp(b: &mut Builder) {
    b.ellipsoid([-2.25, 1.38, 1.0], [0.2, 0.03, 0.2], Paint::Plain, BRASS);
    b.block([-2.25, 0.5, 1.0], [0.016, 0.9, 0.016], Paint::Plain, BRASS);
    b.ellipsoid([-2.25, -0.45, 1.0], [0.28, 0.22, 0.28], Paint::Glow, [1.0, 0.78, 0.46]);
}

pub(super) fn plant(b: &mut Builder) {
    let root = DVec3::new(2.45, 0.95, 1.2);
    b.ellipsoid([2.45, 1.16, 1.2], [0.26, 0.26, 0.26], Paint::Patterned, [0.42, 0.18, 0.09]);
    for index in 0..46 {
        let around = TAU * 0.381_966 * f64::from(index);
        let rise = 0.25 + 1.15 * f64::from(index) / 46.0;
        let lean = b.random(0.2, 0.75) * (1.25 - 0.5 * rise);
        let out = DVec3::new(around.cos(), 0.0, around.sin());
        let along = (out * lean - DVec3::Y * b.random(0.15, 0.5)).normalize();
        let side = along.cross(out).try_normalize().unwrap_or(DVec3::X);
        let long = b.random(0.13, 0.22);
        let leaf = Shape::Ellipsoid {
            centre: root + out * (0.1 + 0.28 * lean) - DVec3::Y * (rise - 0.3) + along * long,
            half: DVec3::new(0.35 * long, long, 0.012),
            frame: DMat3::from_cols(side, along, side.cross(along)),
        };
        let tone = b.random(0.6, 1.3);
        b.add(leaf, Paint::Leaf, [0.09 * tone, 0.24 * tone, 0.06 * tone]);
    }
    b.block([2.45, 0.45, 1.2], [0.02, 0.5, 0.02], Paint::Wood(1), WALNUT);
}
