//! The materials of surfaces. Colours are albedo in linear light, or light itself on glowing
//! surfaces.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, IVec2};

use super::shape::Hit;
use super::texture::{albedo, cell, hash, rough};

/// The material of a solid, its colour, and a number that distinguishes it from others of its kind.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coat {
    pub paint: Paint,
    pub base: [f64; 3],
    pub salt: u32,
}

/// The material of a surface.
#[derive(Clone, Copy, Debug)]
pub(super) enum Paint {
    /// Painted corners and blobs at every scale.
    Patterned,
    /// One colour, a little uneven.
    Plain,
    /// Grain along an axis of the solid.
    Wood(usize),
    /// Plaid cloth.
    Woven,
    /// A leaf along its y axis.
    Leaf,
    /// A standing book, with its spine towards -z.
    Book,
    /// A rug with a border.
    Rug,
    /// A framed landscape on the sides along z.
    Landscape,
    /// Framed fields of colour on the sides along z.
    Fields,
    /// Sides of a room: boards, planks, bricks, paper and plaster.
    Walls,
    /// Emits light.
    Glow,
    /// A town at dusk, seen through the sides along z.
    Dusk,
}

impl Coat {
    /// Whether it emits light, and so casts no shadow.
    pub fn glows(&self) -> bool {
        matches!(self.paint, Paint::Glow | Paint::Dusk)
    }

    /// Albedo, or light, at a point of a solid with these `half` sides. `scale` is that of
    /// patterns.
    pub fn albedo(&self, hit: &Hit, half: DVec3, scale: f64) -> [f64; 3] {
        let (own, salt) = (self.salt, self.salt.wrapping_add(hit.face));
        let base = DVec3::from(self.base);
        let part = hit.local / half;
        let faces_z = hit.face / 2 == 2;
        let colour = match self.paint {
            Paint::Patterned => return albedo(hit.surface, self.base, salt, scale),
            Paint::Plain => base * uneven(hit.surface * 9.0, salt),
            Paint::Wood(along) => wood(base, hit.local, along, own),
            Paint::Woven => woven(base, hit.surface, salt),
            Paint::Leaf => leaf(base, part, own),
            Paint::Book => book(base, hit, part, own),
            Paint::Rug => rug(hit.local, part, salt),
            Paint::Landscape if faces_z => framed(base, part, |at| landscape(at, own)),
            Paint::Fields if faces_z => framed(base, part, |at| fields(at, own)),
            Paint::Landscape | Paint::Fields => base,
            Paint::Walls => wall(hit, salt),
            Paint::Glow => base * (0.8 + 0.2 * uneven(hit.surface * 20.0, salt)),
            Paint::Dusk => dusk(part, own),
        };
        colour.to_array()
    }
}

/// Uneven brightness, 0.8 to 1.
fn uneven(p: DVec2, salt: u32) -> f64 {
    0.8 + 0.2 * rough(p, salt)
}

/// A hash of an integer in 0..1.
fn number(index: i32, salt: u32) -> f64 {
    hash(IVec2::new(index, 77), salt)
}

/// Rings around an axis beside the board, and fibres along it.
fn wood(base: DVec3, local: DVec3, along: usize, salt: u32) -> DVec3 {
    let (a, b, c) = (local[along], local[(along + 1) % 3], local[(along + 2) % 3]);
    let bend = rough(DVec2::new(1.3 * a, 2.0 * b), salt);
    let rings = (DVec2::new(b + 0.4, c - 0.7).length() * 26.0 + 4.0 * bend) * TAU;
    let fibre = rough(DVec2::new(5.0 * a, 70.0 * (b + 0.7 * c)), salt ^ 9);
    base * (0.62 + 0.16 * rings.sin() + 0.44 * fibre)
}

