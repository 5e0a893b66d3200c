//! A room: its solids, its lamps, and ray casting.

use glam::{DMat3, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::paint::{Coat, Paint};
use super::shape::{Hit, Shape};
use super::texture::wallpaper;
use crate::camera::Camera;
use crate::image::{Image, Linear};

/// The only lamp of the numbered rooms, above and in front of the solids. y points down.
const LAMP: DVec3 = DVec3::new(0.7, -2.2, -1.6);

/// Distance from the lamp at which a white surface facing it is white in the ground truth.
const WHITE_AT: f64 = 2.6;

/// Light on every surface, lit or not, as a share of white.
const AMBIENT: f64 = 0.1;

/// A solid with its material.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solid {
    pub shape: Shape,
    pub coat: Coat,
}

/// A point light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lamp {
    pub place: DVec3,
    pub colour: DVec3,
    /// Distance at which a white surface facing it is as bright as `colour`.
    pub white_at: f64,
}

/// A group of solids: a ray that misses its bounding ball misses all of them.
pub(super) struct Group {
    ball: Bound,
    solids: Vec<(Bound, Solid)>,
}

/// A bounding ball.
#[derive(Clone, Copy, Debug)]
struct Bound {
    centre: DVec3,
    /// Infinite for solids that surround everything.
    radius_squared: f64,
}

impl Bound {
    const EVERYTHING: Self = Self { centre: DVec3::ZERO, radius_squared: f64::INFINITY };

    fn is_passed_by(&self, origin: DVec3, ray: DVec3, length_squared: f64) -> bool {
        let way = self.centre - origin;
        let along = way.dot(ray).max(0.0);
        way.length_squared() - along * along / length_squared > self.radius_squared
    }
}

impl Group {
    /// A group with bounding balls.
    pub fn around(solids: Vec<Solid>) -> Self {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let bounded = solids.into_iter().map(|solid| {
            let (centre, reach) = (solid.shape.centre(), solid.shape.half().length());
            (low, high) = (low.min(centre - reach), high.max(centre + reach));
            let radius_squared = reach * reach;
            (Bound { centre, radius_squared }, solid)
        });
        let solids = bounded.collect();
        let ball = Bound {
            centre: 0.5 * (low + high),
            radius_squared: 0.25 * (high - low).length_squared(),
        };
        Self { ball, solids }
    }

    #[cfg(test)]
    pub fn solids(&self) -> impl Iterator<Item = &Solid> {
        self.solids.iter().map(|(_, solid)| solid)
    }

    /// A group without bounds: every ray is tested against each solid.
    pub fn everywhere(solids: Vec<Solid>) -> Self {
        let unbounded = solids.into_iter().map(|solid| (Bound::EVERYTHING, solid));
        Self { ball: Bound::EVERYTHING, solids: unbounded.collect() }
    }
}

/// Groups in the order in which they were added.
pub(super) struct Room {
    pub groups: Vec<Group>,
    pub lamps: Vec<Lamp>,
    /// Light on every surface.
    pub ambient: DVec3,
    /// Scale of the patterns on all surfaces, usually 1.
    pub scale: f64,
    /// Photographs on the surfaces, which are painted if there are none.
    pub wallpapers: Vec<Image<Linear>>,
}

impl Room {
    /// Walls, floor, and solids at many depths around the origin. All measurements use room 0; the
    /// others have the same plan with other paint, patterns and sizes.
    pub fn numbered(number: u64) -> Self {
        let mut solids = first();
        let mut scale = 1.0;
        if number > 0 {
            let mut rng = Pcg64Mcg::seed_from_u64(number);
            scale = rng.random_range(0.6..1.8);
            redecorate(&mut solids, &mut rng);
        }
        Self {
            groups: vec![Group::around(solids)],
            lamps: vec![Lamp { place: LAMP, colour: DVec3::ONE, white_at: WHITE_AT }],
            ambient: DVec3::splat(AMBIENT),
            scale,
            wallpapers: Vec::new(),
        }
    }

    /// Puts photographs on all surfaces, if there are any.
    pub fn papered(self, wallpapers: Vec<Image<Linear>>) -> Self {
        Self { wallpapers, ..self }
    }

