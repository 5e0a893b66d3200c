//! A furnished room at dusk: what a demonstration shows. Everything in it is built here, piece by
//! piece; y points down, the floor is at 1.4, a unit is about a metre.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DMat3, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::paint::{Coat, Paint};
use super::room::{Group, Lamp, Room, Solid};
use super::shape::Shape;

const OAK: [f64; 3] = [0.36, 0.20, 0.09];
const WALNUT: [f64; 3] = [0.19, 0.10, 0.05];
const PAINTED: [f64; 3] = [0.55, 0.52, 0.45];
const BRASS: [f64; 3] = [0.48, 0.33, 0.10];

/// The room. It is the same every time: path and shake are what a seed changes.
pub(super) fn study() -> Room {
    let mut builder = Builder::new();
    let walls = Shape::Walls {
        centre: DVec3::new(0.0, -0.2, -0.7),
        half: DVec3::new(3.4, 1.6, 3.6),
    };
    let walls = vec![builder.solid(walls, Paint::Walls, [0.5; 3])];
    let mut groups = vec![Group {
        centre: DVec3::ZERO,
        radius: f64::INFINITY,
        solids: walls,
    }];
    type Piece = fn(&mut Builder);
    let pieces: [Piece; 11] = [
        rug, shelf, books, window, cabinet, armchair, table, floor_lamp, plant, pictures, toys,
    ];
    for piece in pieces {
        piece(&mut builder);
        groups.push(Group::around(std::mem::take(&mut builder.solids)));
    }
    Room {
        groups,
        lamps: lamps(),
        ambient: DVec3::new(0.085, 0.09, 0.115),
        scale: 0.35,
        wallpapers: Vec::new(),
    }
}

/// The lamp beside the chair, the one on the cabinet, a ceiling lamp behind the photographer, and
/// what comes in by the window.
fn lamps() -> Vec<Lamp> {
    let lamp = |place: [f64; 3], colour: [f64; 3], white_at: f64| Lamp {
        place: DVec3::from(place),
        colour: DVec3::from(colour),
        white_at,
    };
    vec![
        lamp([-2.25, -0.42, 1.0], [1.0, 0.74, 0.46], 1.15),
        lamp([2.35, 0.16, 2.5], [1.0, 0.7, 0.4], 0.5),
        lamp([0.6, -1.6, -1.9], [1.0, 0.86, 0.68], 1.9),
        lamp([1.55, -0.6, 2.6], [0.55, 0.62, 1.0], 0.75),
    ]
}

/// Collects the solids of a piece of furniture.
struct Builder {
    rng: Pcg64Mcg,
    solids: Vec<Solid>,
    salt: u32,
}

impl Builder {
    fn new() -> Self {
        Self {
            rng: Pcg64Mcg::seed_from_u64(0x57d1),
            solids: Vec::new(),
            salt: 1000,
        }
    }

    fn solid(&mut self, shape: Shape, paint: Paint, base: [f64; 3]) -> Solid {
        self.salt = self.salt.wrapping_add(37);
        let salt = self.salt;
        let coat = Coat { paint, base, salt };
        Solid { shape, coat }
    }

    fn add(&mut self, shape: Shape, paint: Paint, base: [f64; 3]) {
        let solid = self.solid(shape, paint, base);
        self.solids.push(solid);
    }

    fn block(&mut self, centre: [f64; 3], half: [f64; 3], paint: Paint, base: [f64; 3]) {
        self.turned(centre, half, 0.0, paint, base);
    }

    fn turned(
        &mut self,
        centre: [f64; 3],
        half: [f64; 3],
        turn: f64,
        paint: Paint,
        base: [f64; 3],
    ) {
        let shape = Shape::Block {
            centre: DVec3::from(centre),
            half: DVec3::from(half),
            turn,
        };
        self.add(shape, paint, base);
    }

    fn ellipsoid(&mut self, centre: [f64; 3], half: [f64; 3], paint: Paint, base: [f64; 3]) {
        let shape = Shape::Ellipsoid {
            centre: DVec3::from(centre),
            half: DVec3::from(half),
            frame: DMat3::IDENTITY,
        };
        self.add(shape, paint, base);
    }

    fn ball(&mut self, centre: [f64; 3], radius: f64, paint: Paint, base: [f64; 3]) {
        let centre = DVec3::from(centre);
        self.add(Shape::Ball { centre, radius }, paint, base);
    }

    fn random(&mut self, low: f64, high: f64) -> f64 {
        self.rng.random_range(low..high)
    }

