//! The viewpoint of a photograph from known points that it shows (perspective from n points): by
//! RANSAC over three of them, then by least squares over all that agree.

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::camera::{Camera, Intrinsics};
use crate::linear::solve;

/// Number of samples of three points. With a third of the points right, one sample in 27 has only
/// right ones.
const TRIES: usize = 1000;
/// Least-squares steps; a few suffice.
const STEPS: usize = 20;
/// Three points give up to four cameras; fewer agreeing points do not select one.
const LEAST_POINTS: usize = 6;
/// Sine of the smallest angle between two rays: two degrees.
const LEAST_SINE: f64 = 0.035;

/// A scene point and its pixel in the photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// px; the centre of the first pixel is (0.5, 0.5).
    pub pixel: DVec2,
    /// World units.
    pub point: DVec3,
}

/// A camera found.
#[derive(Clone, Debug, PartialEq)]
pub struct Resection {
    /// The camera.
    pub camera: Camera,
    /// Indices of the sightings that agree with it.
    pub inliers: Vec<usize>,
    /// Root mean square distance of their pixels from the camera's projections, px.
    pub rms_px: f64,
}

/// The camera that projects most of the points within `near_px` of their pixels; `None` if fewer
/// than six agree. Equal for an equal `seed`.
pub fn resect(
    intrinsics: &Intrinsics,
    sightings: &[Sighting],
    near_px: f64,
    seed: u64,
) -> Option<Resection> {
    if sightings.len() < LEAST_POINTS {
        return None;
    }
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut best: Option<(usize, Camera)> = None;
    for _ in 0..TRIES {
        let three: [usize; 3] = std::array::from_fn(|_| rng.random_range(0..sightings.len()));
        let three = three.map(|index| sightings[index]);
        for world_to_camera in from_three(intrinsics, &three) {
            let camera = Camera { intrinsics: *intrinsics, world_to_camera };
            let count = agreeing(&camera, sightings, near_px).len();
            if best.as_ref().is_none_or(|(most, _)| count > *most) {
                best = Some((count, camera));
            }
        }
    }
    let (_, mut camera) = best?;
    let mut inliers = agreeing(&camera, sightings, near_px);
    // More points agree with the joint fit of the first ones; they may change it slightly.
    for _ in 0..STEPS {
        if inliers.len() < LEAST_POINTS {
            return None;
        }
        camera = step(&camera, sightings, &inliers, near_px)?;
        inliers = agreeing(&camera, sightings, near_px);
    }
    let squares = inliers.iter().map(|&index| {
        let away = distance(&camera, &sightings[index]);
        away * away
    });
    let rms_px = (squares.sum::<f64>() / inliers.len() as f64).sqrt();
    (inliers.len() >= LEAST_POINTS).then_some(Resection { camera, inliers, rms_px })
}

/// The point that most of the cameras see within `near_px` of these pixels, at least two, from
/// directions that determine its distance; `None` if there is none.
pub fn meeting(seen: &[(&Camera, DVec2)], near_px: f64) -> Option<DVec3> {
    let ray = |(camera, pixel): &(&Camera, DVec2)| {
        let k = &camera.intrinsics;
        let ahead = DVec3::new((pixel.x - k.cx) / k.fx, (pixel.y - k.cy) / k.fy, 1.0);
        (camera.centre(), (camera.rotation().transpose() * ahead).normalize())
    };
    let rays: Vec<_> = seen.iter().map(ray).collect();
    let agree = |point: DVec3| {
        let near = |(camera, pixel): &&(&Camera, DVec2)| {
            camera.project(point).is_some_and(|(at, _)| at.distance(*pixel) <= near_px)
        };
        seen.iter().filter(near).count()
    };
    let mut best = None;
    for second in 1..rays.len() {
        for first in 0..second {
            let Some(point) = nearest(rays[first], rays[second]) else {
                continue;
            };
            let count = agree(point);
            if count >= 2 && best.is_none_or(|(most, _)| count > most) {
                best = Some((count, point));
            }
        }
    }
    best.map(|(_, point)| point)
}

