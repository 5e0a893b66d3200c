mod devices;
mod explained;
mod interrupted;
mod noisy;

use fled_gpu::Gpu;
use glam::DVec3;
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::*;
use crate::camera::normalisation::Normalisation;
use crate::camera::{Camera, Intrinsics};
use crate::cancel::CancelToken;
use crate::device::{ProcessorScene, Shaken};
use crate::gaussians::{Gaussians, ply};
use crate::image::Image;
use crate::mask::Mask;
use crate::metrics::psnr;
use crate::noise::NoiseMode;
use crate::register;
use crate::shake;
use crate::splat::fixtures::{self, Random};
use crate::splat::rows::pack_geometry;

fn render(gaussians: &Gaussians, camera: &Camera) -> Image {
    render_on(&Device::Processor, gaussians, camera)
}

fn render_on(device: &Device, gaussians: &Gaussians, camera: &Camera) -> Image {
    let mut scene = device.scene(gaussians).expect("uploaded");
    scene.render(camera, gaussians.sh_degree).expect("rendered")
}

fn render_before(gaussians: &Gaussians, camera: &Camera, background: [f32; 3]) -> Image {
    let mut scene = ProcessorScene::new(gaussians);
    let view = scene.draw(camera, gaussians.sh_degree, background);
    Image::from_planar(view.size[0], view.size[1], scene.canvas.image)
}

fn gpu() -> Device {
    Device::Gpu(fixtures::gpu().clone())
}

/// Opaque coloured blobs: a scene that its images determine.
fn truth(count: usize, seed: u64) -> Gaussians {
    let mut random = Random::new(seed);
    let mut scene = fixtures::gaussians(count, 1, seed);
    for i in 0..count {
        scene.means[i] = [0; 3].map(|_| 0.8 * random.signed() as f32);
        scene.log_scales[i] = [0; 3].map(|_| (-2.1 + 0.4 * random.signed()) as f32);
        scene.opacity_logits[i] = 2.0 + random.signed() as f32;
        for (n, value) in scene.sh[12 * i..12 * i + 12].iter_mut().enumerate() {
            *value = (if n < 3 { 1.5 } else { 0.15 } * random.signed()) as f32;
        }
    }
    scene
}

fn camera_at(angle: f64, width: usize, height: usize) -> Camera {
    let focal = 1.1 * width as f64;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let intrinsics = Intrinsics { width, height, fx: focal, fy: focal, cx, cy };
    let eye = DVec3::new(3.0 * angle.sin(), -0.6 * (2.0 * angle).cos(), -3.0 * angle.cos());
    Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y)
}

fn views_of(scene: &Gaussians, angles: &[f64], size: [usize; 2]) -> Vec<TrainingView> {
    let view = |(n, &angle): (usize, &f64)| {
        let camera = camera_at(angle, size[0], size[1]);
        TrainingView {
            noise: None,
            has_kernel: true,
            name: format!("{n}"),
            camera,
            image: render(scene, &camera),
            mask: None,
        }
    };
    angles.iter().enumerate().map(view).collect()
}

fn config(steps: u32, cap: usize) -> TrainConfig {
    TrainConfig {
        shake: None,
        refine_poses: None,
        steps,
        cap,
        sh_degree: 1,
        noise: NoiseMode::Off,
        resolution_schedule: false,
        pace: Pace::Adapted,
        warm: false,
        background: Background::Black,
        densify: Densify::Mcmc,
        seed: 3,
        extent: 1.0,
    }
}

/// The points that structure from motion would find: noisy means with the right colours.
fn points_of(scene: &Gaussians) -> Vec<Point> {
    let mut random = Random::new(99);
    let colour = |v: f32| ((0.5 + 0.282 * v).clamp(0.0, 1.0) * 255.0) as u8;
    (0..scene.len())
        .map(|i| {
            let position = scene.means[i].map(|v| v + 0.02 * random.signed() as f32);
            let colour = [0, 1, 2].map(|c| colour(scene.sh[12 * i + c]));
            Point { position, colour }
        })
        .collect()
}

