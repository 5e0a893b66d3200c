use std::path::Path;
use std::process::Command;

use glam::{DQuat, DVec3};
use tempfile::TempDir;

use super::*;
use crate::camera::orbit::Orbit;
use crate::camera::{Camera, Intrinsics, NamedCamera, Split, upright};
use crate::image::{Image, Srgb};

const K: Intrinsics = Intrinsics { width: 96, height: 64, fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };

/// Photographs on part of a ring around the origin, at uneven angles.
fn ring(degrees: f64) -> Vec<NamedCamera> {
    let at = |i: usize| {
        let share = (i as f64 + if i % 2 == 1 { 0.4 } else { 0.0 }) / 10.0 - 0.5;
        let angle = (degrees * share).to_radians();
        let eye = DVec3::new(3.0 * angle.sin(), -0.8, -3.0 * angle.cos());
        let camera = Camera::look_at(K, eye, DVec3::ZERO, DVec3::Y);
        NamedCamera::new(format!("{i}"), &camera, Split::Train)
    };
    (0..=10).map(at).collect()
}

fn step(a: &Camera, b: &Camera) -> f64 {
    let turn = |camera: &Camera| DQuat::from_mat3(&camera.rotation());
    a.centre().distance(b.centre()) + turn(a).angle_between(turn(b))
}

/// The smallest and the largest step between consecutive pictures.
fn steps(cameras: &[Camera]) -> (f64, f64) {
    let steps = cameras.windows(2).map(|pair| step(&pair[0], &pair[1]));
    let (mut least, mut most) = (f64::INFINITY, 0.0);
    for step in steps {
        (least, most) = (f64::min(least, step), f64::max(most, step));
    }
    (least, most)
}

#[test]
fn an_orbit_is_upright_looks_at_the_centre_and_ends_where_it_begins() {
    let views = ring(80.0);
    let orbit = Orbit::from_cameras(&views).expect("an orbit");
    let photographers: Vec<_> = views.iter().map(NamedCamera::camera).collect();
    let up = upright::up(&photographers).expect("an upward direction");
    for degrees in [None, Some(360.0)] {
        let plan = Plan { degrees, elevation: Some(10.0), ..Plan::new(Kind::Orbit) };
        let cameras = plan.cameras(&views).expect("cameras");
        assert_eq!(cameras.len(), 8 * 24);
        for camera in &cameras {
            let right = camera.right();
            assert!(right.dot(up).abs() < 1e-9, "it is tilted: {right}");
            let (pixel, _) = camera.project(orbit.centre).expect("in front");
            assert!((pixel.x - 48.0).abs() < 1e-6 && (pixel.y - 32.0).abs() < 1e-6);
        }
        let (_, most) = steps(&cameras);
        let closing = step(&cameras[0], &cameras[cameras.len() - 1]);
        assert!(closing <= most * 1.01, "it jumps where it is played again");
        let azimuths = cameras.iter().map(|camera| orbit.azimuth_of(camera));
        let farthest = azimuths.map(f64::abs).fold(0.0, f64::max);
        let expected = if degrees.is_some() { 178.0..180.1 } else { 37.0..45.0 };
        assert!(expected.contains(&farthest), "{farthest} degrees around");
    }
}

#[test]
fn a_full_circle_of_photographs_gives_a_full_orbit() {
    let plan = Plan::new(Kind::Orbit);
    let cameras = plan.cameras(&ring(330.0)).expect("cameras");
    let (least, most) = steps(&cameras);
    assert!(most < 1.01 * least, "steps from {least} to {most}");
}

#[test]
fn the_path_through_the_photographs_passes_them_in_order_at_constant_speed() {
    let views = ring(120.0);
    let plan = Plan { seconds: Some(20.0), ..Plan::new(Kind::Cameras) };
    let cameras = plan.cameras(&views).expect("cameras");
    let (least, most) = steps(&cameras);
    assert!(most < 1.02 * least, "steps from {least} to {most}");
    let mut from = 0;
    for view in &views {
        let view = view.camera();
        let distance = |camera: &Camera| step(camera, &view);
        let rest = cameras[from..].iter().map(distance).enumerate();
        let (at, nearest) = rest.min_by(|a, b| a.1.total_cmp(&b.1)).expect("some");
        assert!(nearest < most, "a photograph is passed at {nearest}");
        from += at;
    }
    assert!(step(&cameras[0], &views[0].camera()) < 1e-9);
    assert!(step(&cameras[cameras.len() - 1], &views[10].camera()) < 1e-9);
}

