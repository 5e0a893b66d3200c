//! The room: what stands in it, and casting rays at it.

use glam::{DMat3, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::texture::{albedo, wallpaper};
use crate::camera::Camera;
use crate::image::{Image, Linear};

/// The one lamp, above and before the things. y points down.
const LAMP: DVec3 = DVec3::new(0.7, -2.2, -1.6);

/// Distance from the lamp at which a white surface that faces it is white in the ground truth.
const WHITE_AT: f64 = 2.6;

/// Light that reaches every surface, lit or not, as a share of the white.
const AMBIENT: f64 = 0.1;

/// A solid.
#[derive(Clone, Copy, Debug)]
enum Shape {
    /// An axis-aligned box in its own frame, turned about the vertical.
    Block {
        centre: DVec3,
        half: DVec3,
        turn: f64,
    },
    /// A ball.
    Ball { centre: DVec3, radius: f64 },
    /// The inside of a box: the room's walls.
    Walls { centre: DVec3, half: DVec3 },
}

/// A solid with its paint.
#[derive(Clone, Copy, Debug)]
struct Solid {
    shape: Shape,
    base: [f64; 3],
    salt: u32,
}

/// Where a ray meets a surface.
struct Hit {
    distance: f64,
    normal: DVec3,
    /// Surface coordinates, world units.
    surface: DVec2,
    /// Tells faces of one solid apart.
    face: u32,
}

/// Solids in the order in which they were put up.
pub(super) struct Room {
    solids: Vec<Solid>,
    /// Of the patterns on all surfaces, 1 as a rule.
    scale: f64,
    /// What the surfaces are papered with; none: they are painted.
    wallpapers: Vec<Image<Linear>>,
}

impl Room {
    /// Walls, floor, and things at many depths around the origin. Room 0 is the one that everything
    /// is measured in; the others have its plan, with other paint, patterns and sizes.
    pub fn new(number: u64, wallpapers: Vec<Image<Linear>>) -> Self {
        let mut room = Self {
            wallpapers,
            ..Self::first()
        };
        if number > 0 {
            room.redecorate(&mut Pcg64Mcg::seed_from_u64(number));
        }
        room
    }

    fn redecorate(&mut self, rng: &mut Pcg64Mcg) {
        self.scale = rng.random_range(0.6..1.8);
        for solid in &mut self.solids {
            solid.base = std::array::from_fn(|_| rng.random_range(0.08..0.55));
            solid.salt = rng.random();
            let moved = DVec3::new(
                rng.random_range(-0.25..0.25),
                0.0,
                rng.random_range(-0.25..0.25),
            );
            let grown = rng.random_range(0.8..1.2);
            match &mut solid.shape {
                Shape::Block { centre, half, turn } => {
                    *centre += moved;
                    *half *= DVec3::new(grown, 1.0, rng.random_range(0.8..1.2));
                    *turn += rng.random_range(-1.0..1.0);
                }
                Shape::Ball { centre, radius } => {
                    *centre += moved;
                    *radius *= grown;
                }
                Shape::Walls { .. } => {}
            }
        }
    }

    fn first() -> Self {
        let mut solids = vec![Solid {
            shape: Shape::Walls {
                centre: DVec3::new(0.0, -1.0, 0.0),
                half: DVec3::new(4.6, 2.4, 4.2),
            },
            base: [0.32, 0.29, 0.25],
            salt: 1,
        }];
        let blocks = [
            ([-1.1, 0.8, 0.3], [0.5, 0.6, 0.4], 0.5, [0.5, 0.2, 0.15]),
            ([0.9, 0.95, 0.9], [0.45, 0.45, 0.5], -0.7, [0.15, 0.3, 0.5]),
            ([0.1, 1.1, -0.7], [0.35, 0.3, 0.3], 0.2, [0.4, 0.42, 0.15]),
            ([2.1, 0.6, 1.9], [0.4, 0.8, 0.4], 0.9, [0.2, 0.4, 0.25]),
            ([-2.3, 0.4, 1.8], [0.5, 1.0, 0.35], -0.3, [0.45, 0.35, 0.3]),
            ([-0.2, 0.2, 2.4], [0.7, 1.2, 0.3], 0.1, [0.3, 0.2, 0.4]),
        ];
        for (index, (centre, half, turn, base)) in blocks.into_iter().enumerate() {
            let shape = Shape::Block {
                centre: DVec3::from(centre),
                half: DVec3::from(half),
                turn,
            };
            solids.push(Solid {
                shape,
                base,
                salt: 11 + 7 * index as u32,
            });
        }
        let balls = [
            ([-1.1, -0.12, 0.3], 0.32, [0.5, 0.45, 0.1]),
            ([0.95, 0.2, 0.95], 0.3, [0.5, 0.15, 0.3]),
            ([1.5, 1.1, -0.5], 0.3, [0.15, 0.4, 0.4]),
        ];
        for (index, (centre, radius, base)) in balls.into_iter().enumerate() {
            let shape = Shape::Ball {
                centre: DVec3::from(centre),
                radius,
            };
            solids.push(Solid {
                shape,
                base,
                salt: 101 + 7 * index as u32,
            });
        }
        Self {
            solids,
            scale: 1.0,
            wallpapers: Vec::new(),
        }
    }

    /// The picture through `camera`, linear light 0..1: the mean of rays at `offsets` in each
    /// pixel.
    pub fn render_at(&self, camera: &Camera, offsets: &[DVec2]) -> Image<Linear> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let mut image = Image::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let corner = DVec2::new(x as f64, y as f64);
                let sum: DVec3 = offsets
                    .iter()
                    .map(|offset| self.trace(camera, corner + *offset).1)
                    .sum();
                image.set(
                    x,
                    y,
                    (sum / offsets.len() as f64).to_array().map(|v| v as f32),
                );
            }
        }
        image
    }

    /// Distance along the ray through a pixel (in multiples of a ray of depth 1) and colour.
    fn trace(&self, camera: &Camera, pixel: DVec2) -> (f64, DVec3) {
        let k = &camera.intrinsics;
        let to_world: DMat3 = camera.rotation().transpose();
        let ray = to_world * DVec3::new((pixel.x - k.cx) / k.fx, (pixel.y - k.cy) / k.fy, 1.0);
        let origin = camera.centre();
        let Some((solid, hit)) = self.nearest(origin, ray) else {
            return (f64::INFINITY, DVec3::ZERO);
        };
        let salt = solid.salt.wrapping_add(hit.face);
        let paint = if self.wallpapers.is_empty() {
            albedo(hit.surface, solid.base, salt, self.scale)
        } else {
            wallpaper(hit.surface, &self.wallpapers, salt, self.scale)
        };
        (
            hit.distance,
            DVec3::from(paint)
                * (AMBIENT + self.lamp_light(origin + ray * hit.distance, hit.normal)),
        )
    }

    /// What a ray meets first.
    fn nearest(&self, origin: DVec3, ray: DVec3) -> Option<(&Solid, Hit)> {
        self.solids
            .iter()
            .filter_map(|solid| solid.shape.meet(origin, ray).map(|hit| (solid, hit)))
            .min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))
    }

    /// Light of the lamp on a surface: it falls with the square of the distance, and things throw
    /// shadows.
    fn lamp_light(&self, point: DVec3, normal: DVec3) -> f64 {
        let way = LAMP - point;
        let facing = normal.dot(way.normalize());
        if facing <= 0.0 {
            return 0.0;
        }
        let lit = self
            .nearest(point + normal * 1e-6, way)
            .is_none_or(|(_, hit)| hit.distance >= 1.0);
        if lit {
            facing * WHITE_AT * WHITE_AT / way.length_squared()
        } else {
            0.0
        }
    }

    /// Nearest and farthest depth that a camera sees, on a coarse grid.
    pub fn depth_range(&self, camera: &Camera) -> (f64, f64) {
        let depths = self.depths(camera);
        (
            depths.iter().copied().fold(f64::INFINITY, f64::min),
            depths.iter().copied().fold(0.0, f64::max),
        )
    }

    /// Median depth that a camera sees.
    pub fn focus_distance(&self, camera: &Camera) -> f64 {
        let mut depths = self.depths(camera);
        depths.sort_by(f64::total_cmp);
        depths[depths.len() / 2]
    }

    fn depths(&self, camera: &Camera) -> Vec<f64> {
        let size = DVec2::new(
            camera.intrinsics.width as f64,
            camera.intrinsics.height as f64,
        );
        let pixel =
            |i: usize| DVec2::new((i % 24) as f64 + 0.5, (i / 24) as f64 + 0.5) / 24.0 * size;
        (0..24 * 24)
            .map(|i| self.trace(camera, pixel(i)).0)
            .collect()
    }
}

