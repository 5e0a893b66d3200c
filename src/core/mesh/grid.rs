//! A truncated signed distance in blocks of voxels near the surfaces, and its fusion.

use std::collections::{HashMap, HashSet};

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::view::View;

/// Voxels of a block along each axis.
pub(super) const SIDE: i32 = 8;

/// Voxels of a block.
const VOLUME: usize = (SIDE * SIDE * SIDE) as usize;

/// Most blocks: 256 MiB.
const MOST_BLOCKS: usize = 1 << 16;

/// Error of a depth, of itself, within which views see the same surface.
const DEPTH_ERROR: f32 = 0.03;

/// Views that must see a surface.
const LEAST_VIEWS: u32 = 2;

/// Where blocks are sought along a ray about the surface, of the truncation: closer than a block.
const REACHES: [f32; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];

/// Pixels from one sample to the next where blocks are sought.
const STRIDE: usize = 2;

/// A voxel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Voxel {
    /// Signed distance to the surface, of the truncation, positive on the cameras' side; NaN where
    /// too few views see a surface.
    pub distance: f32,
    /// sRGB.
    pub colour: [u8; 3],
}

/// Lengths of a grid, training units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    /// Side of a voxel.
    pub voxel: f32,
    /// Distance from a surface at which its signed distance is truncated.
    pub truncation: f32,
}

/// Blocks by their place, in a fixed order.
pub(super) struct Grid {
    /// Side of a voxel, training units.
    pub voxel: f32,
    pub places: Vec<IVec3>,
    blocks: HashMap<IVec3, Vec<Voxel>>,
}

/// Sums of a voxel over the views.
#[derive(Clone, Copy, Default)]
struct Sum {
    distance: f32,
    weight: f32,
    colour: Vec3,
    colour_weight: f32,
    views: u32,
}

/// The places of the blocks near the surfaces that views see, sorted; `None` if they are too many.
pub(super) fn blocks(views: &[View], scale: Scale) -> Option<Vec<IVec3>> {
    let mut found: HashSet<IVec3> = HashSet::new();
    let side = scale.voxel * SIDE as f32;
    for view in views {
        for row in (0..view.height).step_by(STRIDE) {
            let mut last = [IVec3::MAX; REACHES.len()];
            for column in (0..view.width).step_by(STRIDE) {
                let index = row * view.width + column;
                let pixel = view.pixels[index];
                if pixel.facing == 0 {
                    continue;
                }
                let ray = view.ray(index);
                for (place, reach) in last.iter_mut().zip(REACHES) {
                    let point = view.in_world(ray * (pixel.depth + reach * scale.truncation));
                    let here = (point / side).floor().as_ivec3();
                    if here != *place {
                        found.insert(here);
                        *place = here;
                    }
                }
            }
            if found.len() > MOST_BLOCKS {
                return None;
            }
        }
    }
    let mut places: Vec<IVec3> = found.into_iter().collect();
    places.sort_unstable_by_key(IVec3::to_array);
    Some(places)
}

impl Grid {
    /// Fuses the views. A voxel's sums follow the order of the views.
    pub fn fused(places: Vec<IVec3>, views: &[View], scale: Scale) -> Self {
        let fused = places.par_iter().map(|place| (*place, fuse(*place, views, scale)));
        Self { voxel: scale.voxel, blocks: fused.collect(), places }
    }

    /// The voxels of a block, x first; `None` far from all surfaces.
    pub fn block(&self, place: IVec3) -> Option<&[Voxel]> {
        self.blocks.get(&place).map(Vec::as_slice)
    }
}

/// Index in its block of a voxel, each coordinate from 0 to below [`SIDE`].
pub(super) fn index_of(at: IVec3) -> usize {
    ((at.z * SIDE + at.y) * SIDE + at.x) as usize
}

fn fuse(place: IVec3, views: &[View], scale: Scale) -> Vec<Voxel> {
    let Scale { voxel, truncation } = scale;
    let mut sums = vec![Sum::default(); VOLUME];
    let corner = place * SIDE;
    let half = 0.5 * SIDE as f32 * voxel;
    let centre = corner.as_vec3() * voxel + half;
    for view in views {
        if !view.may_show(view.in_camera(centre), half * 3f32.sqrt()) {
            continue;
        }
        for z in 0..SIDE {
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let at = IVec3::new(x, y, z);
                    let point = view.in_camera((corner + at).as_vec3() * voxel);
                    sums[index_of(at)].add(view, point, truncation);
                }
            }
        }
    }
    sums.iter().map(Sum::voxel).collect()
}

impl Sum {
    fn add(&mut self, view: &View, point: Vec3, truncation: f32) {
        // Nearer than any surface, where the division below is unstable.
        if point.z <= 0.1 * truncation {
            return;
        }
        let Some(pixel) = view.pixel_at(point).filter(|pixel| pixel.facing > 0) else {
            return;
        };
        let facing = f32::from(pixel.facing) / 255.0;
        // From the distance along the axis to that from the plane of the surface.
        let distance = (pixel.depth - point.z) * facing * point.length() / point.z;
        // Depths err by more than the truncation where they are large; that leaves no hole.
        let is_near = distance.abs() < truncation.max(DEPTH_ERROR * pixel.depth);
        self.views += u32::from(is_near);
        if distance < -truncation {
            return;
        }
        let weight = facing * facing / (pixel.depth * pixel.depth);
        let share = (distance / truncation).min(1.0);
        self.distance += weight * share;
        self.weight += weight;
        if share.abs() < 1.0 {
            let near = weight * (1.0 - share.abs());
            self.colour += near * Vec3::from(pixel.colour.map(f32::from));
            self.colour_weight += near;
        }
    }

    fn voxel(&self) -> Voxel {
        if self.views < LEAST_VIEWS || self.weight == 0.0 {
            return Voxel { distance: f32::NAN, colour: [0; 3] };
        }
        let colour = self.colour / self.colour_weight.max(f32::MIN_POSITIVE);
        Voxel {
            distance: self.distance / self.weight,
            colour: colour.round().to_array().map(|value| value as u8),
        }
    }
}
