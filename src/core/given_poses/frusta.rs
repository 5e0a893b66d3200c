//! Random points in the view of the cameras, for poses without points.

use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::camera::Camera;
use crate::camera::normalisation::viewing_distance;
use crate::poses::SparsePoint;

/// Maximum draws for a point until two cameras see it.
const DRAWS: usize = 20;

/// `count` points in the union of the frusta, uniform in inverse depth and over each image, seen by
/// at least two cameras where possible. Mid-grey, as the photographs have not been read.
pub(super) fn guess(
    cameras: &[Camera],
    bounds: &[Option<(f64, f64)>],
    count: usize,
    seed: u64,
) -> Vec<SparsePoint> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let fallback = depth_range(cameras);
    let mut draw = |index: usize| {
        let camera = &cameras[index];
        let (near, far) = bounds[index].unwrap_or(fallback);
        let k = &camera.intrinsics;
        let pixel =
            DVec2::new(rng.random::<f64>() * k.width as f64, rng.random::<f64>() * k.height as f64);
        let inverse = 1.0 / far + rng.random::<f64>() * (1.0 / near - 1.0 / far);
        let ray = DVec3::new((pixel.x - k.cx) / k.fx, (pixel.y - k.cy) / k.fy, 1.0);
        camera.rotation().transpose() * (ray / inverse - camera.translation())
    };
    let mut point = |index: usize| {
        let mut position = draw(index);
        for _ in 1..DRAWS {
            if cameras.iter().filter(|camera| sees(camera, position)).take(2).count() == 2 {
                break;
            }
            position = draw(index);
        }
        SparsePoint { position: position.to_array(), colour: [128; 3], error: 0.0, track: 0 }
    };
    (0..count).map(|i| point(i % cameras.len())).collect()
}

fn sees(camera: &Camera, point: DVec3) -> bool {
    let k = &camera.intrinsics;
    let inside =
        |p: DVec2| p.x >= 0.0 && p.y >= 0.0 && p.x < k.width as f64 && p.y < k.height as f64;
    camera.project(point).is_some_and(|(pixel, _)| inside(pixel))
}

/// Depths around the point that all cameras look at or, if they look in parallel, around twice the
/// extent of the cameras.
fn depth_range(cameras: &[Camera]) -> (f64, f64) {
    let distance = viewing_distance(cameras);
    let middle = if distance > 0.0 { distance } else { 1.0 };
    (0.3 * middle, 4.0 * middle)
}