    /// A muted colour.
    fn cloth(&mut self) -> [f64; 3] {
        const CLOTHS: [[f64; 3]; 8] = [
            [0.30, 0.06, 0.05],
            [0.07, 0.13, 0.28],
            [0.09, 0.20, 0.11],
            [0.38, 0.27, 0.10],
            [0.22, 0.13, 0.08],
            [0.42, 0.38, 0.30],
            [0.16, 0.08, 0.20],
            [0.05, 0.20, 0.22],
        ];
        let tone = self.random(0.7, 1.25);
        CLOTHS[self.rng.random_range(0..CLOTHS.len())].map(|v| v * tone)
    }
}

/// A place of a piece of furniture that is turned about the vertical.
fn placed(origin: [f64; 3], turn: f64, offset: [f64; 3]) -> [f64; 3] {
    (DVec3::from(origin) + DMat3::from_rotation_y(turn) * DVec3::from(offset)).to_array()
}

fn rug(b: &mut Builder) {
    b.turned(
        [-0.1, 1.388, 0.25],
        [1.55, 0.012, 1.05],
        0.12,
        Paint::Rug,
        [0.3; 3],
    );
}

/// Levels of the boards of the shelf.
const BOARDS: [f64; 6] = [1.36, 0.88, 0.42, -0.04, -0.50, -0.96];
/// Left and right side of the shelf.
const SHELF: (f64, f64) = (-2.85, -0.75);

fn shelf(b: &mut Builder) {
    let (left, right) = SHELF;
    let middle = 0.5 * (left + right);
    for x in [left, middle, right] {
        b.block([x, 0.2, 2.62], [0.025, 1.2, 0.2], Paint::Wood(1), WALNUT);
    }
    for y in BOARDS {
        let half = [0.5 * (right - left), 0.02, 0.2];
        b.block([middle, y, 2.62], half, Paint::Wood(0), WALNUT);
    }
    b.block(
        [middle, -1.02, 2.6],
        [1.12, 0.035, 0.24],
        Paint::Wood(0),
        WALNUT,
    );
    b.block(
        [middle, 0.2, 2.85],
        [1.05, 1.2, 0.02],
        Paint::Wood(1),
        [0.12, 0.07, 0.04],
    );
}

fn books(b: &mut Builder) {
    let (left, right) = SHELF;
    for (row, y) in BOARDS[..5].iter().enumerate() {
        let mut x = left + 0.05;
        while x < right - 0.12 {
            let middle = 0.5 * (left + right);
            let thick = b.random(0.018, 0.042);
            // The upright in the middle, and a gap now and then.
            if (x - 0.03..x + 2.0 * thick + 0.03).contains(&middle) {
                x = middle + 0.035;
                continue;
            }
            if b.random(0.0, 1.0) < 0.05 {
                ornament(b, [x + 0.12, y - 0.02, 2.55], row);
                x += 0.26;
                continue;
            }
            let tall = b.random(0.12, 0.19);
            let deep = b.random(0.10, 0.14);
            let (centre, half) = ([x + thick, y - 0.02 - tall, 2.58], [thick, tall, deep]);
            let lean = b.random(-0.02, 0.02);
            let cloth = b.cloth();
            b.turned(centre, half, lean, Paint::Book, cloth);
            x += 2.0 * thick + 0.004;
        }
    }
}

/// Something that is no book.
fn ornament(b: &mut Builder, [x, y, z]: [f64; 3], row: usize) {
    let colour = b.cloth();
    match row % 3 {
        0 => b.ellipsoid(
            [x, y - 0.13, z],
            [0.08, 0.13, 0.08],
            Paint::Patterned,
            colour,
        ),
        1 => b.ball([x, y - 0.1, z], 0.1, Paint::Patterned, colour),
        _ => b.block(
            [x, y - 0.09, z],
            [0.07, 0.09, 0.05],
            Paint::Patterned,
            colour,
        ),
    }
}

fn window(b: &mut Builder) {
    let (middle, height) = ([1.55, -0.55, 2.87], 0.78);
    b.block(middle, [0.88, height, 0.01], Paint::Dusk, [0.5; 3]);
    for x in [-0.9, 0.0, 0.9] {
        b.block(
            [middle[0] + x, -0.55, 2.82],
            [0.045, 0.86, 0.05],
            Paint::Wood(1),
            PAINTED,
        );
    }
    for (y, half) in [(-0.82, 0.05), (-0.2, 0.025), (0.82, 0.05)] {
        b.block(
            [middle[0], middle[1] + y, 2.82],
            [0.94, half, 0.05],
            Paint::Wood(0),
            PAINTED,
        );
    }
    b.block(
        [middle[0], 0.34, 2.74],
        [1.02, 0.03, 0.14],
        Paint::Wood(0),
        PAINTED,
    );
    b.block(
        [middle[0], -1.5, 2.66],
        [1.35, 0.02, 0.02],
        Paint::Plain,
        BRASS,
    );
    for side in [-1.0, 1.0] {
        for fold in 0..5 {
            let x = middle[0] + side * (0.98 + 0.085 * f64::from(fold));
            let half = [0.055, 1.12, 0.05 + 0.015 * f64::from(fold % 2)];
            b.ellipsoid([x, -0.42, 2.68], half, Paint::Woven, [0.30, 0.08, 0.06]);
        }
    }
}

