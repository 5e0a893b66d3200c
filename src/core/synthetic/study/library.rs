//! A shelf of books.

use super::super::paint::Paint;
use super::builder::{Builder, WALNUT};

/// Levels of the boards of the shelf.
const BOARDS: [f64; 6] = [1.36, 0.88, 0.42, -0.04, -0.50, -0.96];

/// Left and right side of the shelf.
const SHELF: (f64, f64) = (-2.85, -0.75);

pub(super) fn shelf(b: &mut Builder) {
    let (left, right) = SHELF;
    let middle = 0.5 * (left + right);
    for x in [left, middle, right] {
        b.block([x, 0.2, 2.62], [0.025, 1.2, 0.2], Paint::Wood(1), WALNUT);
    }
    for y in BOARDS {
        let half = [0.5 * (right - left), 0.02, 0.2];
        b.block([middle, y, 2.62], half, Paint::Wood(0), WALNUT);
    }
    b.block([middle, -1.02, 2.6], [1.12, 0.035, 0.24], Paint::Wood(0), WALNUT);
    b.block([middle, 0.2, 2.85], [1.05, 1.2, 0.02], Paint::Wood(1), [0.12, 0.07, 0.04]);
}

pub(super) fn books(b: &mut Builder) {
    let (left, right) = SHELF;
    for (row, y) in BOARDS[..5].iter().enumerate() {
        let mut x = left + 0.05;
        while x < right - 0.12 {
            let middle = 0.5 * (left + right);
            let thick = b.random(0.018, 0.042);
            // Leaves out the upright in the middle, and an occasional gap.
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

/// An ornament between the books.
fn ornament(b: &mut Builder, [x, y, z]: [f64; 3], row: usize) {
    let colour = b.cloth();
    match row % 3 {
        0 => b.ellipsoid([x, y - 0.13, z], [0.08, 0.13, 0.08], Paint::Patterned, colour),
        1 => b.ball([x, y - 0.1, z], 0.1, Paint::Patterned, colour),
        _ => b.block([x, y - 0.09, z], [0.07, 0.09, 0.05], Paint::Patterned, colour),
    }
}