    /// Renders through `camera` in linear light, 1 is white: the mean of rays at `offsets` in each
    /// pixel.
    pub fn render_at(&self, camera: &Camera, offsets: &[DVec2]) -> Image<Linear> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let mut image = Image::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let corner = DVec2::new(x as f64, y as f64);
                let sum: DVec3 =
                    offsets.iter().map(|offset| self.trace(camera, corner + *offset).1).sum();
                image.set(x, y, (sum / offsets.len() as f64).to_array().map(|v| v as f32));
            }
        }
        image
    }

    /// Distance along the ray through a pixel (in multiples of a ray of depth 1), and colour.
    fn trace(&self, camera: &Camera, pixel: DVec2) -> (f64, DVec3) {
        let k = &camera.intrinsics;
        let to_world: DMat3 = camera.rotation().transpose();
        let ray = to_world * DVec3::new((pixel.x - k.cx) / k.fx, (pixel.y - k.cy) / k.fy, 1.0);
        let origin = camera.centre();
        let Some((solid, hit)) = self.nearest(origin, ray) else {
            return (f64::INFINITY, DVec3::ZERO);
        };
        let salt = solid.coat.salt.wrapping_add(hit.face);
        let paint = if self.wallpapers.is_empty() {
            solid.coat.albedo(&hit, solid.shape.half(), self.scale)
        } else {
            wallpaper(hit.surface, &self.wallpapers, salt, self.scale)
        };
        let paint = DVec3::from(paint);
        if solid.coat.glows() {
            return (hit.distance, paint);
        }
        let light = self.lamp_light(origin + ray * hit.distance, hit.normal);
        (hit.distance, paint * (self.ambient + light))
    }

    /// The first hit of a ray.
    fn nearest(&self, origin: DVec3, ray: DVec3) -> Option<(&Solid, Hit)> {
        self.met(origin, ray).min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))
    }

    /// All hits of a ray, unordered.
    fn met(&self, origin: DVec3, ray: DVec3) -> impl Iterator<Item = (&Solid, Hit)> {
        let length = ray.length_squared();
        let misses = move |bound: &Bound| bound.is_passed_by(origin, ray, length);
        self.groups
            .iter()
            .filter(move |group| !misses(&group.ball))
            .flat_map(|group| &group.solids)
            .filter(move |(bound, _)| !misses(bound))
            .filter_map(move |(_, solid)| solid.shape.meet(origin, ray).map(|hit| (solid, hit)))
    }

    /// Light of the lamps on a surface: it falls with the square of the distance, and solids cast
    /// shadows unless they glow.
    fn lamp_light(&self, point: DVec3, normal: DVec3) -> DVec3 {
        let of = |lamp: &Lamp| {
            let way = lamp.place - point;
            let facing = normal.dot(way.normalize());
            if facing <= 0.0 {
                return DVec3::ZERO;
            }
            let from = point + normal * 1e-6;
            let is_hidden =
                self.met(from, way).any(|(solid, hit)| hit.distance < 1.0 && !solid.coat.glows());
            if is_hidden {
                return DVec3::ZERO;
            }
            lamp.colour * (facing * lamp.white_at * lamp.white_at / way.length_squared())
        };
        self.lamps.iter().map(of).sum()
    }

    /// Nearest and farthest depth in a camera's picture, on a coarse grid.
    pub fn depth_range(&self, camera: &Camera) -> (f64, f64) {
        let depths = self.depths(camera);
        (
            depths.iter().copied().fold(f64::INFINITY, f64::min),
            depths.iter().copied().fold(0.0, f64::max),
        )
    }

    /// Median depth in a camera's picture.
    pub fn focus_distance(&self, camera: &Camera) -> f64 {
        let mut depths = self.depths(camera);
        depths.sort_by(f64::total_cmp);
        depths[depths.len() / 2]
    }

    fn depths(&self, camera: &Camera) -> Vec<f64> {
        let size = DVec2::new(camera.intrinsics.width as f64, camera.intrinsics.height as f64);
        let pixel =
            |i: usize| DVec2::new((i % 24) as f64 + 0.5, (i / 24) as f64 + 0.5) / 24.0 * size;
        (0..24 * 24).map(|i| self.trace(camera, pixel(i)).0).collect()
    }
}

fn redecorate(solids: &mut [Solid], rng: &mut Pcg64Mcg) {
    for solid in solids {
        solid.coat.base = std::array::from_fn(|_| rng.random_range(0.08..0.55));
        solid.coat.salt = rng.random();
        let moved = DVec3::new(rng.random_range(-0.25..0.25), 0.0, rng.random_range(-0.25..0.25));
        let grown = rng.random_range(0.8..1.2);
        match &mut solid.shape {
            Shape::Block { centre, half, turn, .. } => {
                let half = *half * DVec3::new(grown, 1.0, rng.random_range(0.8..1.2));
                let turn = *turn + rng.random_range(-1.0..1.0);
                solid.shape = Shape::block(*centre + moved, half, turn);
            }
            Shape::Ball { centre, radius } => {
                *centre += moved;
                *radius *= grown;
            }
            Shape::Ellipsoid { .. } | Shape::Walls { .. } => {}
        }
    }
}

