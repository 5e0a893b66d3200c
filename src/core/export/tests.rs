mod cameras;
mod trims;

use std::borrow::Cow;
use std::fs;
use std::io::{Cursor, Read};

use glam::DVec3;
use tempfile::TempDir;
use zip::ZipArchive;
use zip::result::ZipResult;

use super::*;
use crate::camera::normalisation::Normalisation;
use crate::camera::{Camera, Intrinsics, Split};
use crate::gaussians::Gaussians;
use crate::image::{EncodeFormat, Image};
use crate::run_folder::RoundPictures;

/// A result of three views, of one round, with two solid Gaussians and a faint one.
fn result() -> (TempDir, RunFolder) {
    let folder = TempDir::new().expect("folder");
    let run = RunFolder::new(folder.path());
    let k = Intrinsics { width: 8, height: 6, fx: 9.5, fy: 9.25, cx: 4.0, cy: 3.125 };
    let camera = |index: usize, name: &str| {
        let eye = DVec3::new(index as f64, 0.5, -3.0);
        let mut camera = Camera::look_at(k, eye, DVec3::ZERO, DVec3::Y);
        camera.intrinsics.fx += (index / 2) as f64;
        NamedCamera::new(name, &camera, Split::Train)
    };
    let names = ["a", "b b", "c", "unseen"];
    let cameras: Vec<NamedCamera> = (0..).zip(names).map(|(i, name)| camera(i, name)).collect();
    let scene = Gaussians {
        means: vec![[0.0; 3], [1.0, 2.0, 3.0], [9.0; 3]],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 3],
        log_scales: vec![[-2.0; 3]; 3],
        opacity_logits: vec![2.0, 1.0, -3.0],
        sh: vec![0.5 / Y00, 0.0, -9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        sh_degree: 0,
    };
    for name in &names[..3] {
        let picture: Image = Image::new(8, 6).map(|_| 0.5);
        let render = run.round(1).picture(RoundPictures::Renders, name);
        let formats = [EncodeFormat::Png16, EncodeFormat::of(&render)];
        for (path, format) in [run.restored_view(name), render].into_iter().zip(formats) {
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            picture.save_as(&path, format).expect("saved");
        }
    }
    fs::write(run.restored().join(".half.png"), "unfinished").expect("written");
    for path in [run.cameras(), run.round(1).cameras()] {
        fs::write(path, serde_json::to_vec(&cameras).expect("JSON")).expect("written");
    }
    for path in [run.scene(), run.round(1).scene()] {
        ply::write(&scene, &Normalisation::default(), &path).expect("written");
    }
    (folder, run)
}

fn written(export: Export, run: &RunFolder, round: Option<u32>) -> Vec<u8> {
    trimmed(export, run, round, Trim::default())
}

fn trimmed(export: Export, run: &RunFolder, round: Option<u32>, trim: Trim) -> Vec<u8> {
    let prepared = export.prepare(run, round, trim).expect("it is there");
    let mut bytes = Vec::new();
    prepared.write(&mut bytes).expect("written");
    bytes
}

fn named(name: ZipResult<Cow<'_, str>>) -> String {
    name.expect("a name").into_owned()
}

fn names(bytes: &[u8]) -> Vec<String> {
    let archive = ZipArchive::new(Cursor::new(bytes)).expect("a zip");
    let mut names: Vec<String> = archive.file_names().map(named).collect();
    names.sort();
    names
}

#[test]
fn the_zip_has_the_restored_views_unchanged() {
    let (_folder, run) = result();
    let bytes = written(Export::Restored, &run, None);
    assert_eq!(names(&bytes), ["a.png", "b b.png", "c.png"]);
    let mut archive = ZipArchive::new(Cursor::new(&bytes)).expect("a zip");
    let mut content = Vec::new();
    let mut file = archive.by_name("b b.png").expect("there");
    file.read_to_end(&mut content).expect("read");
    let on_disk = fs::read(run.restored_view("b b")).expect("read");
    assert!(content == on_disk);
    let of_round = written(Export::Restored, &run, Some(1));
    assert_eq!(names(&of_round), ["a.jpg", "b b.jpg", "c.jpg"]);
}

