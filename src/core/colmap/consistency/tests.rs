//! Correct models, and models that confused two sides of a scene.

use glam::DMat4;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::camera::Intrinsics;
use crate::colmap::copies::Copy;
use crate::poses::model::{ModelCamera, ModelImage};

const INTRINSICS: Intrinsics =
    Intrinsics { width: 560, height: 420, fx: 500.0, fy: 500.0, cx: 280.0, cy: 210.0 };

/// Cameras in a full circle around a cloud of points.
fn ring(count: usize) -> Vec<Camera> {
    let camera = |index: usize| {
        let angle = std::f64::consts::TAU * index as f64 / count as f64;
        let eye = DVec3::new(5.0 * angle.cos(), -0.5, 5.0 * angle.sin());
        Camera::look_at(INTRINSICS, eye, DVec3::ZERO, DVec3::Y)
    };
    (0..count).map(camera).collect()
}

fn copies(count: usize, share: usize) -> Copies {
    let size = (560 * share, 420 * share);
    let copy = |index: usize| Copy { file: format!("v{index:05}.png"), original: size, size };
    Copies {
        dir: "copies".into(),
        copies: (0..count).map(copy).collect(),
        masks: vec![None; count].into(),
        one_camera: true,
        zooms: 0,
    }
}

fn model(cameras: &[Camera], share: usize) -> SparseModel {
    let intrinsics = INTRINSICS.resized(560 * share, 420 * share);
    let image = |(index, camera): (usize, &Camera)| {
        ModelImage::posed(index as u32 + 1, 1, format!("v{index:05}.png"), camera)
    };
    SparseModel {
        cameras: vec![ModelCamera::pinhole(1, &intrinsics)],
        images: cameras.iter().enumerate().map(image).collect(),
        points: Vec::new(),
    }
}

/// Adds `count` matches between two cameras: points visible from both positions in `cameras`.
fn see(found: &mut Correspondences, cameras: &[Camera], pair: (usize, usize), count: usize) {
    let mut rng = Pcg64Mcg::seed_from_u64((pair.0 * 100 + pair.1) as u64);
    let mut matches = Vec::new();
    for _ in 0..count {
        let mut away = || 2.0 * rng.random::<f64>() - 1.0;
        let point = DVec3::new(away(), away(), away());
        let mut key_point = |view: usize| {
            let seen = cameras[view].world_to_camera.transform_point3(point);
            let pixel = seen.truncate() / seen.z * INTRINSICS.fx + DVec2::new(280.0, 210.0);
            let points = &mut found.key_points[view];
            points.push((pixel + DVec2::new(away(), away())).as_vec2().to_array());
            points.len() as u32 - 1
        };
        matches.push([key_point(pair.0), key_point(pair.1)]);
    }
    found.pairs.push(PairMatches { first: pair.0, second: pair.1, matches });
}

/// Neighbours on the ring with many matches, the next ones with fewer.
fn neighbours(cameras: &[Camera]) -> Correspondences {
    let count = cameras.len();
    let mut found =
        Correspondences { key_points: vec![Vec::new(); count], ..Correspondences::default() };
    for first in 0..count {
        for (apart, matches) in [(1, 200), (2, 80)] {
            if first + apart < count {
                see(&mut found, cameras, (first, first + apart), matches);
            }
        }
    }
    found
}

/// The cameras from `from` on, moved to the other side of the ring.
fn on_the_wrong_side(cameras: &[Camera], from: usize) -> Vec<Camera> {
    let half = DMat4::from_rotation_y(std::f64::consts::PI);
    let turned = |(index, camera): (usize, &Camera)| match index >= from {
        true => Camera { world_to_camera: camera.world_to_camera * half, ..*camera },
        false => *camera,
    };
    cameras.iter().enumerate().map(turned).collect()
}

#[test]
fn a_true_model_is_fully_trusted_at_any_size_of_its_copies() {
    let cameras = ring(12);
    let found = neighbours(&cameras);
    for share in [1, 3] {
        let (model, small) = (model(&cameras, share), copies(12, 1));
        let consistency = Consistency::of(&model, &copies(12, share), &small, &found);
        assert_eq!(consistency.believed(), (0..12).collect::<Vec<_>>());
        assert_eq!(consistency.parts.len(), 1);
        assert_eq!(consistency.agreeing(&found, &found), found);
        let (matches, fitting) = consistency.matches_of(5);
        assert_eq!(matches, 560);
        assert!(fitting > 530, "{fitting}");
    }
}

/// True matches, and matches between similar places that fit only the wrong poses.
fn misled(cameras: &[Camera], wrong: &[Camera]) -> Correspondences {
    let mut found = neighbours(cameras);
    see(&mut found, wrong, (1, 9), 120);
    see(&mut found, wrong, (3, 10), 100);
    found
}

#[test]
fn photographs_placed_on_the_wrong_side_are_not_trusted() {
    let cameras = ring(12);
    let wrong = on_the_wrong_side(&cameras, 8);
    let found = misled(&cameras, &wrong);
    let (model, small) = (model(&wrong, 1), copies(12, 1));
    let consistency = Consistency::of(&model, &small, &small, &found);
    assert_eq!(consistency.parts, [(0..8).collect::<Vec<_>>(), (8..12).collect()]);
}

#[test]
fn matches_that_do_not_fit_a_true_model_are_left_out() {
    let cameras = ring(12);
    let found = misled(&cameras, &on_the_wrong_side(&cameras, 8));
    let (model, small) = (model(&cameras, 1), copies(12, 1));
    let consistency = Consistency::of(&model, &small, &small, &found);
    assert_eq!(consistency.parts.len(), 1);
    let agreeing = consistency.agreeing(&found, &found);
    assert_eq!(agreeing.pairs, neighbours(&cameras).pairs);
    assert_eq!(agreeing.key_points, found.key_points);
}

#[test]
fn the_strongest_pairs_of_untrusted_photographs_stay() {
    let cameras = ring(12);
    let wrong = on_the_wrong_side(&cameras, 8);
    let found = misled(&cameras, &wrong);
    let strongest = neighbours(&cameras);
    let (model, small) = (model(&wrong, 1), copies(12, 1));
    let consistency = Consistency::of(&model, &small, &small, &found);
    // The pairs across to the wrong side fit the model, but not both of a pair are trusted.
    assert_eq!(consistency.agreeing(&found, &strongest).pairs, strongest.pairs);
}

#[test]
fn a_photograph_that_hardly_matches_any_other_is_not_trusted() {
    let cameras = ring(6);
    let mut found = neighbours(&cameras);
    found.pairs.retain(|pair| pair.second != 5);
    see(&mut found, &cameras, (4, 5), LEAST_MATCHES - 1);
    let small = copies(6, 1);
    let consistency = Consistency::of(&model(&cameras, 1), &small, &small, &found);
    assert_eq!(consistency.parts, [vec![0, 1, 2, 3, 4], vec![5]]);
}

#[test]
fn photographs_without_a_pose_are_in_no_part() {
    let cameras = ring(6);
    let found = neighbours(&cameras);
    let mut model = model(&cameras, 1);
    model.images.truncate(4);
    let small = copies(6, 1);
    let consistency = Consistency::of(&model, &small, &small, &found);
    assert_eq!(consistency.parts, [vec![0, 1, 2, 3]]);
    let nothing = Consistency::of(&SparseModel::default(), &small, &small, &found);
    assert_eq!(nothing.believed(), [] as [usize; 0]);
}