/// The midpoint of the shortest connection of two rays; `None` if they are too parallel.
fn nearest((a, along_a): (DVec3, DVec3), (b, along_b): (DVec3, DVec3)) -> Option<DVec3> {
    let cosine = along_a.dot(along_b);
    let sine2 = 1.0 - cosine * cosine;
    if sine2 < LEAST_SINE * LEAST_SINE {
        return None;
    }
    let between = b - a;
    let (x, y) = (between.dot(along_a), between.dot(along_b));
    let (far_a, far_b) = ((x - cosine * y) / sine2, (cosine * x - y) / sine2);
    Some(0.5 * (a + far_a * along_a + b + far_b * along_b))
}

/// px; infinite behind the camera.
fn distance(camera: &Camera, sighting: &Sighting) -> f64 {
    let seen = camera.project(sighting.point);
    seen.map_or(f64::INFINITY, |(pixel, _)| pixel.distance(sighting.pixel))
}

fn agreeing(camera: &Camera, sightings: &[Sighting], near_px: f64) -> Vec<usize> {
    let near = |index: &usize| distance(camera, &sightings[*index]) <= near_px;
    (0..sightings.len()).filter(near).collect()
}

/// A Gauss-Newton step over the inliers; distant ones count linearly instead of by their square
/// (Huber).
fn step(
    camera: &Camera,
    sightings: &[Sighting],
    inliers: &[usize],
    near_px: f64,
) -> Option<Camera> {
    let (mut lower, mut right) = ([[0.0; 6]; 6], [0.0; 6]);
    let k = camera.intrinsics;
    let bend = near_px / 2.0;
    for sighting in inliers.iter().map(|&index| sightings[index]) {
        let at = camera.world_to_camera.transform_point3(sighting.point);
        let (pixel, _) = camera.project(sighting.point)?;
        let missing = sighting.pixel - pixel;
        let weight = (bend / missing.length().max(bend)).min(1.0);
        // The pixel's derivative by the point, in the camera's axes; a rotation moves the point by
        // its cross product.
        let by_point = [
            DVec3::new(k.fx / at.z, 0.0, -k.fx * at.x / (at.z * at.z)),
            DVec3::new(0.0, k.fy / at.z, -k.fy * at.y / (at.z * at.z)),
        ];
        for (by, missing) in by_point.into_iter().zip(missing.to_array()) {
            let turn = at.cross(by);
            let row = [turn.x, turn.y, turn.z, by.x, by.y, by.z];
            for i in 0..6 {
                right[i] += weight * row[i] * missing;
                for j in 0..=i {
                    lower[i][j] += weight * row[i] * row[j];
                }
            }
        }
    }
    (0..6).for_each(|i| lower[i][i] *= 1.0 + 1e-9);
    let by = solve(lower, right)?;
    let turn = DQuat::from_scaled_axis(DVec3::new(by[0], by[1], by[2]));
    let motion = DMat4::from_rotation_translation(turn, DVec3::new(by[3], by[4], by[5]));
    Some(Camera { world_to_camera: motion * camera.world_to_camera, ..*camera })
}