fn cabinet(b: &mut Builder) {
    b.block([1.6, 0.98, 2.56], [1.0, 0.4, 0.27], Paint::Wood(0), OAK);
    b.block([1.6, 0.56, 2.55], [1.06, 0.025, 0.31], Paint::Wood(0), OAK);
    for (index, x) in [0.95, 1.6, 2.25].into_iter().enumerate() {
        b.block(
            [x, 0.98, 2.28],
            [0.29, 0.33, 0.012],
            Paint::Wood(1),
            [0.42, 0.25, 0.12],
        );
        let knob = x + if index == 0 { 0.2 } else { -0.2 };
        b.ball([knob, 0.95, 2.25], 0.025, Paint::Plain, BRASS);
    }
    // A globe, a small lamp, a vase, and books that lie.
    b.block([0.8, 0.5, 2.5], [0.09, 0.02, 0.09], Paint::Wood(0), WALNUT);
    b.ball([0.8, 0.28, 2.5], 0.19, Paint::Patterned, [0.10, 0.22, 0.34]);
    b.block([2.35, 0.42, 2.5], [0.02, 0.12, 0.02], Paint::Plain, BRASS);
    b.ellipsoid(
        [2.35, 0.2, 2.5],
        [0.16, 0.13, 0.16],
        Paint::Glow,
        [1.0, 0.72, 0.38],
    );
    b.ellipsoid(
        [1.85, 0.38, 2.45],
        [0.09, 0.17, 0.09],
        Paint::Patterned,
        [0.28, 0.34, 0.42],
    );
    for level in 0..3 {
        let y = 0.51 - 0.055 * f64::from(level);
        let turn = b.random(-0.4, 0.4);
        let cloth = b.cloth();
        b.turned(
            [1.35, y, 2.45],
            [0.17, 0.026, 0.12],
            turn,
            Paint::Book,
            cloth,
        );
    }
}

fn armchair(b: &mut Builder) {
    let (origin, turn) = ([-1.35, 0.0, 0.95], 0.45);
    let cloth = [0.16, 0.22, 0.13];
    let mut part = |offset: [f64; 3], half: [f64; 3], paint: Paint, base: [f64; 3]| {
        b.turned(placed(origin, turn, offset), half, turn, paint, base);
    };
    part([0.0, 1.1, 0.0], [0.40, 0.15, 0.38], Paint::Woven, cloth);
    part(
        [0.0, 0.92, -0.04],
        [0.33, 0.06, 0.34],
        Paint::Woven,
        [0.22, 0.28, 0.17],
    );
    part([0.0, 0.68, 0.36], [0.42, 0.5, 0.1], Paint::Woven, cloth);
    for side in [-1.0, 1.0] {
        part(
            [0.45 * side, 0.95, 0.0],
            [0.08, 0.28, 0.40],
            Paint::Woven,
            cloth,
        );
        for depth in [-0.3, 0.3] {
            part(
                [0.4 * side, 1.33, depth],
                [0.03, 0.07, 0.03],
                Paint::Wood(1),
                WALNUT,
            );
        }
    }
    let cushion = Shape::Ellipsoid {
        centre: DVec3::from(placed(origin, turn, [0.08, 0.70, 0.18])),
        half: DVec3::new(0.24, 0.21, 0.1),
        frame: DMat3::from_rotation_y(turn) * DMat3::from_rotation_x(-0.3),
    };
    b.add(cushion, Paint::Patterned, [0.42, 0.12, 0.06]);
    let throw = placed(origin, turn, [-0.2, 0.15, 0.35]);
    b.turned(
        throw,
        [0.16, 0.07, 0.12],
        turn,
        Paint::Woven,
        [0.35, 0.24, 0.08],
    );
}

fn table(b: &mut Builder) {
    let (origin, turn) = ([0.55, 0.0, 0.05], -0.3);
    b.turned(
        placed(origin, turn, [0.0, 0.86, 0.0]),
        [0.58, 0.03, 0.36],
        turn,
        Paint::Wood(0),
        OAK,
    );
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
    // A bowl of fruit, a cup, and the day's paper.
    let bowl = placed(origin, turn, [0.22, 0.79, 0.06]);
    b.ellipsoid(
        bowl,
        [0.2, 0.075, 0.2],
        Paint::Patterned,
        [0.10, 0.16, 0.36],
    );
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
    b.ellipsoid(
        cup,
        [0.055, 0.07, 0.055],
        Paint::Patterned,
        [0.6, 0.58, 0.52],
    );
    let news = placed(origin, turn, [0.3, 0.823, -0.22]);
    b.turned(
        news,
        [0.17, 0.006, 0.11],
        turn + 0.25,
        Paint::Patterned,
        [0.6, 0.58, 0.52],
    );
}

