//! A made-up corner of two walls, photographed from five places.

use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::camera::Intrinsics;

/// The walls stand so far away, world units, left and right of the middle.
const WALLS: [f64; 2] = [4.0, 6.0];

fn cameras() -> Vec<Camera> {
    let intrinsics = Intrinsics {
        width: 140,
        height: 100,
        fx: 130.0,
        fy: 130.0,
        cx: 70.0,
        cy: 50.0,
    };
    let camera = |index: usize| {
        let eye = DVec3::new(0.45 * (index as f64 - 2.0), 0.2 * (index % 2) as f64, 0.0);
        Camera::look_at(intrinsics, eye, DVec3::new(0.0, 0.0, 5.0), DVec3::Y)
    };
    (0..5).map(camera).collect()
}

/// Depth in the world of what a ray from `origin` meets.
fn wall(origin: DVec3, ray: DVec3) -> DVec3 {
    let near = origin + ray * ((WALLS[0] - origin.z) / ray.z);
    let far = origin + ray * ((WALLS[1] - origin.z) / ray.z);
    if near.x < 0.0 { near } else { far }
}

/// Blotches of many sizes.
fn paint(point: DVec3) -> f32 {
    let wave = |scale: f64, turn: f64| {
        let along = DVec2::from_angle(turn).dot(DVec2::new(point.x, point.y));
        (scale * along + 3.0 * turn).sin()
    };
    let sum = wave(5.0, 0.3) + wave(9.0, 1.4) + wave(14.0, 2.6) + 0.7 * wave(23.0, 0.9);
    (0.5 + 0.1 * sum) as f32
}

/// What a camera sees, with noise of this deviation.
fn photograph(camera: &Camera, noise: f32, seed: u64) -> Image {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let k = camera.intrinsics;
    let mut image = Image::new(k.width, k.height);
    let back = camera.rotation().transpose();
    for y in 0..k.height {
        for x in 0..k.width {
            let (u, v) = (x as f64 + 0.5 - k.cx, y as f64 + 0.5 - k.cy);
            let ray = back * DVec3::new(u / k.fx, v / k.fy, 1.0);
            let value = paint(wall(camera.centre(), ray));
            // The sum of uniform numbers is nearly Gaussian.
            let grain: f32 = (0..6).map(|_| random.random::<f32>() - 0.5).sum();
            image.set(x, y, [value + noise * grain * 1.414; 3]);
        }
    }
    image
}

/// Points on the walls, as structure from motion finds some.
fn sparse() -> Vec<[f32; 3]> {
    let point = |i: usize| {
        let (x, y) = ((i % 12) as f32 * 0.3 - 1.7, (i / 12) as f32 * 0.3 - 0.7);
        [x, y, WALLS[usize::from(x >= 0.0)] as f32]
    };
    (0..60).map(point).collect()
}

fn stereo(noise: f32) -> Stereo {
    stereo_of(noise, true)
}

/// With sparse points that were measured or guessed.
fn stereo_of(noise: f32, measured: bool) -> Stereo {
    let cameras = cameras();
    let images: Vec<Image> = (0..5)
        .map(|i| photograph(&cameras[i], noise, i as u64))
        .collect();
    let photographs: Vec<_> = cameras.into_iter().zip(&images).collect();
    Stereo::of(&photographs, &sparse(), measured, &CancelToken::default()).expect("not cancelled")
}

fn found(noise: f32, most: usize) -> Vec<DensePoint> {
    stereo(noise).points(most)
}

/// Share of the points within 2 % of the depth of a wall, on its own side of the edge.
fn right(points: &[DensePoint]) -> f64 {
    let is_right = |point: &&DensePoint| {
        let wall = WALLS[usize::from(point.position[0] >= 0.0)];
        (f64::from(point.position[2]) / wall - 1.0).abs() < 0.02
    };
    points.iter().filter(is_right).count() as f64 / points.len().max(1) as f64
}