/// From world to camera, up to four solutions, from three sightings: Grunert's solution (1841) as
/// in Haralick, Lee, Ottenberg and Noelle, "Review and analysis of solutions of the three point
/// perspective pose estimation problem" (1994). None if two of the sightings coincide.
fn from_three(intrinsics: &Intrinsics, three: &[Sighting; 3]) -> Vec<DMat4> {
    let k = intrinsics;
    let points = three.map(|sighting| sighting.point);
    let rays = three.map(|Sighting { pixel, .. }| {
        DVec3::new((pixel.x - k.cx) / k.fx, (pixel.y - k.cy) / k.fy, 1.0).normalize()
    });
    let (a2, b2, c2) = (
        points[1].distance_squared(points[2]),
        points[0].distance_squared(points[2]),
        points[0].distance_squared(points[1]),
    );
    if a2.min(b2).min(c2) <= 0.0 {
        return Vec::new();
    }
    // Cosines of the angles between the rays.
    let (alpha, beta, gamma) = (rays[1].dot(rays[2]), rays[0].dot(rays[2]), rays[0].dot(rays[1]));
    let (less, more) = ((a2 - c2) / b2, (a2 + c2) / b2);
    let (alpha2, beta2, gamma2) = (alpha * alpha, beta * beta, gamma * gamma);
    let all = alpha * beta * gamma;
    let quartic = [
        (1.0 + less) * (1.0 + less) - 4.0 * a2 / b2 * gamma2,
        4.0 * (-less * (1.0 + less) * beta + 2.0 * a2 / b2 * gamma2 * beta
            - (1.0 - more) * alpha * gamma),
        2.0 * (less * less - 1.0 + 2.0 * less * less * beta2 + 2.0 * (b2 - c2) / b2 * alpha2
            - 4.0 * more * all
            + 2.0 * (b2 - a2) / b2 * gamma2),
        4.0 * (less * (1.0 - less) * beta - (1.0 - more) * alpha * gamma
            + 2.0 * c2 / b2 * alpha2 * beta),
        (less - 1.0) * (less - 1.0) - 4.0 * c2 / b2 * alpha2,
    ];
    // Distances along the rays are s, u s and v s.
    let mut found = Vec::new();
    for v in positive_roots(&quartic) {
        let u = ((less - 1.0) * v * v - 2.0 * less * beta * v + 1.0 + less)
            / (2.0 * (gamma - v * alpha));
        let s2 = b2 / (1.0 + v * v - 2.0 * v * beta);
        if u.is_finite() && u > 0.0 && s2.is_finite() && s2 > 0.0 {
            let s = s2.sqrt();
            let seen = [s * rays[0], u * s * rays[1], v * s * rays[2]];
            found.extend(rigid(&points, &seen));
        }
    }
    found
}

/// The transform of three points onto three others of the same triangle.
fn rigid(from: &[DVec3; 3], to: &[DVec3; 3]) -> Option<DMat4> {
    let frame = |[a, b, c]: &[DVec3; 3]| {
        let x = (b - a).try_normalize()?;
        let z = x.cross(c - a).try_normalize()?;
        Some(DMat3::from_cols(x, z.cross(x), z))
    };
    let rotation = frame(to)? * frame(from)?.transpose();
    let translation = to[0] - rotation * from[0];
    let is_finite = rotation.is_finite() && translation.is_finite();
    is_finite.then(|| DMat4::from_mat3_translation(rotation, translation))
}