fn start(views: &[TrainingView], scene: &Gaussians, config: &TrainConfig) -> TrainStart {
    let (points, cameras) = (points_of(scene), views.iter().map(|v| v.camera));
    let extent = scene_extent(&cameras.collect::<Vec<_>>(), &points);
    let first = initialise::gaussians_at(&points, extent, Pace::Adapted);
    TrainStart::Fresh(first.with_sh_degree(config.sh_degree))
}

fn trained(views: &[TrainingView], start: TrainStart, config: &TrainConfig) -> Trained {
    trained_on(&Device::Processor, views, start, config)
}

fn trained_on(
    device: &Device,
    views: &[TrainingView],
    start: TrainStart,
    config: &TrainConfig,
) -> Trained {
    let mut hooks = TrainHooks {
        cancel: &CancelToken::new(),
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: None,
        look: None,
    };
    train(device, views, start, config, &mut hooks).expect("trains")
}

fn bytes(scene: &Gaussians) -> Vec<u8> {
    let mut bytes = Vec::new();
    ply::write_to(scene, &Normalisation::default(), &mut bytes).expect("written");
    bytes
}

/// The views with a square of this colour in the middle of each, and masks that hide it.
fn covered(views: &[TrainingView], colour: [f32; 3], is_masked: bool) -> Vec<TrainingView> {
    let cover = |view: &TrainingView| {
        let (width, height) = (view.image.width(), view.image.height());
        let is_middle = |i: usize| {
            let (x, y) = (i % width, i / width);
            (3 * width / 8..5 * width / 8).contains(&x) && (height / 4..height / 2).contains(&y)
        };
        let mut image = view.image.clone();
        (0..width * height)
            .filter(|&i| is_middle(i))
            .for_each(|i| image.set(i % width, i / width, colour));
        let kept = (0..width * height).map(|i| !is_middle(i)).collect();
        let mask = is_masked.then(|| Mask::new(width, height, kept));
        TrainingView { image, mask, ..view.clone() }
    };
    views.iter().map(cover).collect()
}

#[test]
fn masked_pixels_do_not_affect_the_scene() {
    let scene = truth(200, 5);
    let angles: Vec<_> = (0..7).map(|n| -0.6 + 0.2 * f64::from(n)).collect();
    let views = views_of(&scene, &angles, [96, 64]);
    let mut config = config(250, 400);
    config.resolution_schedule = true;
    let of = |colour, is_masked| {
        let views = covered(&views, colour, is_masked);
        trained(&views, start(&views, &scene, &config), &config)
    };
    let (magenta, green) = (of([1.0, 0.0, 1.0], true), of([0.0, 1.0, 0.0], true));
    assert_eq!(magenta.gaussians, green.gaussians, "the colour of what is masked tells nothing");
    assert_eq!(magenta.final_loss, green.final_loss);
    let seen = of([1.0, 0.0, 1.0], false);
    let score = |trained: &Trained| {
        let image = render(&trained.gaussians, &views[3].camera);
        let mask = covered(&views[3..4], [0.0; 3], true)[0].mask.clone().expect("masked");
        let middle = mask.pixels().iter().map(|kept| !kept).collect();
        let middle = Mask::new(96, 64, middle);
        psnr(&middle.pixels_of(&image), &middle.pixels_of(&views[3].image))
    };
    let (masked, unmasked) = (score(&magenta), score(&seen));
    assert!(masked > unmasked + 3.0, "{masked} dB masked, {unmasked} dB not");
}