fn woven(base: DVec3, p: DVec2, salt: u32) -> DVec3 {
    let stripe = |x: f64| {
        let at = (x / 0.19).rem_euclid(1.0);
        f64::from(u8::from(at < 0.22)) + 0.6 * f64::from(u8::from((0.5..0.56).contains(&at)))
    };
    let thread = rough(p * 60.0, salt);
    let dark = base * (0.75 + 0.35 * thread);
    let light = DVec3::new(0.62, 0.56, 0.42) * (0.75 + 0.35 * thread);
    dark.lerp(light, (0.45 * (stripe(p.x) + stripe(p.y))).min(0.9))
}

fn leaf(base: DVec3, part: DVec3, salt: u32) -> DVec3 {
    let rib = (1.0 - 9.0 * part.x.abs()).max(0.0);
    let veins = 0.5 + 0.5 * ((part.y + 0.8 * part.x.abs()) * 21.0).sin();
    let tone = 0.7 + 0.35 * rough(DVec2::new(part.x, part.y) * 3.0, salt) + 0.12 * veins;
    (base * tone).lerp(DVec3::new(0.36, 0.42, 0.16), 0.6 * rib)
}

fn book(base: DVec3, hit: &Hit, part: DVec3, salt: u32) -> DVec3 {
    if hit.face / 2 == 1 {
        let page = rough(DVec2::new(hit.local.x * 300.0, 2.0 * hit.local.z), salt);
        return DVec3::new(0.62, 0.57, 0.44) * (0.7 + 0.4 * page);
    }
    let cloth = base * uneven(hit.surface * 40.0, salt);
    if hit.face != 4 {
        return cloth;
    }
    let gold = DVec3::new(0.62, 0.45, 0.14);
    let band = number(0, salt) * 0.3 + 0.55;
    if (part.y.abs() - band).abs() < 0.035 {
        return gold;
    }
    let middle = number(1, salt) * 0.5 - 0.35;
    let from_middle = part.y - middle;
    if from_middle.abs() < 0.26 && part.x.abs() < 0.55 {
        let letter = hash(IVec2::new((from_middle * 34.0).floor() as i32, 3), salt) > 0.38;
        let inked = letter && ((from_middle * 34.0).rem_euclid(1.0)) < 0.75;
        return if inked { gold } else { cloth * 0.55 };
    }
    cloth
}

fn rug(local: DVec3, part: DVec3, salt: u32) -> DVec3 {
    const DYES: [DVec3; 5] = [
        DVec3::new(0.33, 0.05, 0.05),
        DVec3::new(0.05, 0.08, 0.22),
        DVec3::new(0.55, 0.46, 0.30),
        DVec3::new(0.42, 0.23, 0.07),
        DVec3::new(0.10, 0.20, 0.15),
    ];
    let dye = |random: f64| DYES[(random * 5.0) as usize % 5];
    let edge = part.x.abs().max(part.z.abs());
    let flat = DVec2::new(local.x, local.z);
    let colour = if edge > 0.95 {
        DYES[2]
    } else if edge > 0.78 {
        let (at, inside) = cell(flat, 0.12);
        let tooth = (inside - 0.5).abs();
        if tooth.x + tooth.y < 0.36 { dye(hash(at, salt)) } else { DYES[1] }
    } else {
        let (at, inside) = cell(DVec2::from_angle(TAU / 8.0).rotate(flat), 0.21);
        let ring = (inside - 0.5).abs().max_element();
        let layer = if ring < 0.16 { 1 } else { i32::from(ring < 0.36) + 1 };
        dye(hash(at * 3 + IVec2::splat(layer), salt))
    };
    colour * (0.65 + 0.6 * rough(flat * 55.0, salt))
}

/// A picture within a frame of the base colour.
fn framed(base: DVec3, part: DVec3, picture: impl Fn(DVec2) -> DVec3) -> DVec3 {
    let at = DVec2::new(part.x, part.y);
    let edge = at.abs().max_element();
    match edge {
        _ if edge > 0.86 => base * (0.7 + 0.6 * (edge * 90.0).sin().abs()),
        _ if edge > 0.74 => DVec3::new(0.66, 0.63, 0.55),
        _ => picture(at / 0.74),
    }
}

