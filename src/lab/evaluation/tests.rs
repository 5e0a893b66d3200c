//! A synthetic scene, judged against its own renders in another world.

use std::path::Path;

use glam::{DQuat, DVec3};

use super::*;
use fled_core::camera::{Intrinsics, NamedCamera, Split};
use fled_core::capture::{CaptureView, PreparedImage};
use fled_core::gaussians::Gaussians;
use fled_core::photo_path::PhotoPath;
use fled_core::poses::align::Similarity;
use fled_core::poses::{Distortion, Lens, PosedView, Poses};
use fled_core::register::{Motion, probes};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const SIZE: [usize; 2] = [120, 90];

/// Six cameras side by side; the run lacks those with odd numbers.
fn cameras() -> Vec<NamedCamera> {
    let intrinsics =
        Intrinsics { width: SIZE[0], height: SIZE[1], fx: 110.0, fy: 110.0, cx: 60.0, cy: 45.0 };
    let camera = |index: usize| {
        let eye = DVec3::new(0.3 * index as f64 - 0.75, 0.1 * (index % 2) as f64, -3.0);
        let camera = Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y);
        NamedCamera::new(format!("v{index}"), &camera, Split::Train)
    };
    (0..6).map(camera).collect()
}

/// The poses that the run found, without distortion.
fn poses() -> Poses {
    let view = |named: NamedCamera| PosedView {
        name: named.name.clone(),
        camera: named.camera(),
        lens: Lens { intrinsics: named.intrinsics, distortion: Distortion::None },
    };
    Poses { views: cameras().into_iter().map(view).collect(), ..Poses::default() }
}

/// A cloud of Gaussians around the origin.
fn gaussians() -> Gaussians {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut signed = || random.random_range(-1.0..1.0_f32);
    let mut cloud = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for _ in 0..400 {
        cloud.means.push([1.8, 1.2, 1.0].map(|size| size * signed()));
        cloud.log_scales.push([0; 3].map(|_| signed() - 2.6));
        cloud.quats.push([0; 4].map(|_| signed()));
        cloud.opacity_logits.push(2.0 * signed());
        cloud.sh.extend((0..12).map(|_| 0.4 * signed()));
    }
    cloud
}

/// The run: its scene and every second camera.
fn subject() -> Subject {
    let every_second = cameras().into_iter().step_by(2).collect();
    Subject::new(gaussians(), every_second, poses())
}

/// Renders of the scene as photographs from another world; `moved` gives their true cameras.
fn truth(folder: &Path, moved: impl Fn(usize, &Camera) -> Camera) -> Truth {
    let other_world = Similarity {
        scale: 2.5,
        rotation: DQuat::from_scaled_axis(DVec3::new(0.3, -0.8, 0.2)),
        translation: DVec3::new(4.0, -1.0, 2.0),
    };
    let renderer = Renderer::new(&Device::Processor);
    let scene = renderer.upload(&subject().gaussians).expect("uploads");
    let views = cameras().into_iter().enumerate().map(|(index, named)| {
        let camera = named.camera();
        let photograph = renderer.render_scene(&scene, &moved(index, &camera));
        let file = folder.join(format!("{}.png", named.name));
        let photograph = photograph.expect("renders");
        photograph.save(&file).expect("saves");
        let prepared = PreparedImage::write(&photograph.to_linear(), &file.with_extension("half"));
        let path = PhotoPath::new(&format!("{}.png", named.name));
        let view = CaptureView {
            file,
            ..CaptureView::upright(named.name.clone(), path, prepared.expect("written"))
        };
        let posed = PosedView {
            name: named.name,
            camera: other_world.camera(&camera),
            lens: Lens { intrinsics: camera.intrinsics, distortion: Distortion::None },
        };
        (view, posed)
    });
    Truth::new(views.collect())
}

fn judge(subject: &Subject, truth: &Truth, inside: bool) -> Result<Evaluation, EvaluationError> {
    let judged = evaluate(Request {
        subject,
        truth,
        seen_from: subject,
        masks: None,
        inside,
        device: &Device::Processor,
        lpips: None,
        cancel: &CancelToken::default(),
    })?;
    assert_eq!(judged.pictures.len(), judged.evaluation.views.len());
    Ok(judged.evaluation)
}

#[test]
fn the_true_scene_scores_perfectly_in_another_world() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = truth(folder.path(), |_, camera| *camera);
    let evaluation = judge(&subject(), &truth, false).expect("judged");
    let names: Vec<&str> = evaluation.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["v1", "v3", "v5"]);
    assert_eq!((evaluation.training_views, evaluation.tied_views), (3, 3));
    assert!(evaluation.camera_error < 1e-9, "{evaluation:?}");
    for view in &evaluation.views {
        // 8 bits allow 58.9 dB.
        assert!(view.mapped.all.psnr_db > 55.0, "{view:?}");
        assert!(view.moved_px < 0.05, "{view:?}");
        assert!(view.seen > 0.2, "{view:?}");
        assert!(["v0", "v2", "v4"].contains(&view.nearest.as_str()));
    }
    let inside = judge(&subject(), &truth, true).expect("judged");
    let names: Vec<&str> = inside.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["v1", "v3"]);
    let table = table(&inside);
    assert!(table.contains("| v3 |") && table.contains("| mean |"), "{table}");
    assert_eq!(csv(&inside).lines().count(), 3);
}