#[test]
fn the_linear_zip_has_the_light_of_the_restored_views() {
    let (folder, run) = result();
    let dark = Image::new(8, 6).map(|_: f32| 0.037);
    dark.save_as(&run.restored_view("c"), EncodeFormat::Png16).expect("saved");
    let prepared = Export::Linear.prepare(&run, None, Trim::default()).expect("it is there");
    assert_eq!(prepared.bytes(), 3 * 6 * 8 * 6);
    let bytes = written(Export::Linear, &run, None);
    assert_eq!(names(&bytes), ["a.tif", "b b.tif", "c.tif"]);
    let mut archive = ZipArchive::new(Cursor::new(&bytes)).expect("a zip");
    archive.extract(folder.path().join("out")).expect("extracted");
    let graded = Image::load_light(&folder.path().join("out/c.tif"), usize::MAX).expect("read");
    let (light, wanted) = (graded.get(3, 2)[1], dark.to_linear().get(3, 2)[1]);
    // A step of 8 bits at this level is 3e-4.
    assert!((light - wanted).abs() < 2e-5, "{light} {wanted}");
    dark.save(&run.restored_view("b b")).expect("saved");
    let error = Export::Linear.prepare(&run, None, Trim::default()).expect_err("8 bits");
    assert!(error.to_string().contains("those of this result have 8"), "{error}");
    let error = Export::Linear.prepare(&run, Some(1), Trim::default()).expect_err("8 bits");
    assert!(error.is_of_wish() && error.to_string().contains("--round N --linear"), "{error}");
}

#[test]
fn a_zip_of_restored_views_names_and_compresses_each() {
    let (_folder, run) = result();
    let bytes = written(Export::Restored, &run, None);
    let mut archive = ZipArchive::new(Cursor::new(&bytes)).expect("a zip");
    let mut found = Vec::new();
    for index in 0..archive.len() {
        let mut file = archive.by_index(index).expect("an entry");
        assert_eq!(file.compression(), zip::CompressionMethod::Deflated);
        io::copy(&mut file, &mut io::sink()).expect("read");
        found.push(named(file.name()));
    }
    assert_eq!(found, ["a.png", "b b.png", "c.png"]);
}

#[test]
fn the_colmap_model_has_the_cameras_of_the_pictures_beside_it() {
    let (_folder, run) = result();
    let bytes = written(Export::Colmap, &run, None);
    let out = TempDir::new().expect("folder");
    let mut archive = ZipArchive::new(Cursor::new(&bytes)).expect("a zip");
    archive.extract(out.path()).expect("extracted");
    let model = SparseModel::read(&out.path().join("sparse/0")).expect("a model");
    assert_eq!(model.cameras.len(), 2, "views of one lens share a camera");
    let cameras = super::cameras::cameras(&run, None).expect("cameras");
    assert_eq!(model.images.len(), 3, "a view without a picture is left out");
    for (image, own) in model.images.iter().zip(&cameras) {
        assert_eq!(image.name, format!("{}.png", own.name));
        assert!(out.path().join("images").join(&image.name).is_file());
        let (theirs, ours) = (image.world_to_camera(), own.camera().world_to_camera);
        assert!(theirs.abs_diff_eq(ours, 1e-12), "{theirs} {ours}");
        assert_eq!(model.camera_of(image).lens().intrinsics, own.intrinsics);
    }
    let points: Vec<_> = model.points.iter().map(|p| (p.position, p.colour)).collect();
    let expected = [([0.0; 3], [255, 128, 0]), ([1.0, 2.0, 3.0], [128, 128, 128])];
    assert_eq!(points, expected, "a faint Gaussian is no point");
}

#[test]
fn the_compressed_scene_has_the_announced_size() {
    let (_folder, run) = result();
    let prepared = Export::CompressedScene.prepare(&run, Some(1), Trim::default()).expect("there");
    let bytes = written(Export::CompressedScene, &run, Some(1));
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end);
    let body = bytes.len() - at.expect("a header") - end.len();
    assert_eq!(body as u64, prepared.bytes());
}

#[test]
fn missing_inputs_are_reported_before_anything_is_written() {
    let (_folder, run) = result();
    let of_a_round = |export: &Export| *export != Export::Linear;
    for export in Export::ALL.into_iter().filter(of_a_round) {
        let error = export.prepare(&run, Some(2), Trim::default()).expect_err("no such round");
        assert!(error.is_missing(), "{error}");
        assert_eq!(export.name().parse(), Ok(export));
    }
    fs::write(run.cameras(), "[{").expect("written");
    let error = Export::Colmap.prepare(&run, None, Trim::default()).expect_err("damaged");
    assert!(!error.is_missing() && error.to_string().contains("cameras.json"));
    let unknown = "scene.obj".parse::<Export>().expect_err("unknown");
    assert!(unknown.contains("scene.compressed.ply"), "{unknown}");
}