fn landscape(at: DVec2, salt: u32) -> DVec3 {
    let clouds = rough(at * DVec2::new(2.0, 5.0), salt);
    let mut colour = DVec3::new(0.55, 0.38, 0.22).lerp(DVec3::new(0.16, 0.28, 0.45), -at.y);
    colour = colour.lerp(DVec3::new(0.75, 0.62, 0.5), (1.6 * clouds - 0.7).clamp(0.0, 1.0));
    if (at - DVec2::new(0.35, -0.15)).length() < 0.14 {
        colour = DVec3::new(0.85, 0.62, 0.25);
    }
    for hill in 0..4 {
        let depth = f64::from(hill);
        let ridge = 0.05 + 0.22 * depth - 0.5 * rough(DVec2::new(1.7 * at.x, 9.0 * depth), salt);
        if at.y > ridge + 0.15 {
            let near =
                DVec3::new(0.05, 0.12, 0.04).lerp(DVec3::new(0.20, 0.27, 0.33), 1.0 - 0.3 * depth);
            colour = near * (0.6 + 0.7 * rough(at * 14.0, salt.wrapping_add(hill as u32)));
        }
    }
    colour
}

fn fields(at: DVec2, salt: u32) -> DVec3 {
    const COLOURS: [DVec3; 5] = [
        DVec3::new(0.70, 0.66, 0.55),
        DVec3::new(0.52, 0.07, 0.05),
        DVec3::new(0.07, 0.13, 0.38),
        DVec3::new(0.68, 0.47, 0.07),
        DVec3::new(0.70, 0.66, 0.55),
    ];
    let column = ((at.x + 1.0) * 2.2).floor();
    let x = ((at.x + 1.0) * 2.2).fract();
    let height = 1.4 + 1.6 * number(column as i32, salt);
    let (row, y) = (((at.y + 1.0) * height).floor(), ((at.y + 1.0) * height).fract());
    if x < 0.09 || y < 0.07 {
        return DVec3::splat(0.03);
    }
    let field = hash(IVec2::new(column as i32, row as i32), salt);
    COLOURS[(field * 5.0) as usize % 5] * uneven(at * 25.0, salt)
}

/// Two kinds of wall above boards, bricks on the right, planks below, plaster above.
fn wall(hit: &Hit, salt: u32) -> DVec3 {
    /// Upper edge of the boards, below the middle of the room, world units.
    const BOARDS: f64 = 0.62;
    let DVec3 { x, y, z } = hit.local;
    match hit.face {
        1 => bricks(DVec2::new(z, y), salt),
        2 => DVec3::new(0.55, 0.53, 0.48) * uneven(DVec2::new(x, z) * 3.0, salt),
        3 => planks(DVec2::new(x, z), salt),
        0 | 4 if y < BOARDS => {
            DVec3::new(0.24, 0.30, 0.26) * (0.6 + 0.6 * rough(DVec2::new(y, z + x) * 4.0, salt))
        }
        5 if y < BOARDS => paper(DVec2::new(x, y), salt),
        face => {
            let across = if face == 5 { x } else { z + x };
            let groove = (across / 0.28).rem_euclid(1.0);
            let ledge = y - BOARDS < 0.05 || groove < 0.04;
            let tone = if ledge { 0.45 } else { 0.85 };
            DVec3::new(0.50, 0.46, 0.37) * tone * uneven(DVec2::new(across * 30.0, y * 3.0), salt)
        }
    }
}

fn bricks(p: DVec2, salt: u32) -> DVec3 {
    let row = (p.y / 0.1).floor();
    let shifted = p.x / 0.29 + 0.5 * row.rem_euclid(2.0);
    let inside = DVec2::new(shifted.rem_euclid(1.0), (p.y / 0.1).rem_euclid(1.0));
    let grain = rough(p * 26.0, salt);
    if inside.x < 0.05 || inside.y < 0.13 {
        return DVec3::new(0.36, 0.33, 0.29) * (0.7 + 0.4 * grain);
    }
    let fired = hash(IVec2::new(shifted.floor() as i32, row as i32), salt);
    let clay = DVec3::new(0.46, 0.17, 0.10).lerp(DVec3::new(0.20, 0.08, 0.07), fired);
    let pale = f64::from(u8::from(fired > 0.9));
    clay.lerp(DVec3::new(0.52, 0.38, 0.27), pale) * (0.5 + 0.9 * grain)
}

