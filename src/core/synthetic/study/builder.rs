//! The builder of pieces of furniture.

use glam::{DMat3, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::super::paint::{Coat, Paint};
use super::super::room::Solid;
use super::super::shape::Shape;

pub(super) const OAK: [f64; 3] = [0.36, 0.20, 0.09];
pub(super) const WALNUT: [f64; 3] = [0.19, 0.10, 0.05];
pub(super) const PAINTED: [f64; 3] = [0.55, 0.52, 0.45];
pub(super) const BRASS: [f64; 3] = [0.48, 0.33, 0.10];

/// Collects the solids of a piece of furniture.
pub(super) struct Builder {
    rng: Pcg64Mcg,
    /// The solids added since they were last taken.
    pub solids: Vec<Solid>,
    salt: u32,
}

impl Builder {
    pub fn new() -> Self {
        Self { rng: Pcg64Mcg::seed_from_u64(0x57d1), solids: Vec::new(), salt: 1000 }
    }

    pub fn solid(&mut self, shape: Shape, paint: Paint, base: [f64; 3]) -> Solid {
        self.salt = self.salt.wrapping_add(37);
        let salt = self.salt;
        let coat = Coat { paint, base, salt };
        Solid { shape, coat }
    }

    pub fn add(&mut self, shape: Shape, paint: Paint, base: [f64; 3]) {
        let solid = self.solid(shape, paint, base);
        self.solids.push(solid);
    }

    pub fn block(&mut self, centre: [f64; 3], half: [f64; 3], paint: Paint, base: [f64; 3]) {
        self.turned(centre, half, 0.0, paint, base);
    }

    pub fn turned(
        &mut self,
        centre: [f64; 3],
        half: [f64; 3],
        turn: f64,
        paint: Paint,
        base: [f64; 3],
    ) {
        let shape = Shape::block(DVec3::from(centre), DVec3::from(half), turn);
        self.add(shape, paint, base);
    }

    pub fn ellipsoid(&mut self, centre: [f64; 3], half: [f64; 3], paint: Paint, base: [f64; 3]) {
        let shape = Shape::Ellipsoid {
            centre: DVec3::from(centre),
            half: DVec3::from(half),
            frame: DMat3::IDENTITY,
        };
        self.add(shape, paint, base);
    }

    pub fn ball(&mut self, centre: [f64; 3], radius: f64, paint: Paint, base: [f64; 3]) {
        let centre = DVec3::from(centre);
        self.add(Shape::Ball { centre, radius }, paint, base);
    }

    pub fn random(&mut self, low: f64, high: f64) -> f64 {
        self.rng.random_range(low..high)
    }

    /// A muted colour.
    pub fn cloth(&mut self) -> [f64; 3] {
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

/// A point of a piece of furniture that is rotated about the vertical.
pub(super) fn placed(origin: [f64; 3], turn: f64, offset: [f64; 3]) -> [f64; 3] {
    (DVec3::from(origin) + DMat3::from_rotation_y(turn) * DVec3::from(offset)).to_array()
}