impl Shape {
    /// The first meeting in front of the origin.
    fn meet(&self, origin: DVec3, ray: DVec3) -> Option<Hit> {
        match *self {
            Self::Ball { centre, radius } => meet_ball(origin - centre, ray, radius),
            Self::Walls { centre, half } => {
                let (_, (far, axis)) = slabs(origin - centre, ray, half)?;
                let mut hit = face(origin - centre, ray, far, axis);
                hit.normal = -hit.normal;
                Some(hit)
            }
            Self::Block { centre, half, turn } => {
                let frame = DMat3::from_rotation_y(turn);
                let (origin, ray) = (
                    frame.transpose() * (origin - centre),
                    frame.transpose() * ray,
                );
                let ((near, axis), (far, _)) = slabs(origin, ray, half)?;
                if near <= 1e-6 || near > far {
                    return None;
                }
                let hit = face(origin, ray, near, axis);
                Some(Hit {
                    normal: frame * hit.normal,
                    ..hit
                })
            }
        }
    }
}

/// Entry and exit of a box around the origin: distance and axis; `None` when it lies behind.
fn slabs(origin: DVec3, ray: DVec3, half: DVec3) -> Option<((f64, usize), (f64, usize))> {
    let (mut near, mut far) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
    for axis in 0..3 {
        let inverse = 1.0 / ray[axis];
        let a = (-half[axis] - origin[axis]) * inverse;
        let b = (half[axis] - origin[axis]) * inverse;
        if a.min(b) > near.0 {
            near = (a.min(b), axis);
        }
        if a.max(b) < far.0 {
            far = (a.max(b), axis);
        }
    }
    (far.0 > 1e-6).then_some((near, far))
}