#[test]
fn a_path_may_be_in_utm_metres_but_not_near_infinity() {
    let far = |x: f64| Key {
        world_to_camera: [
            [1.0, 0.0, 0.0, -x],
            [0.0, 1.0, 0.0, -5_412_345.9],
            [0.0, 0.0, 1.0, 4.0],
            [0.0, 0.0, 0.0, 1.0],
        ],
        seconds: 1.0,
    };
    let plan = |x: f64| Plan { poses: Some(vec![far(x), far(x + 1.0)]), ..Plan::new(Kind::Path) };
    assert_eq!(plan(512_345.6).check(), Ok(()));
    assert_eq!(plan(1e300).check().expect_err("no place").field, "poses");
}

#[test]
fn a_path_reaches_its_poses_at_their_times() {
    let views = ring(90.0);
    let key = |view: &NamedCamera, seconds| Key { world_to_camera: view.world_to_camera, seconds };
    let poses = vec![key(&views[0], 0.0), key(&views[5], 1.0), key(&views[10], 3.0)];
    let plan = Plan { fps: Some(25), poses: Some(poses), ..Plan::new(Kind::Path) };
    let cameras = plan.cameras(&views).expect("cameras");
    assert_eq!(cameras.len(), 100);
    // The last picture is at the last second: 99 steps of 4/99 s.
    assert!(step(&cameras[0], &views[0].camera()) < 1e-9);
    assert!(step(&cameras[99], &views[10].camera()) < 1e-9);
    let (_, most) = steps(&cameras);
    assert!(step(&cameras[25], &views[5].camera()) < most);
}

#[test]
fn sides_are_even_and_follow_the_views() {
    let views = ring(60.0);
    let size = |width, height| {
        let plan = Plan { width, height, ..Plan::new(Kind::Cameras) };
        let cameras = plan.cameras(&views)?;
        let k = cameras[0].intrinsics;
        Ok::<_, PlanError>((k.width, k.height, k.fx.round() as usize))
    };
    assert_eq!(size(None, None), Ok((96, 64, 80)));
    assert_eq!(size(Some(961), None), Ok((960, 640, 800)));
    assert_eq!(size(None, Some(128)), Ok((192, 128, 160)));
    assert_eq!(size(Some(192), Some(192)), Ok((192, 192, 160)));
    let error = size(None, Some(1900)).expect_err("too wide");
    assert_eq!(error.field, "width");
}

#[test]
fn fields_out_of_bounds_or_of_another_kind_are_named() {
    let of = |kind: Kind, change: fn(&mut Plan)| {
        let mut plan = Plan::new(kind);
        change(&mut plan);
        plan.check().expect_err("refused").field
    };
    assert_eq!(of(Kind::Orbit, |plan| plan.seconds = Some(0.5)), "seconds");
    assert_eq!(of(Kind::Orbit, |plan| plan.seconds = Some(61.0)), "seconds");
    let nan = |plan: &mut Plan| plan.elevation = Some(f64::NAN);
    assert_eq!(of(Kind::Orbit, nan), "elevation");
    assert_eq!(of(Kind::Cameras, |plan| plan.fps = Some(31)), "fps");
    assert_eq!(of(Kind::Cameras, |plan| plan.width = Some(2000)), "width");
    assert_eq!(of(Kind::Cameras, |plan| plan.degrees = Some(90.0)), "degrees");
    assert_eq!(of(Kind::Path, |plan| plan.seconds = Some(4.0)), "seconds");
    assert_eq!(of(Kind::Path, |_| {}), "poses");
    let skewed = |plan: &mut Plan| {
        let mut poses =
            vec![Key { world_to_camera: ring(60.0)[0].world_to_camera, seconds: 2.0 }; 2];
        poses[1].world_to_camera[0][0] += 0.1;
        plan.poses = Some(poses);
    };
    assert_eq!(of(Kind::Path, skewed), "poses");
    let error = Plan::new(Kind::Cameras).cameras(&[]).expect_err("no views");
    assert_eq!(error.field, "kind");
    let one = vec![ring(60.0)[0].clone(); 3];
    let error = Plan::new(Kind::Cameras).cameras(&one).expect_err("one place");
    assert!(error.message.contains("one place"), "{error}");
}

/// A grey that brightens, with a red and a blue half.
fn picture(number: usize, camera: &Camera) -> Image {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut picture = Image::new(width, height);
    let grey = 0.2 + 0.02 * number as f32;
    for y in 0..height {
        for x in 0..width {
            let (red, blue) = if x < width / 2 { (0.8, grey) } else { (grey, 0.7) };
            picture.set(x, y, [red, grey, blue]);
        }
    }
    picture
}

