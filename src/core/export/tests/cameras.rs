use glam::DMat3;
use serde_json::json;

use super::super::cameras;
use super::*;
use crate::capture::{CaptureView, PreparedImage};
use crate::dataset::{GivenPoses, PlacedPoses};
use crate::photo_path::PhotoPath;

const OFFSET: DVec3 = DVec3::new(512_352.0, -5_412_352.0, 64.0);

/// The poses that the importer finds in an exported `transforms.json` for the pictures beside it.
fn imported(run: &RunFolder, round: Option<u32>) -> PlacedPoses {
    let file = run.root().join("transforms.json");
    fs::write(&file, written(Export::Transforms, run, round)).expect("written");
    let pictures = pictures(run, round).expect("pictures");
    let view = |picture: Picture| {
        let below = picture.path.strip_prefix(run.root()).expect("below").to_string_lossy();
        let name = picture.path.file_stem().expect("a stem").to_string_lossy().into_owned();
        let image: Image = Image::new(8, 6);
        let prepared = run.root().join(format!("{name}.half"));
        let prepared = PreparedImage::write(&image.to_linear(), &prepared).expect("written");
        let view = CaptureView::upright(name, PhotoPath::new(&below), prepared);
        CaptureView { file: picture.path.clone(), ..view }
    };
    let views: Vec<CaptureView> = pictures.into_iter().map(view).collect();
    let paths: Vec<PhotoPath> = views.iter().map(|view| view.path.clone()).collect();
    let given = GivenPoses::open(&file, &paths).expect("it is read");
    given.place(&views).expect("poses")
}

fn assert_imported(run: &RunFolder, round: Option<u32>, offset: DVec3) {
    let poses = imported(run, round);
    let cameras = cameras::cameras(run, round).expect("cameras");
    assert_eq!(poses.views.len(), 3, "a view without a picture is left out");
    for (view, own) in poses.views.iter().zip(&cameras) {
        assert_eq!(view.name, own.name);
        assert_eq!(view.camera.intrinsics, own.intrinsics);
        let theirs = view.camera.centre() + offset;
        let apart = (view.camera.rotation() - own.camera().rotation()).to_cols_array();
        assert!(apart.iter().all(|v| v.abs() < 1e-12), "{apart:?}");
        let ours = own.camera().centre();
        assert!(theirs.distance(ours) < 1e-12 * ours.length(), "moved from {ours} to {theirs}");
    }
}

#[test]
fn the_importer_reads_the_exported_transforms_to_the_same_poses() {
    let (_folder, run) = result();
    for round in [None, Some(1)] {
        assert_imported(&run, round, DVec3::ZERO);
    }
    assert!(imported(&run, None).held_out.is_empty());
}

#[test]
#[should_panic(expected = "moved")]
fn a_moved_pose_is_not_the_same() {
    let (_folder, run) = result();
    assert_imported(&run, None, DVec3::X * 1e-6);
}

#[test]
fn transforms_keep_held_out_views_and_share_a_lens_only_if_it_is_one() {
    let (_folder, run) = result();
    let all = |run: &RunFolder| -> Value {
        serde_json::from_slice(&written(Export::Transforms, run, Some(1))).expect("JSON")
    };
    let document = all(&run);
    assert_eq!((&document["fl_x"], &document["frames"][2]["fl_x"]), (&Value::Null, &json!(10.5)));
    assert_eq!(document["frames"][1]["file_path"], "rounds/1/renders/b b.jpg");
    assert_eq!(document["ply_file_path"], "rounds/1/scene.ply");
    assert_eq!(
        (&document["train_filenames"], &document["scene_offset"]),
        (&Value::Null, &Value::Null)
    );
    let mut cameras = cameras::cameras(&run, None).expect("cameras");
    for camera in &mut cameras {
        camera.intrinsics.fx = 9.5;
    }
    cameras[1].split = Split::HeldOut;
    for path in [run.cameras(), run.round(1).cameras()] {
        fs::write(path, serde_json::to_vec(&cameras).expect("JSON")).expect("written");
    }
    let document = all(&run);
    assert_eq!((&document["fl_x"], &document["frames"][2]["fl_x"]), (&json!(9.5), &Value::Null));
    assert_eq!(document["test_filenames"], json!(["rounds/1/renders/b b.jpg"]));
    assert_eq!(document["val_filenames"], document["test_filenames"]);
    assert_eq!(document["train_filenames"].as_array().map(Vec::len), Some(2));
    assert_eq!(imported(&run, None).held_out, ["b b"]);
}

