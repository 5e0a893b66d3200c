//! Worlds of any size and place: UTM metres, millimetres.

use std::path::{Path, PathBuf};

use fled_core::camera::normalisation::Normalisation;
use fled_core::camera::{Camera, NamedCamera};
use fled_core::gaussians::ply;
use fled_core::image::Image;
use fled_core::poses::Poses;
use fled_core::poses::model::SparseModel;
use fled_core::synthetic::{SynthOptions, generate};
use glam::{DQuat, DVec3};
use serde_json::Value;

use crate::support::{fled, json, succeed};

/// `world = scale * room + offset`.
#[derive(Clone, Copy)]
struct World {
    scale: f64,
    offset: DVec3,
}

impl World {
    fn point(&self, point: DVec3) -> DVec3 {
        self.scale * point + self.offset
    }

    fn camera(&self, camera: &Camera) -> Camera {
        let rotation = DQuat::from_mat3(&camera.rotation());
        let centre = self.point(camera.centre());
        Camera::from_pose(camera.intrinsics, rotation, -(rotation * centre))
    }
}

/// Photographs of a room, once.
fn room(folder: &Path) -> Vec<(String, Camera)> {
    let options = SynthOptions {
        views: 8,
        width: 96,
        height: 64,
        seed: 3,
        exposure: 1.0,
        blur: 0.0,
        noise: 0.0,
        ..SynthOptions::default()
    };
    let made = generate(&options, folder).expect("a synthetic capture");
    std::fs::remove_file(folder.join("poses_bounds.npy")).expect("there");
    made.cameras
}

/// The photographs with a model in a world, run with this many steps a round.
fn run(
    folder: &Path,
    cameras: &[(String, Camera)],
    world: World,
    (rounds, steps): (u32, u32),
) -> (PathBuf, String) {
    let model = folder.join("capture/sparse/0");
    std::fs::create_dir_all(&model).expect("made");
    let views = cameras.iter().map(|(name, camera)| (format!("{name}.png"), world.camera(camera)));
    // A lattice through the room, with colours of its own.
    let points = (0..400).map(|i: u32| {
        let at = [i % 8, i / 8 % 7, i / 56].map(|n| f64::from(n) * 0.5 - 1.7);
        let colour = [40 + 20 * (i % 8) as u8, 90, 200 - 20 * (i / 56) as u8];
        (world.point(at.into()).to_array(), colour)
    });
    let model_of = SparseModel::of_views(views, points);
    model_of.write_text(&model).expect("written");
    let out = folder.join(format!("{} {} {rounds}", world.scale, world.offset));
    let mut command = fled();
    command.env("PATH", "/nowhere").arg("run");
    command.arg(folder.join("capture")).arg("--out").arg(&out);
    command.args(["--preset", "preview", "--cache", "none"]);
    let (rounds, steps) = (format!("rounds={rounds}"), format!("steps={steps}"));
    for set in [
        "size=96",
        &rounds,
        &steps,
        "cap=400",
        "deblur=identity",
        "shake=off",
        "pose_source=given",
        "late_views=false",
    ] {
        command.args(["--set", set]);
    }
    let said = succeed(&mut command).stderr;
    (out, String::from_utf8_lossy(&said).into_owned())
}

fn rendered(out: &Path, camera: &Camera) -> Image {
    let named = NamedCamera::new("pose", camera, fled_core::camera::Split::Train);
    let (pose, picture) = (out.join("pose.json"), out.join("novel.png"));
    std::fs::write(&pose, serde_json::to_vec(&named).expect("JSON")).expect("written");
    let mut command = fled();
    command.arg("render").arg(out).arg("--pose").arg(pose);
    succeed(command.arg("-o").arg(&picture));
    Image::load(&picture).expect("a picture")
}

/// The largest difference of two pictures, grey levels.
fn apart(a: &Image, b: &Image) -> f32 {
    let levels = a.data().iter().zip(b.data()).map(|(a, b)| 255.0 * (a - b).abs());
    levels.fold(0.0, f32::max)
}

/// Largest difference of two cameras that should agree, as a share of their largest coordinate.
fn astray(found: &Camera, given: &Camera) -> f64 {
    let largest = given.translation().abs().max_element();
    let off = found.world_to_camera - given.world_to_camera;
    let off = off.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    off / largest.max(1.0)
}

/// A camera that no photograph has.
fn novel(cameras: &[(String, Camera)]) -> Camera {
    let [(_, a), (_, b), ..] = cameras else {
        unreachable!("eight");
    };
    let middle = (a.centre() + b.centre()) / 2.0;
    Camera::look_at(a.intrinsics, middle, DVec3::new(0.1, 0.2, 0.0), DVec3::Y)
}

fn cameras_of(out: &Path, file: &str) -> Vec<NamedCamera> {
    serde_json::from_value(json(&out.join(file))).expect("cameras")
}

/// The differences of two runs' restored views, grey levels: largest, and root mean square.
fn restored_apart(a: &Path, b: &Path, cameras: &[(String, Camera)]) -> (f32, f32) {
    let (mut most, mut squares) = (0.0_f32, 0.0);
    for (name, _) in cameras {
        let picture = |out: &Path| Image::load(&out.join(format!("restored/{name}.png")));
        let (a, b) = (picture(a).expect("one"), picture(b).expect("the other"));
        most = most.max(apart(&a, &b));
        let square = a.data().iter().zip(b.data()).map(|(a, b)| (255.0 * (a - b)).powi(2));
        squares += square.sum::<f32>() / (a.data().len() * cameras.len()) as f32;
    }
    (most, squares.sqrt())
}