#[test]
fn the_seen_hook_is_called_every_25_steps_without_effect() {
    let scene = truth(60, 2);
    let views = views_of(&scene, &[-0.1, 0.1], [64, 48]);
    let config = config(60, 400);
    let alone = trained(&views, start(&views, &scene, &config), &config);
    let mut seen = Vec::new();
    let mut hooks = TrainHooks {
        cancel: &CancelToken::new(),
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: Some(&mut |one: Seen| seen.push(one)),
        look: None,
    };
    let begin = start(&views, &scene, &config);
    let watched = train(&Device::Processor, &views, begin, &config, &mut hooks).expect("trains");
    assert_eq!(bytes(&watched.gaussians), bytes(&alone.gaussians));
    let steps: Vec<u32> = seen.iter().map(|one| one.step).collect();
    assert_eq!(steps, [25, 50]);
    for one in seen {
        assert!(one.loss > 0.0 && one.loss < 1.0 && one.gaussians > 0, "{one:?}");
    }
}

#[test]
fn the_look_hook_sees_the_current_scene_without_effect() {
    looks(&gpu());
    looks(&Device::Processor);
}

fn looks(device: &Device) {
    let scene = truth(60, 2);
    let views = views_of(&scene, &[-0.1, 0.1], [64, 48]);
    let config = config(60, 400);
    let alone = trained_on(device, &views, start(&views, &scene, &config), &config);
    // Larger than the views in training: the splats touch more tiles than their buffers hold.
    let camera = camera_at(0.3, 640, 480);
    let mut seen = Vec::new();
    let mut hooks = TrainHooks {
        cancel: &CancelToken::new(),
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: None,
        look: Some(&mut |look: &mut Look<'_>| {
            let small = look.render(&views[0].camera)?;
            assert_eq!((small.width(), small.height()), (64, 48));
            seen.push((look.step, look.is_last(), look.render(&camera)?));
            Ok(())
        }),
    };
    let begin = start(&views, &scene, &config);
    let watched = train(device, &views, begin, &config, &mut hooks).expect("trains");
    assert!(bytes(&watched.gaussians) == bytes(&alone.gaussians));
    let steps: Vec<u32> = seen.iter().map(|(step, ..)| *step).collect();
    assert!([25, 50, 60].iter().all(|step| steps.contains(step)), "{steps:?}");
    let lasts = seen.iter().filter(|(_, is_last, _)| *is_last);
    let last: Vec<_> = lasts.collect();
    assert_eq!((last.len(), last[0].0), (1, 60));
    assert!(last[0].2 == render_on(device, &watched.gaussians, &camera), "as it is delivered");
    assert!(seen[0].2 != last[0].2, "it has learnt since");
}

#[test]
fn two_thousand_gaussians_overfit_one_image() {
    let scene = truth(300, 5);
    let views = views_of(&scene, &[0.2], [96, 64]);
    let config = config(300, 2_000);
    let result = trained(&views, start(&views, &scene, &config), &config);
    let quality = psnr(&render(&result.gaussians, &views[0].camera), &views[0].image);
    assert!(quality > 33.0, "{quality:.2} dB");
    assert!(result.gaussians.len() <= 2_000 && result.non_finite_gradients == 0);
    assert!(result.final_loss < 0.03, "{}", result.final_loss);
}

#[test]
fn eight_views_of_a_synthetic_scene_predict_held_out_ones() {
    let scene = truth(150, 8);
    let angles: Vec<_> = (0..8).map(|n| -0.6 + 0.17 * f64::from(n)).collect();
    let views = views_of(&scene, &angles, [96, 64]);
    let config = TrainConfig { resolution_schedule: true, ..config(500, 1_000) };
    let result = trained(&views, start(&views, &scene, &config), &config);
    let held_out = views_of(&scene, &[-0.35, 0.0, 0.33], [96, 64]);
    let scores: Vec<_> =
        held_out.iter().map(|v| psnr(&render(&result.gaussians, &v.camera), &v.image)).collect();
    let mean = scores.iter().sum::<f64>() / scores.len() as f64;
    assert!(mean >= 30.0, "{mean:.2} dB of {scores:?}, {} Gaussians", result.gaussians.len());
}

