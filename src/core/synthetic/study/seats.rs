//! Chair, table, stool, and small objects.

use glam::{DMat3, DVec3};

use super::super::paint::Paint;
use super::super::shape::Shape;
use super::builder::{Builder, OAK, WALNUT, placed};

pub(super) fn rug(b: &mut Builder) {
    b.turned([-0.1, 1.388, 0.25], [1.55, 0.012, 1.05], 0.12, Paint::Rug, [0.3; 3]);
}

pub(super) fn armchair(b: &mut Builder) {
    let (origin, turn) = ([-1.35, 0.0, 0.95], 0.45);
    let cloth = [0.16, 0.22, 0.13];
    let mut part = |offset: [f64; 3], half: [f64; 3], paint: Paint, base: [f64; 3]| {
        b.turned(placed(origin, turn, offset), half, turn, paint, base);
    };
    part([0.0, 1.1, 0.0], [0.40, 0.15, 0.38], Paint::Woven, cloth);
    part([0.0, 0.92, -0.04], [0.33, 0.06, 0.34], Paint::Woven, [0.22, 0.28, 0.17]);
    part([0.0, 0.68, 0.36], [0.42, 0.5, 0.1], Paint::Woven, cloth);
    for side in [-1.0, 1.0] {
        part([0.45 * side, 0.95, 0.0], [0.08, 0.28, 0.40], Paint::Woven, cloth);
        for depth in [-0.3, 0.3] {
            part([0.4 * side, 1.33, depth], [0.03, 0.07, 0.03], Paint::Wood(1), WALNUT);
        }
    }
    let cushion = Shape::Ellipsoid {
        centre: DVec3::from(placed(origin, turn, [0.08, 0.70, 0.18])),
        half: DVec3::new(0.24, 0.21, 0.1),
        frame: DMat3::from_rotation_y(turn) * DMat3::from_rotation_x(-0.3),
    };
    b.add(cushion, Paint::Patterned, [0.42, 0.12, 0.06]);
    let throw = placed(origin, turn, [-0.2, 0.15, 0.35]);
    b.turned(throw, [0.16, 0.07, 0.12], turn, Paint::Woven, [0.35, 0.24, 0.08]);
}

pub(super) fn table(b: &mut Builder) {
    let (origin, turn) = ([0.55, 0.0, 0.05], -0.3);
    b.turned(placed(origin, turn, [0.0, 0.86, 0.0]), [0.58, 0.03, 0.36], turn, Paint::Wood(0), OAK);
    for (x, z) in [(-0.5, -0.28), (0.5, -0.28), (-0.5, 0.28), (0.5, 0.28)] {
        let leg = placed(origin, turn, [x, 1.13, z]);
        b.turned(leg, [0.03, 0.25, 0.03], turn, Paint::Wood(1), OAK);
    }
    for level in 0..3 {
        let y = 0.80 - 0.062 * f64::from(level);
        let place = placed(origin, turn, [-0.33, y, 0.05]);
        let more = b.random(-0.5, 0.5);
        let cloth = b.cloth();
        b.turned(place, [0.17, 0.029, 0.12], turn + more, Paint::Book, cloth);
    }
    // A bowl of fruit, a cup, and a newspaper.
    let bowl = placed(origin, turn, [0.22, 0.79, 0.06]);
    b.ellipsoid(bowl, [0.2, 0.075, 0.2], Paint::Patterned, [0.10, 0.16, 0.36]);
    let fruits = [
        ([0.14, 0.70, 0.02], [0.55, 0.12, 0.05]),
        ([0.28, 0.70, 0.0], [0.60, 0.30, 0.05]),
        ([0.21, 0.69, 0.15], [0.30, 0.42, 0.06]),
        ([0.22, 0.61, 0.06], [0.62, 0.16, 0.06]),
    ];
    for (offset, colour) in fruits {
        b.ball(placed(origin, turn, offset), 0.075, Paint::Plain, colour);
    }
    let cup = placed(origin, turn, [-0.02, 0.77, -0.2]);
    b.ellipsoid(cup, [0.055, 0.07, 0.055], Paint::Patterned, [0.6, 0.58, 0.52]);
    let news = placed(origin, turn, [0.3, 0.823, -0.22]);
    b.turned(news, [0.17, 0.006, 0.11], turn + 0.25, Paint::Patterned, [0.6, 0.58, 0.52]);
}

pub(super) fn toys(b: &mut Builder) {
    b.ball([-0.45, 1.21, -0.35], 0.17, Paint::Patterned, [0.45, 0.10, 0.07]);
    let cubes =
        [([0.02, 1.29, -0.62], 0.3), ([0.22, 1.29, -0.52], -0.5), ([0.11, 1.12, -0.57], 0.9)];
    for (centre, turn) in cubes {
        let colour = b.cloth();
        b.turned(centre, [0.085; 3], turn, Paint::Patterned, colour.map(|v| 1.5 * v));
    }
    // A stool with a cushion.
    b.turned([1.65, 1.02, -0.35], [0.24, 0.03, 0.24], 0.4, Paint::Wood(0), WALNUT);
    for (x, z) in [(-0.18, -0.18), (0.18, -0.18), (-0.18, 0.18), (0.18, 0.18)] {
        let leg = placed([1.65, 1.22, -0.35], 0.4, [x, 0.0, z]);
        b.turned(leg, [0.022, 0.18, 0.022], 0.4, Paint::Wood(1), WALNUT);
    }
    b.ellipsoid([1.65, 0.95, -0.35], [0.22, 0.06, 0.22], Paint::Woven, [0.30, 0.10, 0.12]);
    // Logs in front of the bricks.
    for (index, (y, z)) in
        [(1.3, 0.1), (1.3, 0.32), (1.3, 0.54), (1.12, 0.21), (1.12, 0.43)].into_iter().enumerate()
    {
        let x = 3.0 + 0.03 * f64::from(u8::try_from(index % 3).unwrap_or(0));
        b.ellipsoid([x, y, z], [0.36, 0.1, 0.1], Paint::Wood(0), [0.30, 0.19, 0.11]);
    }
}
