use glam::DVec3;

use super::*;
use crate::camera::Intrinsics;

const DEPTH: f64 = 3.0;

fn camera_at(eye: DVec3) -> Camera {
    let intrinsics = Intrinsics { width: 96, height: 64, fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };
    Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y)
}

/// A smooth picture painted on two walls in front of the camera, at 0.7 and 1.3 of the depth.
fn seen(camera: &Camera) -> Image {
    let k = camera.intrinsics;
    let mut image = Image::new(k.width, k.height);
    let (origin, to_world) = (camera.centre(), camera.rotation().transpose());
    for y in 0..k.height {
        for x in 0..k.width {
            let ray =
                DVec3::new((x as f64 + 0.5 - k.cx) / k.fx, (y as f64 + 0.5 - k.cy) / k.fy, 1.0);
            let ray = to_world * ray;
            let wall = if x < k.width / 2 { -0.3 * DEPTH } else { 0.3 * DEPTH };
            let point = origin + ray * ((wall - origin.z) / ray.z);
            let value = 0.5
                + 0.2 * (7.0 * point.x).sin() * (5.0 * point.y).cos()
                + 0.1 * (11.0 * point.y).sin();
            image.set(x, y, [value as f32, 0.8 * value as f32, (1.0 - value) as f32]);
        }
    }
    image
}

/// Largest distance between the projections of points in front of both cameras, px.
fn apart(a: &Camera, b: &Camera) -> f64 {
    let points = [[0.0, 0.0, 1.0], [0.8, 0.4, -0.8], [-0.9, 0.3, 0.5], [0.4, -0.6, -0.5]];
    let way = |p: &[f64; 3]| {
        let p = DVec3::from(*p);
        (a.project(p).expect("before it").0 - b.project(p).expect("before it").0).length()
    };
    points.iter().map(way).fold(0.0, f64::max)
}

fn corrected(photograph: &Image, given: &Camera, rounds: usize) -> Motion {
    let mut motion = Motion::default();
    for _ in 0..rounds {
        let camera = motion.moved(given);
        let probes = probes(&camera, DEPTH);
        let probed = probes.map(|probe| seen(&motion.plus(&probe).moved(given)));
        let by = correction(photograph, &seen(&camera), &probed, &probes, None).expect("tells");
        motion = motion.plus(&by);
    }
    motion
}

#[test]
fn an_exposure_or_a_shadow_is_not_taken_for_a_motion() {
    let truth = camera_at(DVec3::new(0.2, -0.1, -DEPTH));
    let mut photograph = seen(&truth).map(|value| 0.7 * value + 0.05);
    let width = photograph.width();
    for (at, value) in photograph.data_mut().iter_mut().enumerate() {
        *value += 0.1 * (at % width) as f32 / width as f32;
    }
    let motion = corrected(&photograph, &truth, 3);
    let moved = apart(&motion.moved(&truth), &truth);
    assert!(moved < 0.1, "{moved} px");
}

#[test]
fn a_camera_that_is_a_pixel_off_is_corrected() {
    let truth = camera_at(DVec3::new(0.2, -0.1, -DEPTH));
    let photograph = seen(&truth);
    for twist in [[0.008, -0.006, 0.004, 0.02, -0.01, 0.03], [0.0, 0.0, -0.01, -0.03, 0.02, 0.0]] {
        let given = Motion { twist }.moved(&truth);
        assert!(apart(&given, &truth) > 0.5, "{}", apart(&given, &truth));
        let found = corrected(&photograph, &given, 6).moved(&given);
        assert!(apart(&found, &truth) < 0.03, "{} px left", apart(&found, &truth));
    }
}

#[test]
fn noise_and_missing_objects_hardly_move_a_camera() {
    let truth = camera_at(DVec3::new(-0.3, 0.1, -DEPTH));
    let mut photograph = seen(&truth);
    for (i, value) in photograph.data_mut().iter_mut().enumerate() {
        *value += (0.05 * (12.9898 * i as f64).sin() * (78.233 * i as f64).cos()) as f32;
    }
    for y in 20..40 {
        (60..75).for_each(|x| photograph.set(x, y, [0.0; 3]));
    }
    let found = corrected(&photograph, &truth, 3).moved(&truth);
    assert!(apart(&found, &truth) < 0.1, "{} px", apart(&found, &truth));
}