#[test]
fn a_view_whose_lpips_is_not_a_number_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = truth(folder.path(), |_, camera| *camera);
    let mut judged = judge(&subject(), &truth, false).expect("judged");
    assert!(!table(&judged).contains("not a number"), "no network was given");
    judged.lpips_network = Some("a checksum".to_owned());
    let name = judged.views[1].name.clone();
    for (n, view) in judged.views.iter_mut().enumerate() {
        view.mapped.all.lpips_squeeze = Some(0.25);
        view.registered.all.lpips_squeeze = (n != 1).then_some(0.25);
    }
    let table = table(&judged);
    assert!(table.contains(&format!("LPIPS of {name} is not a number, so")), "{table}");
}

#[test]
fn a_wrong_camera_lowers_the_mapped_scores_only() {
    let folder = tempfile::tempdir().expect("a folder");
    // About two pixels to the right and one down.
    let off = |index: usize, camera: &Camera| {
        let [right, down, ..] = probes(camera, 3.0);
        let by =
            |i: usize| (if index % 2 == 1 { 1.0 } else { 0.0 }) * (8.0 * right[i] + 4.0 * down[i]);
        Motion::default().plus(&std::array::from_fn(by)).moved(camera)
    };
    let evaluation = judge(&subject(), &truth(folder.path(), off), false).expect("judged");
    let (mapped, registered) = (&evaluation.mapped.all, &evaluation.registered.all);
    assert!(registered.psnr_db > mapped.psnr_db + 10.0, "{evaluation:?}");
    assert!(evaluation.views.iter().all(|v| (1.5..3.5).contains(&v.moved_px)), "{evaluation:?}");
}

#[test]
fn a_soft_scene_lowers_every_score() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = truth(folder.path(), |_, camera| *camera);
    let mut soft = subject();
    for scales in &mut soft.gaussians.log_scales {
        *scales = scales.map(|scale| (scale.exp().powi(2) + 0.04_f32.powi(2)).sqrt().ln());
    }
    let evaluation = judge(&soft, &truth, false).expect("judged");
    let scores = &evaluation.registered.all;
    assert!(scores.psnr_cc_db < 45.0 && scores.ssim < 0.99, "{scores:?}");
    assert!(scores.psnr_fine_db < 45.0, "what is fine, too: {scores:?}");
}

#[test]
fn an_error_says_why_a_run_cannot_be_judged() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = truth(folder.path(), |_, camera| *camera);
    let all = Subject::new(subject().gaussians, cameras(), poses());
    let error = judge(&all, &truth, false).expect_err("nothing is left");
    assert!(matches!(error, EvaluationError::NoTestViews), "{error}");
    let two = cameras().into_iter().take(2).collect();
    let two = Subject::new(subject().gaussians, two, poses());
    let error = judge(&two, &truth, false).expect_err("two do not tie");
    assert!(matches!(error, EvaluationError::NotTied { tied: 2, views: 2 }), "{error}");
}

#[test]
fn the_lens_is_the_one_found_by_the_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = truth(folder.path(), |_, camera| *camera);
    let mut other = poses();
    for view in &mut other.views {
        view.lens.intrinsics.fx *= 1.1;
        view.lens.intrinsics.fy *= 1.1;
    }
    let judged = |poses| {
        let every_second = cameras().into_iter().step_by(2).collect();
        let subject = Subject::new(gaussians(), every_second, poses);
        judge(&subject, &truth, false)
    };
    let found = judged(other).expect("judged").mapped.all.psnr_db;
    assert!(found < 40.0, "another lens shows another picture: {found}");
    let error = judged(Poses::default()).expect_err("no lens");
    assert!(matches!(error, EvaluationError::NoLens { .. }), "{error}");
}

#[test]
fn elongated_gaussians_count_if_a_view_sees_their_length() {
    let mut subject = subject();
    let before = elongated::count(&subject);
    subject.gaussians.means[0] = [0.0; 3];
    subject.gaussians.opacity_logits[0] = 0.0;
    subject.gaussians.log_scales[0] = [0.2_f32.ln(), 0.01_f32.ln(), 0.01_f32.ln()];
    assert_eq!(elongated::count(&subject), before + 1);
    // At a tenth of the length, it measures 3 px.
    subject.gaussians.log_scales[0] = [0.02_f32.ln(), 0.001_f32.ln(), 0.001_f32.ln()];
    assert_eq!(elongated::count(&subject), before);
}
