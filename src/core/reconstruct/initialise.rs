//! The scene before the first step: Gaussians from the sparse points, and random ones if there are
//! few.

use glam::DVec3;
use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use rayon::prelude::*;

use super::config::Pace;
use super::schedule::{Schedule, Stream};
use crate::camera::Camera;
use crate::gaussians::Gaussians;

/// A point at which a Gaussian starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// World units.
    pub position: [f32; 3],
    /// sRGB.
    pub colour: [u8; 3],
}

/// Initial opacity: a logit of 0, and that of 0.1, as published.
const OPACITY_LOGIT: f32 = 0.0;
const PUBLISHED_LOGIT: f32 = -2.197_224_6;
/// Least scale, as a share of the extent.
const SCALE_FLOOR: f64 = 1e-7;
/// Largest scale, as a share of the extent: a point far from all others must not cover the scene.
/// At the published pace only a lone point has it.
const SCALE_CEILING: f64 = 0.1;
/// Constant harmonic.
const SH0: f32 = 0.282_094_8;

/// Number of points below which random ones are added, in the cameras' frusta between the 5th and
/// 95th percentile of depth. Always filling up to 20,000 costs more than 1 dB compared with growth
/// from sparse points; random points only help where there are hardly any. None are added at the
/// published pace.
const FILL_UP: usize = 1_000;

/// The unit of rates and noise, world units: the larger of 1.1 times the radius of the cameras, as
/// first published, and a quarter of the points' median depth, because forward-facing cameras are
/// close together. 1 if both are 0.
pub fn scene_extent(cameras: &[Camera], points: &[Point]) -> f64 {
    let depths = visible_depths(cameras, points);
    let depth = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
    positive(published_radius(cameras).max(0.25 * depth))
}

/// The unit of the published rates, world units: 1.1 times the radius of the cameras, 1 if it is 0.
pub fn camera_extent(cameras: &[Camera]) -> f64 {
    positive(published_radius(cameras))
}

fn published_radius(cameras: &[Camera]) -> f64 {
    1.1 * camera_radius(cameras)
}

fn positive(extent: f64) -> f64 {
    if extent > 0.0 { extent } else { 1.0 }
}

/// Median depth of the points in the images that show them, world units. 1 without any points.
pub fn scene_depth(cameras: &[Camera], points: &[Point]) -> f64 {
    let depths = visible_depths(cameras, points);
    depths.get(depths.len() / 2).copied().unwrap_or(1.0)
}

fn camera_radius(cameras: &[Camera]) -> f64 {
    let centres: Vec<_> = cameras.iter().map(Camera::centre).collect();
    let mean = centres.iter().sum::<DVec3>() / centres.len().max(1) as f64;
    centres.iter().map(|c| c.distance(mean)).fold(0.0, f64::max)
}

/// Depths of the points in the images that show them, sorted.
fn visible_depths(cameras: &[Camera], points: &[Point]) -> Vec<f64> {
    let mut depths = Vec::new();
    for camera in cameras {
        let seen =
            points.iter().filter_map(|p| camera.shows(DVec3::from(p.position.map(f64::from))));
        depths.extend(seen.map(|(_, depth)| depth));
    }
    depths.sort_by(f64::total_cmp);
    depths
}

/// Creates at most `cap` Gaussians of degree `schedule.sh_degree` at `points`: scale from the three
/// nearest neighbours, opacity 0.5 (0.1 at the published pace), the point's colour. Drops points
/// that are not finite.
pub fn initialise(
    points: &[Point],
    cameras: &[Camera],
    cap: usize,
    schedule: &Schedule,
) -> Gaussians {
    let mut random = schedule.generator(Stream::FirstPoints, 0);
    let finite = |p: &&Point| p.position.iter().all(|v| v.is_finite());
    let mut all: Vec<Point> = points.iter().filter(finite).copied().collect();
    all.shuffle(&mut random);
    all.truncate(cap);
    let extent = scene_extent(cameras, &all);
    // Without any points, half of the cap is placed at random, and the rest grows where the error
    // is.
    let wanted = match schedule.pace {
        _ if all.is_empty() => cap / 2,
        Pace::Adapted => FILL_UP.min(cap),
        Pace::Published => 0,
    };
    let missing = wanted.saturating_sub(all.len());
    all.extend(random_points(&all, cameras, missing, &mut random));
    let scene = gaussians_at(&all, extent, schedule.pace);
    scene.with_sh_degree(schedule.sh_degree)
}