#[test]
fn corrections_are_bounded_and_flat_images_give_none() {
    let truth = camera_at(DVec3::new(0.0, 0.0, -DEPTH));
    let given = Motion { twist: [0.06, 0.0, 0.0, 0.0, 0.0, 0.0] }.moved(&truth);
    let far = corrected(&seen(&truth), &given, 1).moved(&given);
    // All six degrees of freedom at their limit.
    assert!(apart(&far, &given) < 6.0, "{}", apart(&far, &given));
    let probes = probes(&truth, DEPTH);
    let flat = Image::from_planar(96, 64, vec![0.4; 3 * 96 * 64]);
    let same = std::array::from_fn(|_| flat.clone());
    assert_eq!(correction(&flat, &flat, &same, &probes, None), None);
    let mut broken = seen(&truth);
    broken.data_mut()[3_000] = f32::NAN;
    assert_eq!(
        correction(&broken, &seen(&truth), &probes.map(|_| seen(&given)), &probes, None),
        None
    );
}

#[test]
fn only_the_motion_common_to_all_cameras_is_removed() {
    let eyes = [
        [0.0, 0.0, -3.0],
        [1.0, 0.3, -2.8],
        [-1.0, 0.2, -2.9],
        [0.4, -0.7, -3.1],
        [-0.5, 0.8, -3.0],
    ];
    let cameras = eyes.map(|eye| camera_at(DVec3::from(eye)));
    let centre = cameras.iter().map(Camera::centre).sum::<DVec3>() / 5.0;
    let (turn, shift, growth) =
        (DVec3::new(0.002, -0.001, 0.0015), DVec3::new(0.01, 0.02, -0.005), 0.004);
    let mut motions = cameras.map(|camera| {
        let arm = camera.centre() - centre;
        Motion::default().plus(&camera_motion(
            &camera,
            turn,
            turn.cross(arm) + shift + growth * arm,
        ))
    });
    hold_gauge(&cameras, &mut motions);
    for motion in motions {
        assert!(motion.twist.iter().all(|x| x.abs() < 1e-4), "{motion:?}");
    }
    let mut one = [Motion::default(); 5];
    one[2].twist[3] = 0.01;
    hold_gauge(&cameras, &mut one);
    assert!(one[2].twist[3] > 0.004, "{one:?}");
}

#[test]
fn a_world_motion_round_trips_through_its_twist() {
    let camera = camera_at(DVec3::new(0.7, -0.4, -2.0));
    let (turned, displaced) = (DVec3::new(1e-4, -2e-4, 3e-4), DVec3::new(-2e-4, 1e-4, 4e-4));
    let motion = Motion::default().plus(&camera_motion(&camera, turned, displaced));
    let (turn, way) = world_motion(&camera, &motion.moved(&camera));
    assert!((turn - turned).length() < 1e-7 && (way - displaced).length() < 1e-6, "{turn} {way}");
}

#[test]
fn masked_pixels_do_not_move_a_camera() {
    let camera = camera_at(DVec3::new(0.2, -0.1, -DEPTH));
    let photograph = seen(&camera);
    let (width, height) = (photograph.width(), photograph.height());
    let given = Motion { twist: [0.004, -0.003, 0.002, 0.01, -0.005, 0.015] }.moved(&camera);
    let render = seen(&given);
    let probes = probes(&given, DEPTH);
    let probed = probes.map(|probe| seen(&Motion::default().plus(&probe).moved(&given)));
    let is_hand = |i: usize| i % width < width / 3;
    let covered = |colour: f32| {
        let mut image = photograph.clone();
        let hand = (0..width * height).filter(|&i| is_hand(i));
        hand.for_each(|i| image.set(i % width, i / width, [colour; 3]));
        image
    };
    let kept = (0..width * height).map(|i| !is_hand(i)).collect();
    let kept = Mask::new(width, height, kept);
    let by = |image: &Image| correction(image, &render, &probed, &probes, Some(&kept));
    assert!(by(&photograph).is_some());
    assert_eq!(by(&covered(0.9)), by(&photograph));
    let apart = |image: &Image| difference(image, &render, Some(&kept));
    assert_eq!(apart(&covered(0.9)), apart(&photograph));
    let nothing = Mask::new(width, height, vec![false; width * height]);
    assert_eq!(correction(&photograph, &render, &probed, &probes, Some(&nothing)), None);
}