fn first() -> Vec<Solid> {
    let solid =
        |shape, base, salt| Solid { shape, coat: Coat { paint: Paint::Patterned, base, salt } };
    let walls =
        Shape::Walls { centre: DVec3::new(0.0, -1.0, 0.0), half: DVec3::new(4.6, 2.4, 4.2) };
    let mut solids = vec![solid(walls, [0.32, 0.29, 0.25], 1)];
    let blocks = [
        ([-1.1, 0.8, 0.3], [0.5, 0.6, 0.4], 0.5, [0.5, 0.2, 0.15]),
        ([0.9, 0.95, 0.9], [0.45, 0.45, 0.5], -0.7, [0.15, 0.3, 0.5]),
        ([0.1, 1.1, -0.7], [0.35, 0.3, 0.3], 0.2, [0.4, 0.42, 0.15]),
        ([2.1, 0.6, 1.9], [0.4, 0.8, 0.4], 0.9, [0.2, 0.4, 0.25]),
        ([-2.3, 0.4, 1.8], [0.5, 1.0, 0.35], -0.3, [0.45, 0.35, 0.3]),
        ([-0.2, 0.2, 2.4], [0.7, 1.2, 0.3], 0.1, [0.3, 0.2, 0.4]),
    ];
    for (index, (centre, half, turn, base)) in blocks.into_iter().enumerate() {
        let shape = Shape::block(DVec3::from(centre), DVec3::from(half), turn);
        solids.push(solid(shape, base, 11 + 7 * index as u32));
    }
    let balls = [
        ([-1.1, -0.12, 0.3], 0.32, [0.5, 0.45, 0.1]),
        ([0.95, 0.2, 0.95], 0.3, [0.5, 0.15, 0.3]),
        ([1.5, 1.1, -0.5], 0.3, [0.15, 0.4, 0.4]),
    ];
    for (index, (centre, radius, base)) in balls.into_iter().enumerate() {
        let shape = Shape::Ball { centre: DVec3::from(centre), radius };
        solids.push(solid(shape, base, 101 + 7 * index as u32));
    }
    solids
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: DVec3 = DVec3::new(0.0, -1.0, 0.0);
    const BELOW_THE_LAMP: DVec3 = DVec3::new(0.7, 1.4, -1.6);
    const BEHIND_A_BLOCK: DVec3 = DVec3::new(-0.01, 1.4, -0.3);

    #[test]
    fn light_falls_with_the_squared_distance_and_the_cosine() {
        let room = Room::numbered(0);
        let (below, height) = (room.lamp_light(BELOW_THE_LAMP, UP).x, 3.6);
        assert!((below - (WHITE_AT / height).powi(2)).abs() < 1e-9, "{below}");
        let aside = BELOW_THE_LAMP - DVec3::new(0.0, 0.0, 1.8);
        let expected = WHITE_AT.powi(2) * height / (height * height + 1.8 * 1.8).powf(1.5);
        assert!((room.lamp_light(aside, UP).x - expected).abs() < 1e-9);
        assert_eq!(room.lamp_light(BELOW_THE_LAMP, -UP), DVec3::ZERO);
    }

    #[test]
    fn blocks_cast_shadows_and_glowing_solids_do_not() {
        let mut room = Room::numbered(0);
        assert_eq!(room.lamp_light(BEHIND_A_BLOCK, UP), DVec3::ZERO);
        let solids = &mut room.groups[0].solids;
        solids.iter_mut().for_each(|(_, solid)| solid.coat.paint = Paint::Glow);
        assert!(room.lamp_light(BEHIND_A_BLOCK, UP).x > 0.3);
    }

    #[test]
    fn a_ray_that_misses_a_bound_misses_its_solids() {
        let mut rng = Pcg64Mcg::seed_from_u64(4);
        let group = Group::around(first().split_off(1));
        let (mut groups, mut solids) = (0, 0);
        for _ in 0..2000 {
            let mut random = |size: f64| size * (2.0 * rng.random::<f64>() - 1.0);
            let origin = DVec3::new(random(6.0), random(6.0), random(6.0));
            let ray = DVec3::new(random(1.0), random(1.0), random(1.0));
            let misses = |bound: &Bound| bound.is_passed_by(origin, ray, ray.length_squared());
            let passes = misses(&group.ball);
            groups += usize::from(passes);
            for (bound, solid) in &group.solids {
                let is_met = solid.shape.meet(origin, ray).is_some();
                assert!(!(is_met && (passes || misses(bound))), "{origin} {ray}");
                solids += usize::from(misses(bound));
            }
        }
        assert!((100..1900).contains(&groups), "{groups} of 2000");
        assert!(solids > 9000, "{solids} of 18000");
    }
}
