//! Tests of effects kept apart from the scene (background, shake, cameras), and of densification.

use super::*;
use crate::register::Motion;
use crate::shake::shaken_image;
use crate::shake::{ShakeKernel, Tap};

#[test]
fn a_random_background_makes_a_dark_surface_opaque() {
    let mut scene = truth(300, 8);
    let angles: Vec<_> = (0..6).map(|n| -0.5 + 0.2 * f64::from(n)).collect();
    // Black from every direction.
    scene
        .sh
        .iter_mut()
        .enumerate()
        .for_each(|(n, value)| *value = if n % 12 < 3 { -1.8 } else { 0.0 });
    scene.log_scales.fill([-1.2; 3]);
    scene.opacity_logits.fill(6.0);
    let views = views_of(&scene, &angles, [96, 64]);
    let share_seen_through = |background: Background| {
        let config = TrainConfig { background, ..config(300, 1_000) };
        let result = trained(&views, start(&views, &scene, &config), &config);
        let camera = &views[2].camera;
        let lit = render_before(&result.gaussians, camera, [1.0; 3]);
        let covered = render_before(&scene, camera, [1.0; 3]);
        let pixels: Vec<usize> = (0..96 * 64).filter(|&i| covered.data()[i] < 0.02).collect();
        pixels.iter().map(|&i| f64::from(lit.data()[i])).sum::<f64>() / pixels.len() as f64
    };
    let (black, random) =
        (share_seen_through(Background::Black), share_seen_through(Background::Random));
    assert!(
        black > 3.0 * random && random < 0.1,
        "{black:.3} before black, {random:.3} before random"
    );
}

#[test]
fn kernels_make_a_scene_of_shaken_views_sharper() {
    let mut scene = truth(700, 8);
    // Blobs of about 2 px: smaller than the shake.
    scene.log_scales.iter_mut().flatten().for_each(|scale| *scale -= 1.2);
    let angles: Vec<_> = (0..8).map(|n| -0.6 + 0.17 * f64::from(n)).collect();
    let mut views = views_of(&scene, &angles, [160, 112]);
    let response = Response::srgb();
    for (n, view) in views.iter_mut().enumerate() {
        view.image = shaken(&view.image, 0.8 * n as f64, &response);
    }
    let held_out = views_of(&scene, &[-0.35, 0.0, 0.33], [160, 112]);
    let quality = |shake: Option<Response>| {
        let config = TrainConfig { resolution_schedule: true, shake, ..config(300, 1_500) };
        let result = trained(&views, start(&views, &scene, &config), &config);
        let scores = held_out.iter().map(|v| psnr(&render(&result.gaussians, &v.camera), &v.image));
        scores.sum::<f64>() / held_out.len() as f64
    };
    let (without, with) = (quality(None), quality(Some(response.clone())));
    assert!(with > without + 0.5, "{without:.2} dB without, {with:.2} dB with");
}

/// Mean distance between the projections of the scene's centre through the cameras of each pair,
/// px.
fn apart(cameras: &[Camera], others: &[Camera]) -> f64 {
    let seen = |camera: &Camera| camera.project(DVec3::ZERO).expect("before the camera").0;
    let ways = cameras.iter().zip(others).map(|(a, b)| (seen(a) - seen(b)).length());
    ways.sum::<f64>() / cameras.len() as f64
}

#[test]
fn wrong_cameras_are_corrected_and_held_out_ones_registered() {
    let scene = truth(300, 8);
    let angles: Vec<_> = (0..9).map(|n| -0.6 + 0.15 * f64::from(n)).collect();
    let views = views_of(&scene, &angles, [160, 112]);
    let wrong = |n: usize, view: &TrainingView| {
        let off = |k: f64| 0.012 * (2.3 * n as f64 + k).sin();
        let twist = [off(0.0), off(1.7), 0.0, 0.0, 0.0, 0.0].map(|x| x as f32);
        TrainingView {
            noise: None,
            has_kernel: true,
            camera: Motion { twist }.moved(&view.camera),
            ..view.clone()
        }
    };
    let given: Vec<TrainingView> =
        views.iter().enumerate().map(|(n, view)| wrong(n, view)).collect();
    let (held_out, given) = given.split_first().expect("nine");
    let config = TrainConfig { refine_poses: Some(3.0), ..config(300, 1_000) };
    let fixed = TrainConfig { refine_poses: None, ..config.clone() };
    let truth: Vec<Camera> = views[1..].iter().map(|view| view.camera).collect();
    let as_given: Vec<Camera> = given.iter().map(|view| view.camera).collect();
    let refined = trained(given, start(given, &scene, &config), &config);
    let unrefined = trained(given, start(given, &scene, &fixed), &fixed);
    assert_eq!(unrefined.cameras, as_given);
    let (before, after) = (apart(&as_given, &truth), apart(&refined.cameras, &truth));
    assert!(before > 1.0 && after < 0.6 * before, "{before:.2} px off before, {after:.2} after");
    assert!(refined.final_loss < unrefined.final_loss);
    let registered = |cancel: &CancelToken| -> Result<Vec<Camera>, ReconstructError> {
        let held_out = std::slice::from_ref(held_out);
        Registration::new(&Device::Processor, held_out, &refined.gaussians, None)?
            .cameras(3.0, cancel)
    };
    let cancel = CancelToken::new();
    let found = registered(&cancel).expect("found");
    cancel.cancel();
    assert!(matches!(registered(&cancel), Err(ReconstructError::Cancelled(_))));
    let quality = |camera: &Camera| psnr(&render(&refined.gaussians, camera), &held_out.image);
    let (before, after) = (quality(&held_out.camera), quality(&found[0]));
    assert!(
        after > before + 1.0,
        "{before:.2} dB where it was given, {after:.2} where it was found"
    );
}

/// The image moved back and forth along `angle`, 7 px in all.
fn shaken(image: &Image, angle: f64, response: &Response) -> Image {
    let tap = |n: i32| {
        let offset = [angle.cos(), angle.sin()].map(|along| (along * f64::from(n)).round() as i32);
        Tap::even(offset, 1.0)
    };
    let kernel = ShakeKernel::new((-3..=3).map(tap).collect());
    shaken_image(image, &kernel, response)
}

#[test]
fn classic_densification_grows_and_learns_the_scene() {
    let scene = truth(150, 8);
    let angles: Vec<_> = (0..8).map(|n| -0.6 + 0.17 * f64::from(n)).collect();
    let views = views_of(&scene, &angles, [96, 64]);
    let mcmc = config(400, 1_000);
    let classic = TrainConfig { densify: Densify::Classic, ..mcmc.clone() };
    let few = || {
        let TrainStart::Fresh(all) = start(&views, &scene, &mcmc) else { panic!("fresh") };
        all.select(&(0..100).collect::<Vec<_>>())
    };
    let grown = trained(&views, TrainStart::Fresh(few()), &classic);
    let fixed = trained(&views, TrainStart::Fresh(few()), &TrainConfig { cap: 100, ..mcmc });
    let held_out = &views_of(&scene, &[0.05], [96, 64])[0];
    let quality = |t: &Trained| psnr(&render(&t.gaussians, &held_out.camera), &held_out.image);
    assert_eq!(fixed.gaussians.len(), 100);
    assert!((150..=1_000).contains(&grown.gaussians.len()), "{}", grown.gaussians.len());
    assert!(quality(&grown) > quality(&fixed) + 0.5, "{} {}", quality(&grown), quality(&fixed));
}