fn floor_lamp(b: &mut Builder) {
    b.ellipsoid([-2.25, 1.38, 1.0], [0.2, 0.03, 0.2], Paint::Plain, BRASS);
    b.block([-2.25, 0.5, 1.0], [0.016, 0.9, 0.016], Paint::Plain, BRASS);
    b.ellipsoid(
        [-2.25, -0.45, 1.0],
        [0.28, 0.22, 0.28],
        Paint::Glow,
        [1.0, 0.78, 0.46],
    );
}

fn plant(b: &mut Builder) {
    let root = DVec3::new(2.45, 0.95, 1.2);
    b.ellipsoid(
        [2.45, 1.16, 1.2],
        [0.26, 0.26, 0.26],
        Paint::Patterned,
        [0.42, 0.18, 0.09],
    );
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

fn pictures(b: &mut Builder) {
    let gilt = [0.45, 0.30, 0.10];
    b.block(
        [-0.05, -0.55, 2.85],
        [0.42, 0.5, 0.035],
        Paint::Landscape,
        gilt,
    );
    let right = Shape::Block {
        centre: DVec3::new(3.36, -0.35, 0.6),
        half: DVec3::new(0.62, 0.46, 0.035),
        turn: FRAC_PI_2,
    };
    b.add(right, Paint::Fields, WALNUT);
    let left = Shape::Block {
        centre: DVec3::new(-3.36, -0.5, 1.1),
        half: DVec3::new(0.55, 0.7, 0.035),
        turn: FRAC_PI_2,
    };
    b.add(left, Paint::Landscape, gilt);
    // A clock with its pendulum between shelf and window.
    b.block([-0.05, 0.45, 2.8], [0.16, 0.34, 0.08], Paint::Wood(1), OAK);
    b.ellipsoid(
        [-0.05, 0.25, 2.71],
        [0.11, 0.11, 0.015],
        Paint::Patterned,
        [0.62, 0.6, 0.52],
    );
}

fn toys(b: &mut Builder) {
    b.ball(
        [-0.45, 1.21, -0.35],
        0.17,
        Paint::Patterned,
        [0.45, 0.10, 0.07],
    );
    let cubes = [
        ([0.02, 1.29, -0.62], 0.3),
        ([0.22, 1.29, -0.52], -0.5),
        ([0.11, 1.12, -0.57], 0.9),
    ];
    for (centre, turn) in cubes {
        let colour = b.cloth();
        b.turned(
            centre,
            [0.085; 3],
            turn,
            Paint::Patterned,
            colour.map(|v| 1.5 * v),
        );
    }
    // A stool with a cushion.
    b.turned(
        [1.65, 1.02, -0.35],
        [0.24, 0.03, 0.24],
        0.4,
        Paint::Wood(0),
        WALNUT,
    );
    for (x, z) in [(-0.18, -0.18), (0.18, -0.18), (-0.18, 0.18), (0.18, 0.18)] {
        let leg = placed([1.65, 1.22, -0.35], 0.4, [x, 0.0, z]);
        b.turned(leg, [0.022, 0.18, 0.022], 0.4, Paint::Wood(1), WALNUT);
    }
    b.ellipsoid(
        [1.65, 0.95, -0.35],
        [0.22, 0.06, 0.22],
        Paint::Woven,
        [0.30, 0.10, 0.12],
    );
    // Logs before the bricks.
    for (index, (y, z)) in [
        (1.3, 0.1),
        (1.3, 0.32),
        (1.3, 0.54),
        (1.12, 0.21),
        (1.12, 0.43),
    ]
    .into_iter()
    .enumerate()
    {
        let x = 3.0 + 0.03 * f64::from(u8::try_from(index % 3).unwrap_or(0));
        b.ellipsoid(
            [x, y, z],
            [0.36, 0.1, 0.1],
            Paint::Wood(0),
            [0.30, 0.19, 0.11],
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_study_is_the_same_every_time_and_stands_within_its_walls() {
        let (one, other) = (study(), study());
        let solids = |room: &Room| -> Vec<Solid> {
            room.groups
                .iter()
                .flat_map(|group| group.solids.clone())
                .collect()
        };
        assert_eq!(
            format!("{:?}", solids(&one)),
            format!("{:?}", solids(&other))
        );
        let inside = solids(&one).split_off(1);
        assert!(inside.len() > 150, "{} solids", inside.len());
        for solid in &inside {
            let centre = solid.shape.centre();
            assert!(
                centre.x.abs() < 3.4 && centre.y < 1.4 && centre.y > -1.8,
                "{solid:?}"
            );
            assert!(centre.z < 2.9 && centre.z > -4.3, "{solid:?}");
        }
    }
}