fn made(file: &Path, program: &str) -> Result<(), EncodeError> {
    let plan = Plan { seconds: Some(1.0), ..Plan::new(Kind::Orbit) };
    let cameras = plan.cameras(&ring(60.0)).expect("cameras");
    let target = Target { command: &[program.into()], file, fps: plan.fps() };
    write(&target, &cameras, |number, camera| Ok(picture(number, camera)))
}

fn output_of(program: &str, arguments: &[&str], file: &Path) -> Vec<u8> {
    let output = Command::new(program)
        .args(arguments)
        .arg(file)
        .output()
        .expect("ffmpeg, which `make setup` installs");
    assert!(output.status.success());
    output.stdout
}

#[test]
fn a_video_is_widely_supported_h264_that_starts_at_once() {
    let folder = TempDir::new().expect("folder");
    let file = folder.path().join("-a b.mp4");
    made(&file, "ffmpeg").expect("a video");
    let entries = "stream=codec_name,pix_fmt,width,height,nb_read_frames,r_frame_rate";
    let probed = output_of(
        "ffprobe",
        &["-v", "error", "-count_frames", "-show_entries", entries, "-of", "csv=p=0"],
        &file,
    );
    let probed = String::from_utf8(probed).expect("text");
    assert_eq!(probed.trim(), "h264,96,64,yuv420p,24/1,24");
    let bytes = std::fs::read(&file).expect("read");
    let at = |name: &[u8]| bytes.windows(4).position(|w| w == name).expect("a box");
    assert!(at(b"moov") < at(b"mdat"), "what players need first comes first");
    let left = std::fs::read_dir(folder.path()).expect("read").count();
    assert_eq!(left, 1, "nothing else is left");
}

#[test]
fn a_video_has_the_colours_of_its_pictures() {
    let folder = TempDir::new().expect("folder");
    let file = folder.path().join("a.mp4");
    made(&file, "ffmpeg").expect("a video");
    let out = folder.path().join("last.png");
    let filter = "select=eq(n\\,20),scale=in_color_matrix=bt709:in_range=tv";
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-i"])
        .arg(&file)
        .args(["-vf", filter, "-frames:v", "1"])
        .arg(&out)
        .status()
        .expect("ffmpeg, which `make setup` installs");
    assert!(status.success());
    let shown = Image::<Srgb>::load(&out).expect("a picture");
    for (x, expected) in [(20, [0.8, 0.6, 0.6]), (76, [0.6, 0.6, 0.7])] {
        for (channel, expected) in expected.into_iter().enumerate() {
            let value = shown.get(x, 30)[channel];
            assert!((value - expected).abs() < 0.02, "{x}: {value}, not {expected}");
        }
    }
}

#[test]
fn a_failure_gives_its_reason_and_leaves_no_file() {
    let folder = TempDir::new().expect("folder");
    let file = folder.path().join("a.mp4");
    let missing = made(&file, "no-such-ffmpeg").expect_err("no program");
    assert!(matches!(missing, EncodeError::Missing { .. }), "{missing}");
    assert!(missing.hint().contains("apt-get install ffmpeg"));
    let launcher = folder.path().join("launcher");
    std::fs::write(&launcher, "#!/bin/sh\necho nothing there >&2; exit 127").expect("written");
    let executable = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    std::fs::set_permissions(&launcher, executable).expect("allowed");
    let missing = made(&file, launcher.to_str().expect("UTF-8")).expect_err("no program");
    assert!(missing.to_string().ends_with("nothing there"), "{missing}");
    assert!(matches!(missing, EncodeError::Missing { .. }), "{missing}");
    std::fs::remove_file(launcher).expect("removed");
    let nowhere = folder.path().join("none/a.mp4");
    let refused = made(&nowhere, "ffmpeg").expect_err("no folder");
    let words = refused.to_string();
    assert!(matches!(refused, EncodeError::Refused { .. }), "{words}");
    assert!(words.contains("No such file"), "{words}");
    let cameras = Plan::new(Kind::Orbit).cameras(&ring(60.0)).expect("cameras");
    let target = Target { command: &["ffmpeg".into()], file: &file, fps: 24 };
    let stopped = write(&target, &cameras, |number, camera| match number {
        3 => Err(EncodeError::Refused { reason: "enough".to_owned() }),
        _ => Ok(picture(number, camera)),
    });
    let words = stopped.expect_err("stopped").to_string();
    assert!(words.ends_with("enough"), "{words}");
    let left = std::fs::read_dir(folder.path()).expect("read").count();
    assert_eq!(left, 0, "nothing is left");
}