#[test]
fn equal_seeds_give_equal_bytes_and_other_seeds_do_not() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [64, 48]);
    let config = TrainConfig { resolution_schedule: true, ..config(120, 400) };
    for device in fixtures::devices() {
        let run = |config: &TrainConfig| {
            bytes(&trained_on(&device, &views, start(&views, &scene, config), config).gaussians)
        };
        let (first, second) = (run(&config), run(&config));
        assert!(first == second, "two runs of one seed differ");
        assert!(first != run(&TrainConfig { seed: 4, ..config.clone() }), "the seed has no effect");
    }
}

#[test]
fn a_scene_larger_than_a_binding_trains_to_the_same_bytes() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [32, 32]);
    let config = TrainConfig { sh_degree: 3, ..config(120, 500) };
    let small = Gpu::binding_at_most("auto", 64 * 1024).expect("an adapter");
    // Adam's moments of the harmonics: 2 x 48 numbers per Gaussian.
    assert_eq!(small.rows_per_part(2 * 48 * 4), 170);
    let small = Device::Gpu(small);
    let begin = || start(&views, &scene, &config);
    let (whole, parts) = (
        trained_on(&gpu(), &views, begin(), &config),
        trained_on(&small, &views, begin(), &config),
    );
    assert_eq!(whole.gaussians.len(), 500);
    assert!(bytes(&whole.gaussians) == bytes(&parts.gaussians));
}

#[test]
fn a_step_that_overflows_is_repeated_in_larger_buffers() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.3], [64, 48]);
    let config = config(60, 120);
    let begin = || start(&views, &scene, &config);
    let small = trainer::Trainer::new(&gpu(), &views, begin(), &config).expect("made");
    let small = small.with_intersections(50);
    let cancel = CancelToken::new();
    let mut hooks = TrainHooks {
        cancel: &cancel,
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: None,
        look: None,
    };
    let grown = small.run(&mut hooks).expect("trains");
    let roomy = trained_on(&gpu(), &views, begin(), &config);
    let quality = |t: &Trained| psnr(&render(&t.gaussians, &views[0].camera), &views[0].image);
    assert!(
        (quality(&grown) - quality(&roomy)).abs() < 1.0,
        "{} {}",
        quality(&grown),
        quality(&roomy)
    );
}

#[test]
fn a_device_waits_for_the_host_only_where_the_scene_is_needed() {
    let scene = truth(60, 2);
    let views = views_of(&scene, &[-0.3, 0.3], [32, 24]);
    let idle = |steps, last, refine_poses| {
        let config = TrainConfig {
            resolution_schedule: true,
            shake: Some(Response::srgb()),
            refine_poses,
            ..config(steps, 80)
        };
        let begin = start(&views, &scene, &config);
        let trainer = trainer::Trainer::new(&gpu(), &views, begin, &config);
        trainer.expect("made").idle_before(last)
    };
    // Growth every hundred steps; the resolution changes at 500.
    let long: Vec<u32> = (0..520).filter(|step| step % 100 == 0).collect();
    assert_eq!(idle(5_000, 520, None), long);
    // 60 steps grow every ten of them, correct cameras every twelve from 24 on, and solve for
    // kernels eight times from 18 on.
    let short = [0, 6, 10, 18, 20, 22, 24, 25, 26, 30, 31, 36, 37, 40, 43, 48, 50, 52];
    assert_eq!(idle(60, 60, Some(3.0)), short);
}

#[test]
fn a_poisoned_start_neither_spreads_nor_stays_in_the_scene() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.3], [64, 48]);
    let config = config(60, 400);
    let TrainStart::Fresh(mut gaussians) = start(&views, &scene, &config) else { panic!("fresh") };
    gaussians.means[0][1] = f32::NAN;
    gaussians.quats[1] = [0.0; 4];
    gaussians.log_scales[2] = [3e38; 3];
    gaussians.sh[3 * 12] = f32::INFINITY;
    gaussians.opacity_logits[4] = f32::NAN;
    let result = trained(&views, TrainStart::Fresh(gaussians), &config);
    assert!((0..result.gaussians.len()).all(|i| result.gaussians.is_usable(i)));
    let image = render(&result.gaussians, &views[0].camera);
    assert!(image.data().iter().all(|v| v.is_finite()));
    assert!(psnr(&image, &views[0].image) > 18.0);
}