const HERE: World = World { scale: 1.0, offset: DVec3::ZERO };
const UTM: World = World { scale: 1.0, offset: DVec3::new(512_345.6, 5_412_345.9, 310.2) };

/// Limit after one step: Adam amplifies rounding errors, and rounding differs.
#[test]
fn no_scale_and_no_place_of_the_world_changes_a_render_and_all_comes_back_in_it() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let cameras = room(&folder.join("capture"));
    let (base, said) = run(folder, &cameras, HERE, (1, 1));
    assert!(!said.contains("georeferenced"), "{said}");
    let from_here = rendered(&base, &novel(&cameras));
    let trained = cameras_of(&base, "cameras.json");
    let worlds = [
        (UTM.scale, UTM.offset, true),
        (1e-4, DVec3::new(-3e6, 5e6, 2e5), true),
        (1e5, DVec3::new(4e6, -5e6, 1e6), false),
        (0.37, DVec3::new(70.0, -25.0, 11.0), false),
        (29.0, DVec3::new(-900.0, 4000.0, 0.0), false),
    ];
    for (scale, offset, left_out) in worlds {
        let world = World { scale, offset };
        let (out, said) = run(folder, &cameras, world, (1, 1));
        assert_eq!(said.contains("georeferenced"), left_out, "{said}");
        let metrics = json(&out.join("metrics.json"));
        assert_eq!(metrics["scene_offset"] != Value::Null, left_out, "{scale}");
        let (most, _) = restored_apart(&base, &out, &cameras);
        assert!(most < 1.01, "{scale} {offset}: {most} levels");
        let most = apart(&from_here, &rendered(&out, &world.camera(&novel(&cameras))));
        assert!(most < 1.01, "{scale} {offset}: a novel view differs by {most} levels");
        files_are_in_the_world(&out, &cameras, &trained, world);
    }
}

#[test]
fn a_scene_trains_as_well_in_utm_metres_as_about_the_origin() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let cameras = room(&folder.path().join("capture"));
    let trained = |world| run(folder.path(), &cameras, world, (2, 40)).0;
    let (_, rms) = restored_apart(&trained(HERE), &trained(UTM), &cameras);
    assert!(rms < 2.5, "{rms} levels");
}

/// Of poses, cameras, scene and points.
fn files_are_in_the_world(
    out: &Path,
    given: &[(String, Camera)],
    trained: &[NamedCamera],
    world: World,
) {
    let poses: Poses = serde_json::from_value(json(&out.join("poses.json"))).expect("poses");
    assert!(poses.normalisation.is_identity());
    for (view, (_, camera)) in poses.views.iter().zip(given) {
        let far = astray(&view.camera, &world.camera(camera));
        assert!(far < 1e-6, "poses.json: {far}");
    }
    for file in ["cameras.json", "rounds/1/cameras.json"] {
        let cameras = cameras_of(out, file);
        assert_eq!(cameras.len(), given.len());
    }
    for (found, there) in cameras_of(out, "cameras.json").iter().zip(trained) {
        let far = astray(&found.camera(), &world.camera(&there.camera()));
        assert!(far < 1e-6, "cameras.json: {far}");
    }
    let scene = ply::read(&out.join("scene.ply")).expect("a scene");
    let by: Normalisation = scene.normalisation;
    let header = std::fs::read(out.join("scene.ply")).expect("bytes");
    let header = String::from_utf8_lossy(&header[..400]).into_owned();
    assert_eq!(header.contains("comment fled: add "), by.left_out, "{header}");
    let places = scene.gaussians.means.iter();
    let places = places.map(|mean| by.point_in_world(DVec3::from(mean.map(f64::from))));
    let inside = places.filter(|place| place.distance(world.offset) < 5.0 * world.scale);
    assert!(2 * inside.count() > scene.gaussians.len(), "the scene lies elsewhere");
    the_export_is_in_the_world(out, world);
}

/// Of cameras and points.
fn the_export_is_in_the_world(out: &Path, world: World) {
    let mut export = fled();
    export.arg("export").arg(out).arg("colmap.zip").arg("-o").arg(out.join("colmap.zip"));
    succeed(&mut export);
    let unpacked = out.join("colmap");
    let mut python = std::process::Command::new("python3");
    python.args(["-m", "zipfile", "-e"]).arg(out.join("colmap.zip"));
    succeed(python.arg(&unpacked));
    let model = SparseModel::read(&unpacked.join("sparse/0")).expect("a model");
    let far = |point: &[f64; 3]| DVec3::from(*point).distance(world.offset) / world.scale;
    let inside = model.points.iter().filter(|point| far(&point.position) < 5.0);
    assert!(2 * inside.count() > model.points.len(), "the points lie elsewhere");
    for image in &model.images {
        let there = cameras_of(out, "cameras.json");
        let own = there.iter().find(|own| image.name == format!("{}.png", own.name));
        let camera = own.expect("its camera").camera();
        let centre = DVec3::from(image.translation);
        assert!(centre.distance(camera.translation()) < 1e-9 * centre.length());
    }
}
