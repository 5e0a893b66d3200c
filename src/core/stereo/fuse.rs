//! What the depths of several photographs agree on, as evenly spread points.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use super::map::{DepthMap, StereoView};

/// Other photographs that must see a point where one sees it.
const LEAST_AGREEING: usize = 2;
/// Largest difference of their depths, share of the depth.
const TOLERANCE: f64 = 0.02;
/// A voxel that holds too many points grows by so much.
const GROWTH: f64 = 1.1;
/// Voxels are at least so many pixels wide.
const FIRST_VOXEL: f64 = 1.0;

/// A point that several photographs agree on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensePoint {
    /// World units.
    pub position: [f32; 3],
    /// Mean colour, sRGB-encoded, 0..=1.
    pub colour: [f32; 3],
}

/// A point that photographs agree on, with the width of a pixel there.
pub(super) struct Agreed {
    position: DVec3,
    colour: [f32; 3],
    footprint: f64,
}

/// The depths that at least two other photographs put at the same place; 0 elsewhere.
pub(super) fn agreed(views: &[StereoView], maps: &[DepthMap]) -> Vec<DepthMap> {
    let of_view = |index: usize| {
        let others: Vec<usize> = (0..views.len()).filter(|other| *other != index).collect();
        let kept = |(i, depth): (usize, &f32)| {
            let Some(point) = point(&views[index], i, *depth) else {
                return 0.0;
            };
            let sees = |other: &&usize| sees(&views[**other], &maps[**other], point);
            let agreeing = others.iter().filter(sees).take(LEAST_AGREEING).count();
            if agreeing == LEAST_AGREEING {
                *depth
            } else {
                0.0
            }
        };
        let depths = maps[index].depths.iter().enumerate().map(kept);
        DepthMap {
            depths: depths.collect(),
        }
    };
    (0..views.len()).into_par_iter().map(of_view).collect()
}

/// Where a pixel's point lies, world units; `None` where its depth is not known.
fn point(view: &StereoView, pixel: usize, depth: f32) -> Option<DVec3> {
    let (width, _) = view.size();
    let ray = f64::from(depth) * view.ray(pixel % width, pixel / width);
    let back = || view.camera.world_to_camera.inverse();
    (depth > 0.0).then(|| back().transform_point3(ray))
}

/// Whether a photograph shows the point at its own depth.
fn sees(view: &StereoView, map: &DepthMap, point: DVec3) -> bool {
    let Some((pixel, depth)) = view.camera.project(point) else {
        return false;
    };
    let there = map.at(view, pixel);
    there.is_some_and(|there| (there / depth - 1.0).abs() < TOLERANCE)
}

/// The points of the depths.
pub(super) fn points(views: &[StereoView], maps: &[DepthMap]) -> Vec<Agreed> {
    let of_view = |(view, map): (&StereoView, &DepthMap)| {
        let (width, _) = view.size();
        let known = map.depths.iter().enumerate().filter_map(|(i, depth)| {
            Some(Agreed {
                position: point(view, i, *depth)?,
                colour: view.image.get(i % width, i / width),
                footprint: f64::from(*depth) / view.camera.intrinsics.fx,
            })
        });
        known.collect::<Vec<_>>()
    };
    views.iter().zip(maps).flat_map(of_view).collect()
}

/// At most `most` of the points: the mean of those in each voxel of a grid.
pub(super) fn thinned(points: &[Agreed], most: usize) -> Vec<DensePoint> {
    let mut footprints: Vec<f64> = points.iter().map(|point| point.footprint).collect();
    if footprints.is_empty() {
        return Vec::new();
    }
    footprints.sort_by(f64::total_cmp);
    let mut side = FIRST_VOXEL * footprints[footprints.len() / 2];
    loop {
        let voxels = voxels(points, side);
        if voxels.len() <= most {
            return voxels.values().map(|points| mean(points)).collect();
        }
        // Points lie on surfaces, so twice as many of them are voxels of 0.7 of the side.
        side *= GROWTH.max((voxels.len() as f64 / most as f64).sqrt() * 0.9);
    }
}

fn voxels(points: &[Agreed], side: f64) -> BTreeMap<[i64; 3], Vec<&Agreed>> {
    let mut voxels: BTreeMap<_, Vec<&Agreed>> = BTreeMap::new();
    for point in points {
        let key = (point.position / side).floor();
        let key = key.to_array().map(|along| along as i64);
        voxels.entry(key).or_default().push(point);
    }
    voxels
}

fn mean(points: &[&Agreed]) -> DensePoint {
    let count = points.len() as f64;
    let position: DVec3 = points.iter().map(|point| point.position).sum();
    let colour = |c: usize| points.iter().map(|point| point.colour[c]).sum::<f32>();
    DensePoint {
        position: (position / count).as_vec3().to_array(),
        colour: std::array::from_fn(|c| colour(c) / count as f32),
    }
}