#[test]
fn points_lie_on_the_walls_and_have_their_colours() {
    let points = found(0.0, 100_000);
    assert!(points.len() > 4_000, "{}", points.len());
    assert!(right(&points) > 0.97, "{}", right(&points));
    let off = |point: &DensePoint| {
        let painted = paint(DVec3::from(point.position.map(f64::from)));
        (point.colour[0] - painted).abs()
    };
    let mean = points.iter().map(off).sum::<f32>() / points.len() as f32;
    assert!(mean < 0.03, "{mean}");
}

#[test]
fn noise_costs_points_and_not_their_places() {
    let points = found(0.06, 100_000);
    assert!(points.len() > 1_500, "{}", points.len());
    assert!(right(&points) > 0.93, "{}", right(&points));
}

#[test]
fn there_are_at_most_as_many_as_wanted_and_they_are_spread() {
    let points = found(0.0, 500);
    assert!((250..=500).contains(&points.len()), "{}", points.len());
    let left = points
        .iter()
        .filter(|point| point.position[0] < 0.0)
        .count();
    assert!(
        (points.len() / 5..4 * points.len() / 5).contains(&left),
        "{left}"
    );
}

#[test]
fn photographs_of_different_things_agree_on_nothing() {
    let cameras = cameras();
    let mut random = Pcg64Mcg::seed_from_u64(9);
    let mut noise = || {
        let mut image = Image::new(140, 100);
        let values = image.data_mut().iter_mut();
        values.for_each(|value| *value = random.random());
        image
    };
    let images: Vec<Image> = (0..5).map(|_| noise()).collect();
    let photographs: Vec<_> = cameras.into_iter().zip(&images).collect();
    let stereo = Stereo::of(&photographs, &sparse(), true, &CancelToken::default());
    let points = stereo.expect("not cancelled").points(100_000);
    assert!(points.len() < 100, "{}", points.len());
}

#[test]
fn without_neighbours_or_sparse_points_there_are_none() {
    let cameras = cameras();
    let images: Vec<Image> = cameras.iter().map(|c| photograph(c, 0.0, 1)).collect();
    let photographs: Vec<_> = cameras.into_iter().zip(&images).collect();
    let none = |photographs, sparse: &[[f32; 3]]| {
        let stereo = Stereo::of(photographs, sparse, true, &CancelToken::default());
        stereo.expect("not cancelled").points(1_000).is_empty()
    };
    assert!(none(&photographs[..2], &sparse()));
    assert!(none(&photographs, &[]));
    let here = [photographs[0]; 4];
    assert!(none(&here, &sparse()), "all from one place");
}

#[test]
fn the_air_before_the_walls_is_free_and_the_walls_are_not() {
    let stereo = stereo(0.03);
    let free = |x: f32, z: f32| stereo.is_free([x, 0.1, z]);
    assert!(free(-0.5, 0.8) && free(0.4, 1.0), "before a lens");
    let guessed = stereo_of(0.03, false);
    assert!(!guessed.is_free([2.0, 0.1, 0.8]), "a guess is no measure");
    assert!(stereo.is_free([0.9, 0.1, 0.8]), "beside the picture");
    assert!(free(-0.8, 2.8) && free(0.7, 4.2), "before a wall");
    assert!(!free(-0.8, 4.0) && !free(0.7, 6.0), "on a wall");
    assert!(!free(-0.8, 7.0), "behind a wall nobody knows");
    assert!(!free(0.0, -3.0) && !free(40.0, 5.0), "where nobody looks");
}

#[test]
fn a_stop_is_heard() {
    let cancel = CancelToken::default();
    cancel.cancel();
    let cameras = cameras();
    let images: Vec<Image> = cameras.iter().map(|c| photograph(c, 0.0, 1)).collect();
    let photographs: Vec<_> = cameras.into_iter().zip(&images).collect();
    assert!(Stereo::of(&photographs, &sparse(), true, &cancel).is_err());
}