/// Moves the result's cameras to UTM metres, and notes the offset in its scenes.
fn far_away(run: &RunFolder) {
    for (path, scene) in
        [(run.cameras(), run.scene()), (run.round(1).cameras(), run.round(1).scene())]
    {
        let mut cameras = cameras::cameras(run, None).expect("cameras");
        for named in &mut cameras {
            let camera = named.camera();
            let centre = camera.centre() + OFFSET;
            let moved =
                glam::DMat4::from_mat3(camera.rotation()) * glam::DMat4::from_translation(-centre);
            let moved = Camera { world_to_camera: moved, ..camera };
            *named = NamedCamera::new(&*named.name, &moved, named.split);
        }
        let by = Normalisation { offset: OFFSET, scale: 1.0, left_out: true };
        let gaussians = ply::read(&scene).expect("read").gaussians;
        ply::write(&gaussians, &by, &scene).expect("written");
        if path == run.cameras() {
            continue;
        }
        fs::write(path, serde_json::to_vec(&cameras).expect("JSON")).expect("written");
        fs::write(run.cameras(), serde_json::to_vec(&cameras).expect("JSON")).expect("written");
    }
}

#[test]
fn cameras_far_from_the_origin_are_where_the_scene_is() {
    let (_folder, run) = result();
    far_away(&run);
    let document: Value =
        serde_json::from_slice(&written(Export::Transforms, &run, None)).expect("JSON");
    assert_eq!(document["scene_offset"], json!(OFFSET.to_array()));
    let first = &document["frames"][0]["transform_matrix"][2][3];
    assert!((first.as_f64().expect("a number") + 3.0).abs() < 1e-6, "{first}");
    let inria: Value =
        serde_json::from_slice(&written(Export::InriaCameras, &run, None)).expect("JSON");
    let z = &inria[0]["position"][2];
    assert!((z.as_f64().expect("a number") + 3.0).abs() < 1e-6, "{z}");
}

#[test]
fn cameras_for_inrias_viewers_project_as_their_formula_does() {
    let (_folder, run) = result();
    let document: Value =
        serde_json::from_slice(&written(Export::InriaCameras, &run, None)).expect("JSON");
    let cameras = cameras::cameras(&run, None).expect("cameras");
    let list = document.as_array().expect("a list");
    assert_eq!(list.len(), cameras.len(), "viewers need no picture");
    for (id, (theirs, ours)) in list.iter().zip(&cameras).enumerate() {
        assert_eq!((&theirs["id"], &theirs["img_name"]), (&json!(id), &json!(ours.name)));
        let numbers = |value: &Value| -> Vec<f64> {
            value.as_array().expect("a list").iter().map(|v| v.as_f64().expect("one")).collect()
        };
        let rows: Vec<_> =
            theirs["rotation"].as_array().expect("rows").iter().map(numbers).collect();
        let row = |n: usize| DVec3::from_slice(&rows[n]);
        // Rows of a matrix are the columns of its transpose: world to camera.
        let world_to_camera = DMat3::from_cols(row(0), row(1), row(2));
        let centre = DVec3::from_slice(&numbers(&theirs["position"]));
        let point = DVec3::new(0.3, -0.2, 0.4);
        let seen = world_to_camera * (point - centre);
        let fx = theirs["fx"].as_f64().expect("a number");
        let (pixel, depth) = ours.camera().project(point).expect("in front");
        assert!((seen.z - depth).abs() < 1e-12);
        assert!((fx * seen.x / seen.z + ours.intrinsics.cx - pixel.x).abs() < 1e-9);
        assert_eq!((&theirs["width"], &theirs["height"]), (&json!(8), &json!(6)));
    }
}