fn planks(p: DVec2, salt: u32) -> DVec3 {
    let column = (p.x / 0.18).floor();
    let along = p.y / 1.25 + 7.0 * number(column as i32, salt);
    let inside = DVec2::new((p.x / 0.18).rem_euclid(1.0), along.rem_euclid(1.0));
    if inside.x < 0.035 || inside.y < 0.008 {
        return DVec3::new(0.06, 0.04, 0.025);
    }
    let plank = IVec2::new(column as i32, along.floor() as i32);
    let tone = 0.55 + 0.5 * hash(plank, salt);
    let own = salt.wrapping_add((hash(plank, 3) * 1e6) as u32);
    let fibre = rough(DVec2::new(p.x * 60.0, p.y * 3.0), own);
    let knot = (rough(p * DVec2::new(7.0, 3.0), own) - 0.72).max(0.0) * 3.0;
    DVec3::new(0.40, 0.24, 0.12) * tone * (0.6 + 0.7 * fibre) * (1.0 - knot)
}

/// Rows of unique flowers on an unevenly aged ground.
fn paper(p: DVec2, salt: u32) -> DVec3 {
    let ground = DVec3::new(0.13, 0.24, 0.25) * (0.65 + 0.6 * rough(p * 2.2, salt));
    let column = (p.x / 0.34).floor();
    let (at, inside) = cell(p + DVec2::new(0.0, 0.17 * column.rem_euclid(2.0)), 0.34);
    let petals = 5.0 + (hash(at, salt) * 4.0).floor();
    let offset = inside - 0.5;
    let angle = offset.y.atan2(offset.x) + TAU * hash(at, salt ^ 5);
    let rim = 0.2 + 0.07 * hash(at, salt ^ 7) + 0.09 * (petals * angle).cos();
    let flower = match offset.length() {
        r if r < 0.07 => DVec3::new(0.55, 0.40, 0.12),
        r if r < rim => {
            DVec3::new(0.50, 0.30, 0.24).lerp(DVec3::new(0.52, 0.47, 0.36), hash(at, salt ^ 11))
        }
        r if r < rim + 0.035 => DVec3::new(0.05, 0.10, 0.11),
        _ => return ground,
    };
    flower * (0.7 + 0.5 * rough(p * 24.0, salt))
}

/// Light, not albedo.
fn dusk(part: DVec3, salt: u32) -> DVec3 {
    let at = DVec2::new(part.x, part.y);
    let height = ((0.7 - at.y) / 1.7).clamp(0.0, 1.0);
    let clouds = rough(at * DVec2::new(1.5, 5.0), salt);
    let mut light =
        DVec3::new(0.95, 0.42, 0.14).lerp(DVec3::new(0.05, 0.10, 0.30), height.powf(0.6));
    light += DVec3::new(0.35, 0.14, 0.10) * (1.7 * clouds - 0.8).max(0.0);
    for street in 0..2 {
        let far = f64::from(street);
        let shifted = (at.x + 1.3 * far) * (4.5 + 2.0 * far);
        let house = number(shifted.floor() as i32, salt ^ street);
        let roof = 0.05 + 0.3 * far + 0.45 * house;
        let gable = 0.08 * (shifted.rem_euclid(1.0) - 0.5).abs();
        if at.y > roof + gable {
            let (window, inside) = cell(at, 0.075);
            let is_lit = hash(window, salt ^ street) < 0.3 && inside.min_element() > 0.35;
            light = if is_lit {
                DVec3::new(0.95, 0.62, 0.22)
            } else {
                DVec3::new(0.05, 0.04, 0.07) * (1.6 - 0.8 * far)
            };
        }
    }
    light
}