/// The outside of a box's face at a distance along the ray.
fn face(origin: DVec3, ray: DVec3, distance: f64, axis: usize) -> Hit {
    let point = origin + ray * distance;
    let mut normal = DVec3::ZERO;
    normal[axis] = point[axis].signum();
    let surface = DVec2::new(point[(axis + 1) % 3], point[(axis + 2) % 3]);
    Hit {
        distance,
        normal,
        surface,
        face: 2 * axis as u32 + u32::from(point[axis] > 0.0),
    }
}

fn meet_ball(origin: DVec3, ray: DVec3, radius: f64) -> Option<Hit> {
    let (a, b) = (ray.length_squared(), origin.dot(ray));
    let discriminant = b * b - a * (origin.length_squared() - radius * radius);
    if discriminant <= 0.0 {
        return None;
    }
    let distance = (-b - discriminant.sqrt()) / a;
    let normal = (origin + ray * distance) / radius;
    let surface = DVec2::new(normal.z.atan2(normal.x), normal.y.clamp(-1.0, 1.0).asin()) * radius;
    (distance > 1e-6).then_some(Hit {
        distance,
        normal,
        surface,
        face: 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: DVec3 = DVec3::new(0.0, -1.0, 0.0);
    const BELOW_THE_LAMP: DVec3 = DVec3::new(0.7, 1.4, -1.6);
    const BEHIND_A_BLOCK: DVec3 = DVec3::new(-0.01, 1.4, -0.3);

    #[test]
    fn the_lamp_falls_off_with_the_square_of_the_distance_and_the_cosine() {
        let room = Room::new(0, Vec::new());
        let (below, height) = (room.lamp_light(BELOW_THE_LAMP, UP), 3.6);
        assert!(
            (below - (WHITE_AT / height).powi(2)).abs() < 1e-9,
            "{below}"
        );
        let aside = BELOW_THE_LAMP - DVec3::new(0.0, 0.0, 1.8);
        let expected = WHITE_AT.powi(2) * height / (height * height + 1.8 * 1.8).powf(1.5);
        assert!((room.lamp_light(aside, UP) - expected).abs() < 1e-9);
        assert_eq!(room.lamp_light(BELOW_THE_LAMP, -UP), 0.0);
    }

    #[test]
    fn what_a_block_hides_from_the_lamp_is_in_its_shadow() {
        let mut room = Room::new(0, Vec::new());
        assert_eq!(room.lamp_light(BEHIND_A_BLOCK, UP), 0.0);
        room.solids.truncate(1);
        assert!(room.lamp_light(BEHIND_A_BLOCK, UP) > 0.3);
    }
}