/// One Gaussian of degree 0 per point.
pub(super) fn gaussians_at(points: &[Point], extent: f64, pace: Pace) -> Gaussians {
    let (low, high) = (SCALE_FLOOR * extent, SCALE_CEILING * extent);
    let scale = |distance: f64| match pace {
        Pace::Published if distance.is_finite() => distance.max(low),
        _ => distance.clamp(low, high),
    };
    let distances = neighbour_distances(points, pace).into_iter();
    let log_scales = distances.map(|distance| [scale(distance).ln() as f32; 3]);
    let logit = match pace {
        Pace::Adapted => OPACITY_LOGIT,
        Pace::Published => PUBLISHED_LOGIT,
    };
    Gaussians {
        means: points.iter().map(|p| p.position).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; points.len()],
        log_scales: log_scales.collect(),
        opacity_logits: vec![logit; points.len()],
        sh: points
            .iter()
            .flat_map(|p| p.colour.map(|v| (f32::from(v) / 255.0 - 0.5) / SH0))
            .collect(),
        sh_degree: 0,
    }
}

/// Points uniform over the images and in inverse depth, coloured like their nearest sparse point.
fn random_points(
    known: &[Point],
    cameras: &[Camera],
    count: usize,
    random: &mut impl Rng,
) -> Vec<Point> {
    if cameras.is_empty() {
        return Vec::new();
    }
    let (near, far) = depth_range(known, cameras);
    let places: Vec<_> = (0..count)
        .map(|_| {
            let camera = &cameras[random.random_range(0..cameras.len())];
            let k = &camera.intrinsics;
            let pixel =
                [random.random::<f64>() * k.width as f64, random.random::<f64>() * k.height as f64];
            let share: f64 = random.random();
            let depth = 1.0 / (share / near + (1.0 - share) / far);
            let ray = DVec3::new((pixel[0] - k.cx) / k.fx, (pixel[1] - k.cy) / k.fy, 1.0);
            (camera.rotation().transpose() * (ray * depth - camera.translation()))
                .as_vec3()
                .to_array()
        })
        .collect();
    let coloured = |position: &[f32; 3]| {
        let away = |point: &Point| squared(&point.position, position);
        let nearest = known.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        Point { position: *position, colour: nearest.map_or([128; 3], |point| point.colour) }
    };
    places.par_iter().map(coloured).collect()
}

fn depth_range(known: &[Point], cameras: &[Camera]) -> (f64, f64) {
    let depths = visible_depths(cameras, known);
    if depths.is_empty() {
        // Only the cameras are known: they are usually about as far apart as from the scene.
        let radius = camera_radius(cameras).max(1e-3);
        return (0.5 * radius, 5.0 * radius);
    }
    let at = |share: f64| depths[((depths.len() - 1) as f64 * share) as usize];
    (at(0.05), at(0.95).max(at(0.05) * 1.01))
}

fn squared(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    (0..3).map(|n| (a[n] - b[n]) * (a[n] - b[n])).sum()
}

/// Mean distance of every point to its three nearest neighbours, root mean square at the published
/// pace; infinite for a lone point.
fn neighbour_distances(points: &[Point], pace: Pace) -> Vec<f64> {
    let mut order: Vec<_> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a].position[0].total_cmp(&points[b].position[0]).then(a.cmp(&b)));
    let mean = |rank| {
        let squares = nearest_three(points, &order, rank);
        let squares = squares.iter().filter(|d| d.is_finite()).map(|&d| f64::from(d));
        let of = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let mean = match pace {
            Pace::Adapted => of(&squares.map(f64::sqrt).collect::<Vec<_>>()),
            Pace::Published => of(&squares.collect::<Vec<_>>()).sqrt(),
        };
        if mean.is_nan() { f64::INFINITY } else { mean }
    };
    let by_rank: Vec<_> = (0..order.len()).into_par_iter().map(mean).collect();
    let mut out = vec![0.0; points.len()];
    for (&index, distance) in order.iter().zip(by_rank) {
        out[index] = distance;
    }
    out
}

