use glam::EulerRot;
use proptest::prelude::*;

use super::*;
use crate::camera::Intrinsics;

const K: Intrinsics =
    Intrinsics { width: 120, height: 90, fx: 104.0, fy: 104.0, cx: 60.0, cy: 45.0 };

/// Twelve cameras at a distance of about 3 that look at the origin.
fn room() -> Vec<Camera> {
    let camera = |index: usize| {
        let angle = 0.1 * index as f64 - 0.5;
        let eye = DVec3::new(3.0 * angle.sin(), 0.05 * index as f64, -3.0 * angle.cos());
        Camera::look_at(K, eye, DVec3::new(0.0, 0.02 * index as f64, 0.0), DVec3::Y)
    };
    (0..12).map(camera).collect()
}

/// The same in a world that is scaled by `scale`, rotated, and moved by `offset`.
fn elsewhere(cameras: &[Camera], scale: f64, turn: DQuat, offset: DVec3) -> Vec<Camera> {
    let moved = |camera: &Camera| {
        let rotation = DQuat::from_mat3(&camera.rotation()) * turn.inverse();
        let centre = scale * (turn * camera.centre()) + offset;
        Camera::from_pose(camera.intrinsics, rotation, -(rotation * centre))
    };
    cameras.iter().map(moved).collect()
}

proptest! {
    #[test]
    fn every_world_normalises_to_ordinary_size_at_the_origin_and_back(
        exponent in -4.0..5.0_f64,
        offset in prop::array::uniform3(-5e6..5e6_f64),
        angles in prop::array::uniform3(-3.0..3.0_f64),
    ) {
        let scale = 10_f64.powf(exponent);
        let turn = DQuat::from_euler(EulerRot::XYZ, angles[0], angles[1], angles[2]);
        let world = elsewhere(&room(), scale, turn, offset.into());
        let by = Normalisation::of(&world);
        let trained: Vec<Camera> = world.iter().map(|camera| by.within(camera)).collect();
        // The precision of its coordinates in the world.
        let digits = 1e-9 + 1e-14 * DVec3::from(offset).length() / scale;
        let size = viewing_distance(&trained);
        prop_assert!(size >= LEAST_SIZE * (1.0 - digits), "{size}");
        prop_assert!(size <= LEAST_SIZE * SCALE_STEP * (1.0 + digits), "{size}");
        for (camera, given) in trained.iter().zip(&world) {
            let place = camera.centre().abs().max_element();
            prop_assert!(place <= (OFFSET_STEP / 2.0 + 1.0) * size, "{place} of {size}");
            let back = by.in_world(camera);
            let largest = given.translation().abs().max_element().max(scale);
            prop_assert!(back.world_to_camera.abs_diff_eq(given.world_to_camera, 1e-12 * largest));
        }
        // Each camera sees a point at the same pixel in both.
        let point = DVec3::new(0.3, -0.2, 0.1);
        let there = scale * (turn * point) + DVec3::from(offset);
        for ((camera, trained), given) in room().iter().zip(&trained).zip(&world) {
            let (pixel, _) = camera.project(point).expect("before it");
            for (camera, point) in [(trained, by.point_within(there)), (given, there)] {
                let (found, _) = camera.project(point).expect("before it");
                prop_assert!(found.distance(pixel) < 1e3 * digits, "{found} {pixel}");
            }
        }
    }
}

#[test]
fn a_world_of_ordinary_size_at_the_origin_is_unchanged_to_the_bit() {
    for scale in [1.0, 3.0, 10.0] {
        let world = elsewhere(&room(), scale, DQuat::IDENTITY, DVec3::ZERO);
        let by = Normalisation::of(&world);
        assert!(by.is_identity(), "{by:?}");
        assert_eq!(by.within(&world[3]), world[3]);
        assert_eq!(by.in_world(&world[3]), world[3]);
    }
}

#[test]
fn offsets_within_f32_precision_stay_in_files_and_others_are_left_out() {
    let of = |scale: f64, x: f64| {
        let world = elsewhere(&room(), scale, DQuat::IDENTITY, DVec3::new(x, 0.0, 0.0));
        Normalisation::of(&world)
    };
    // At 1000, steps of f32 are 6e-5: a 50,000th of 3.
    let (near, utm) = (of(1.0, 1000.0), of(1.0, 512_345.0));
    assert!(!near.is_identity() && !near.left_out, "{near:?}");
    assert_eq!(near.missing_in_files(), DVec3::ZERO);
    assert!(utm.left_out, "{utm:?}");
    assert_eq!(utm.missing_in_files(), DVec3::new(512_344.0, 0.0, 0.0));
    assert!(!of(1e4, 512_345.0).left_out, "a country");
}

#[test]
fn a_misplaced_camera_has_no_effect() {
    let mut world = room();
    let by = Normalisation::of(&elsewhere(&world, 100.0, DQuat::IDENTITY, DVec3::ZERO));
    let eye = DVec3::new(1e6, 2e6, 0.0);
    world[0] = Camera::look_at(K, eye, eye + DVec3::X, DVec3::Y);
    let with_it = Normalisation::of(&elsewhere(&world, 100.0, DQuat::IDENTITY, DVec3::ZERO));
    assert_eq!(with_it, by);
}

#[test]
fn a_rotation_of_six_digits_far_from_the_origin_does_not_move_cameras() {
    let offset = DVec3::new(512_345.6, 5_412_345.9, 310.2);
    let [exact, ..] = elsewhere(&room(), 1.0, DQuat::from_rotation_y(0.7), offset)[..] else {
        unreachable!("twelve");
    };
    let short = |value: f64| (value * 1e6).round() / 1e6;
    let columns = exact.rotation().to_cols_array().map(short);
    let rotation = DMat3::from_cols_array(&columns);
    let place = exact.centre();
    let given = Camera {
        world_to_camera: glam::DMat4::from_mat3_translation(rotation, -(rotation * place)),
        ..exact
    };
    let by = Normalisation { offset: offset.round(), ..Normalisation::default() };
    let found = by.within(&given).centre();
    assert!(found.distance(place - offset.round()) < 1e-6, "{found}");
    assert!(by.in_world(&by.within(&given)).centre().distance(place) < 1e-6);
}

#[test]
fn cameras_that_do_not_determine_a_size_change_nothing() {
    assert!(Normalisation::of(&[]).is_identity());
    let camera = |angle: f64| {
        let ahead = DVec3::new(angle.sin(), 0.0, angle.cos());
        Camera::look_at(K, DVec3::ONE, DVec3::ONE + ahead, DVec3::Y)
    };
    let at_one_place = [0.0, 0.1, 0.2].map(camera);
    assert!(Normalisation::of(&at_one_place).is_identity());
    let [first, ..] = at_one_place;
    assert!(Normalisation::of(&[first; 3]).is_identity());
}