#[test]
fn a_scene_that_no_view_sees_trains_to_its_end() {
    let scene = truth(60, 2);
    let mut views = views_of(&scene, &[0.0], [64, 48]);
    let config = config(30, 100);
    let begin = start(&views, &scene, &config);
    views[0].camera = Camera::look_at(
        views[0].camera.intrinsics,
        DVec3::new(0.0, 0.0, -3.0),
        DVec3::new(0.0, 0.0, -9.0),
        DVec3::Y,
    );
    let result = trained(&views, begin, &config);
    assert_eq!(result.non_finite_gradients, 0);
    assert!(!result.gaussians.is_empty());
}

#[test]
fn relocation_keeps_the_image_of_an_isolated_splat() {
    let mut scene = truth(2, 2);
    scene.means = vec![[0.0; 3], [0.0, 0.0, 500.0]];
    scene.log_scales = vec![[-1.5, -1.5, -1.5]; 2];
    scene.opacity_logits = vec![0.8, -9.0];
    let camera = camera_at(0.0, 96, 64);
    let before = render(&scene, &camera);
    let rows = pack_geometry(&scene);
    let schedule = config(1, 2).schedule();
    let mut random = schedule.generator(schedule::Stream::Densification, 0);
    let plan = densify::plan(&rows, 2, &mut random);
    let setup = training::Setup {
        gaussians: &scene,
        capacity: 2,
        size: [96, 64],
        views: 1,
        shake: None,
        noise: None,
        accumulates: false,
    };
    for device in fixtures::devices() {
        let mut training = training::begin(&device, &setup).expect("created");
        training.relocate(&plan).expect("relocated");
        let after = render(&training.save().expect("read").gaussians(), &camera);
        let pairs = before.data().iter().zip(after.data());
        let difference: f32 = pairs.map(|(a, b)| (a - b).abs()).sum();
        let mass: f32 = before.data().iter().sum();
        assert!(mass > 1.0 && difference <= 0.02 * mass * 3.0, "{difference} of {mass}");
    }
}

/// Prints what the host does between the steps of a round. Run with `cargo test --release -p
/// fled-core host_times -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn host_times() {
    let best = |what: &str, work: &mut dyn FnMut()| {
        let times = (0..9).map(|_| {
            let begun = std::time::Instant::now();
            work();
            begun.elapsed().as_secs_f64() * 1e3
        });
        eprintln!("{what}: {:.1} ms", times.fold(f64::INFINITY, f64::min));
    };
    let scene = truth(150, 5);
    for (width, height) in [(420, 280), (560, 374), (1120, 746)] {
        let seen = render(&scene, &camera_at(0.0, width, height));
        let moved: Vec<Image> =
            (1..8).map(|n| render(&scene, &camera_at(0.001 * n as f64, width, height))).collect();
        let [photograph, probed @ ..] = &moved[..] else { panic!("seven") };
        let probed: [Image; 6] = probed.to_vec().try_into().expect("six");
        best(&format!("a kernel at {width}x{height}"), &mut || {
            shake::estimate_by_cells(&seen, photograph, &Response::srgb(), None);
        });
        let probes = register::probes(&camera_at(0.0, width, height), 3.0);
        best(&format!("a camera at {width}x{height}"), &mut || {
            register::correction(photograph, &seen, &probed, &probes, None);
            register::difference(photograph, &seen, None);
        });
    }
    let rows = pack_geometry(&truth(100_000, 5));
    let mut random = Pcg64::seed_from_u64(1);
    best("growth of 100,000", &mut || {
        densify::plan(&rows, 105_000, &mut random);
    });
}