/// Squared distances to the three nearest points, infinite where there are fewer: walks away from
/// `rank` along x until no nearer point is possible.
fn nearest_three(points: &[Point], order: &[usize], rank: usize) -> [f32; 3] {
    let here = &points[order[rank]].position;
    let mut best = [f32::INFINITY; 3];
    let mut visit = |index: usize| {
        let place = &points[index].position;
        let along = place[0] - here[0];
        if along * along > best[2] {
            return false;
        }
        let distance = squared(place, here);
        if distance < best[2] {
            best[2] = distance;
            best.sort_by(f32::total_cmp);
        }
        true
    };
    for &index in &order[rank + 1..] {
        if !visit(index) {
            break;
        }
    }
    for &index in order[..rank].iter().rev() {
        if !visit(index) {
            break;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::fixtures::{Random, viewpoint};

    const PLAN: Schedule = Schedule {
        steps: 100,
        sh_degree: 2,
        resolution: false,
        pace: Pace::Adapted,
        warm: false,
        seed: 1,
    };

    fn points(count: usize) -> Vec<Point> {
        let mut random = Random::new(4);
        (0..count)
            .map(|n| Point {
                position: [0; 3].map(|_| random.signed() as f32),
                colour: [n as u8, 2, 3],
            })
            .collect()
    }

    #[test]
    fn neighbour_distances_match_brute_force() {
        let points = points(300);
        for (i, found) in neighbour_distances(&points, Pace::Adapted).into_iter().enumerate() {
            let others = points.iter().enumerate().filter(|(j, _)| *j != i);
            let mut all: Vec<_> = others
                .map(|(_, p)| f64::from(squared(&p.position, &points[i].position)).sqrt())
                .collect();
            all.sort_by(f64::total_cmp);
            assert!((found - all[..3].iter().sum::<f64>() / 3.0).abs() < 1e-6);
        }
    }

    #[test]
    fn few_points_are_filled_up_and_many_cut_to_the_cap() {
        let camera = viewpoint(80, 60).camera;
        let few = initialise(&points(50), &[camera], 4_000, &PLAN);
        let (count, numbers) = (few.len(), few.sh.len());
        assert_eq!((count, few.sh_degree, numbers), (1_000, 2, 1_000 * 27));
        let seen = |mean: &[f32; 3]| camera.project(DVec3::from(mean.map(f64::from))).is_some();
        assert!(few.means[50..].iter().all(seen));
        assert!((0..1_000).all(|i| few.is_usable(i)));
        let held = |points: &[Point], cap| initialise(points, &[camera], cap, &PLAN).len();
        assert_eq!(held(&points(5_000), 4_000), 4_000);
        assert_eq!(held(&points(2_000), 4_000), 2_000);
        assert_eq!(held(&[], 4_000), 2_000, "a scene needs something");
        assert_eq!(held(&points(50), 100), 100);
        assert_eq!(few, initialise(&points(50), &[camera], 4_000, &PLAN));
    }

    #[test]
    fn cameras_close_together_do_not_shrink_the_extent() {
        let mut other = viewpoint(80, 60).camera;
        other.intrinsics.cx += 1.0;
        let cameras = [viewpoint(80, 60).camera, other];
        let extent = scene_extent(&cameras, &points(200));
        assert!(extent > 0.1, "{extent}");
    }

    #[test]
    fn without_points_the_cameras_decide() {
        let camera = viewpoint(80, 60).camera;
        assert_eq!(initialise(&[], &[camera], 40, &PLAN).len(), 20);
        assert!(initialise(&[], &[], 40, &PLAN).is_empty());
        assert_eq!(scene_extent(&[camera], &[]), 1.0);
        let poisoned = [Point { position: [f32::NAN, 0.0, 0.0], colour: [0; 3] }];
        assert!((0..20).all(|i| initialise(&poisoned, &[camera], 40, &PLAN).is_usable(i)));
    }

    #[test]
    fn the_published_start_is_that_of_3dgs() {
        let plan = Schedule { pace: Pace::Published, ..PLAN };
        let near = [[0.0_f32, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 60.0]];
        let points = near.map(|position| Point { position, colour: [9; 3] });
        let cameras = [viewpoint(80, 60).camera];
        let scene = initialise(&points, &cameras, 4_000, &plan);
        assert_eq!(scene.len(), 4, "no random points");
        assert!(scene.opacity_logits.iter().all(|l| (1.0 / (1.0 + (-l).exp()) - 0.1).abs() < 1e-6));
        let at = (0..4).find(|&i| scene.means[i] == [0.0; 3]).expect("the first");
        let expected = ((9.0_f64 + 16.0 + 3_600.0) / 3.0).sqrt();
        let found = f64::from(scene.log_scales[at][0]).exp();
        assert!((found / expected - 1.0).abs() < 1e-5, "{found}, not {expected}");
        let lone = initialise(&points[..1], &cameras, 4_000, &plan);
        assert!(lone.is_usable(0), "{:?}", lone.log_scales);
        let mut other = cameras[0];
        other.intrinsics.cx += 1.0;
        assert_eq!(camera_extent(&[cameras[0], other]), 1.0, "both stand in one place");
    }

    #[test]
    fn colours_round_trip_through_the_constant_harmonic() {
        let scene =
            initialise(&[Point { position: [0.0; 3], colour: [255, 51, 0] }], &[], 10, &PLAN);
        let colour = [0, 1, 2].map(|c| 0.5 + SH0 * scene.sh[c]);
        assert!(colour.iter().zip([1.0, 0.2, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