/// The positive real roots of a quartic, constant term first, by Durand-Kerner iteration.
fn positive_roots(quartic: &[f64; 5]) -> Vec<f64> {
    let lead = quartic[4];
    if !quartic.iter().all(|value| value.is_finite()) || lead.abs() < 1e-12 {
        return Vec::new();
    }
    let monic = quartic.map(|value| value / lead);
    let times = |a: DVec2, b: DVec2| DVec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
    let over = |a: DVec2, b: DVec2| times(a, DVec2::new(b.x, -b.y)) / b.length_squared();
    let value = |at: DVec2| {
        let rest = monic[..4].iter().rev();
        rest.fold(DVec2::X, |sum, of| times(sum, at) + DVec2::new(*of, 0.0))
    };
    // All on a circle that contains every root, none on the real axis.
    let radius = 1.0 + monic[..4].iter().fold(0.0, |most: f64, of| most.max(of.abs()));
    let mut roots: [DVec2; 4] = std::array::from_fn(|i| {
        radius.min(4.0) * DVec2::from_angle(0.4 + std::f64::consts::FRAC_PI_2 * i as f64)
    });
    for _ in 0..60 {
        for i in 0..4 {
            let others = (0..4).filter(|&j| j != i);
            let product = others.fold(DVec2::X, |all, j| times(all, roots[i] - roots[j]));
            roots[i] -= over(value(roots[i]), product);
        }
    }
    let is_real = |root: &&DVec2| root.y.abs() < 1e-4 * (1.0 + root.x.abs()) && root.x > 0.0;
    roots.iter().filter(is_real).map(|root| root.x).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intrinsics() -> Intrinsics {
        Intrinsics { width: 560, height: 380, fx: 500.0, fy: 490.0, cx: 283.0, cy: 188.0 }
    }

    fn camera() -> Camera {
        let eye = DVec3::new(0.7, -0.3, -2.5);
        Camera::look_at(intrinsics(), eye, DVec3::new(0.1, 0.2, 0.3), DVec3::Y)
    }

    /// Points in front of the camera, each at its projection plus `noise` px.
    fn sightings(count: usize, noise: f64, seed: u64) -> Vec<Sighting> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut side = |size: f64| size * (2.0 * rng.random::<f64>() - 1.0);
        (0..count)
            .map(|_| {
                let point = DVec3::new(side(0.9), side(0.6), side(0.8));
                let (pixel, _) = camera().project(point).expect("before the camera");
                Sighting { pixel: pixel + DVec2::new(side(noise), side(noise)), point }
            })
            .collect()
    }

    fn apart(found: &Camera) -> (f64, f64) {
        let turn = (found.rotation() * camera().rotation().transpose()).to_owned();
        let angle = DQuat::from_mat3(&turn).to_scaled_axis().length();
        (found.centre().distance(camera().centre()), angle)
    }

    #[test]
    fn three_points_include_the_camera_in_their_solutions() {
        for seed in 0..50 {
            let three: [Sighting; 3] = sightings(3, 0.0, seed).try_into().expect("three");
            let nearest = from_three(&intrinsics(), &three)
                .into_iter()
                .map(|world_to_camera| {
                    let camera = Camera { intrinsics: intrinsics(), world_to_camera };
                    apart(&camera).0
                })
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-3, "seed {seed}: {nearest} away");
        }
    }

    #[test]
    fn a_camera_is_found_among_twice_as_many_wrong_sightings() {
        let mut all = sightings(60, 1.0, 1);
        let wrong = sightings(120, 0.0, 2);
        let pixels = sightings(120, 0.0, 3);
        let mixed = wrong
            .iter()
            .zip(&pixels)
            .map(|(wrong, other)| Sighting { pixel: other.pixel, ..*wrong });
        all.extend(mixed);
        let found = resect(&intrinsics(), &all, 4.0, 7).expect("found");
        let (away, turn) = apart(&found.camera);
        assert!(away < 0.02 && turn < 0.01, "{away} away, turned by {turn}");
        assert!((55..75).contains(&found.inliers.len()), "{found:?}");
        assert!(found.rms_px < 1.5, "{}", found.rms_px);
        assert_eq!(resect(&intrinsics(), &all, 4.0, 7), Some(found));
    }

    #[test]
    fn rays_meet_at_the_point_and_parallel_or_wrong_ones_nowhere() {
        let intrinsics = intrinsics();
        let cameras = [-0.5, 0.0, 0.4, 0.41].map(|x| {
            let eye = DVec3::new(x, 0.1, -2.5);
            Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y)
        });
        let point = DVec3::new(0.2, -0.1, 0.3);
        let seen = |index: usize, off: f64| {
            let (pixel, _) = cameras[index].project(point).expect("before the camera");
            (&cameras[index], pixel + DVec2::new(0.0, off))
        };
        let three = [seen(0, 0.3), seen(1, 40.0), seen(2, -0.3)];
        let found = meeting(&three, 2.0).expect("two agree");
        assert!(found.distance(point) < 0.01, "{found}");
        assert_eq!(meeting(&[seen(2, 0.0), seen(3, 0.0)], 2.0), None);
        assert_eq!(meeting(&[seen(0, 30.0), seen(2, -30.0)], 2.0), None);
        assert_eq!(meeting(&[seen(0, 0.0)], 2.0), None);
    }

    #[test]
    fn a_photograph_without_sightings_has_no_camera() {
        let one = sightings(1, 0.0, 1)[0];
        assert_eq!(resect(&intrinsics(), &[one; 40], 4.0, 1), None);
        assert_eq!(resect(&intrinsics(), &sightings(5, 0.0, 1), 4.0, 1), None);
        let mut behind = sightings(20, 0.0, 4);
        behind.iter_mut().for_each(|sighting| {
            sighting.point = DVec3::splat(f64::NAN);
        });
        assert_eq!(resect(&intrinsics(), &behind, 4.0, 1), None);
    }
}
