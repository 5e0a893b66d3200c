//! Poses computed on stored pixels, for photographs that EXIF rotates upright.

use exif::{Tag, Value};
use glam::{DMat4, DVec2, DVec3};
use image::{ExtendedColorType, ImageEncoder};
use proptest::prelude::*;

use super::super::*;
use super::{flipped, poses_and_warnings};
use crate::camera::{Camera, Intrinsics};
use crate::capture::{PREPARED_SIDE, PreparedImage};
use crate::image::{Image, exif_block};
use crate::poses::bounds::{BoundedCamera, write_poses_bounds};
use crate::poses::model::{ModelCamera, ModelImage, ModelPoint};
use crate::poses::{Distortion, Lens};

/// The position in the upright picture of a pixel of a stored picture of `size`, from EXIF's table
/// of the meaning of the first row and column.
fn upright_pixel(orientation: u16, pixel: DVec2, size: DVec2) -> DVec2 {
    let (x, y) = (pixel.x, pixel.y);
    let (from_right, from_below) = (size.x - x, size.y - y);
    match orientation {
        1 => DVec2::new(x, y),
        2 => DVec2::new(from_right, y),
        3 => DVec2::new(from_right, from_below),
        4 => DVec2::new(x, from_below),
        5 => DVec2::new(y, x),
        6 => DVec2::new(from_below, x),
        7 => DVec2::new(from_below, from_right),
        8 => DVec2::new(y, from_right),
        _ => unreachable!("EXIF has eight"),
    }
}

/// A grey PNG with an orientation.
fn write_png(file: &Path, orientation: u16, (width, height): (usize, usize), samples: &[u8]) {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    let exif = exif_block(&[(Tag::Orientation, Value::Short(vec![orientation]))]);
    encoder.set_exif_metadata(exif).unwrap();
    let (width, height) = (width as u32, height as u32);
    encoder.write_image(samples, width, height, ExtendedColorType::L8).unwrap();
    std::fs::write(file, bytes).unwrap();
}

/// Photographs as stored by a camera, with the poses computed on them.
struct Stored {
    dir: tempfile::TempDir,
    views: Vec<CaptureView>,
    /// The lens of the stored pictures, at the size for which the poses were computed.
    lens: Lens,
    /// From the world to the stored pictures.
    poses: Vec<DMat4>,
    /// The visible points.
    points: Vec<DVec3>,
}

impl Stored {
    /// Four photographs of `size`; `orientations` are used cyclically.
    fn new(lens: Lens, size: (usize, usize), orientations: &[u16]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let view = |index: usize| {
            let name = format!("photo{index}");
            let file = dir.path().join(format!("{name}.png"));
            let orientation = orientations[index % orientations.len()];
            write_png(&file, orientation, size, &vec![90; size.0 * size.1]);
            let image = Image::load_light(&file, PREPARED_SIDE).unwrap();
            let prepared = PreparedImage::write(&image, &file.with_extension("half")).unwrap();
            let path = PhotoPath::new(&format!("{name}.png"));
            CaptureView { file, ..CaptureView::upright(name, path, prepared) }
        };
        let pose = |index: usize| {
            let eye = DVec3::new(index as f64 - 1.5, 0.3 * index as f64, -4.0);
            let down = DVec3::new(0.2 * index as f64, 1.0, 0.1);
            let target = DVec3::new(0.1, -0.2, 0.5);
            Camera::look_at(lens.intrinsics, eye, target, down).world_to_camera
        };
        let point = |i: usize| {
            let share = |k: usize| (i * k % 7) as f64 / 6.0 - 0.5;
            DVec3::new(share(1), share(2), 0.5 + share(3))
        };
        Self {
            views: (0..4).map(view).collect(),
            dir,
            lens,
            poses: (0..4).map(pose).collect(),
            points: (0..7).map(point).collect(),
        }
    }

    fn write(&self, format: Format) -> PathBuf {
        match format {
            Format::Model => self.write_model(),
            Format::Transforms => self.write_transforms(),
            Format::PosesBounds => {
                let file = self.dir.path().join("poses_bounds.npy");
                let row = |pose: &DMat4| BoundedCamera {
                    camera: Camera { intrinsics: self.lens.intrinsics, world_to_camera: *pose },
                    near: 2.0,
                    far: 8.0,
                };
                let rows: Vec<_> = self.poses.iter().map(row).collect();
                write_poses_bounds(&file, &rows).unwrap();
                file
            }
        }
    }

    fn write_model(&self) -> PathBuf {
        let camera =
            |pose: &DMat4| Camera { intrinsics: self.lens.intrinsics, world_to_camera: *pose };
        let image = |(id, pose): (u32, &DMat4)| {
            ModelImage::posed(id, 1, format!("photo{id}.png"), &camera(pose))
        };
        let point = |(id, position): (u64, &DVec3)| ModelPoint {
            id,
            position: position.to_array(),
            colour: [9; 3],
            error: 0.1,
            track: vec![(0, 0)],
        };
        let folder = self.dir.path().join("sparse");
        let model = SparseModel {
            cameras: vec![ModelCamera::of_lens(1, &self.lens)],
            images: (0..).zip(&self.poses).map(image).collect(),
            points: (1..).zip(&self.points).map(point).collect(),
        };
        model.write_binary(&folder).unwrap();
        folder
    }

    fn write_transforms(&self) -> PathBuf {
        let frame = |(id, pose): (usize, &DMat4)| {
            serde_json::json!({
                "file_path": format!("photo{id}.png"),
                "transform_matrix": flipped(pose),
            })
        };
        let k = &self.lens.intrinsics;
        let mut json = serde_json::json!({
            "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy,
            "frames": (0..).zip(&self.poses).map(frame).collect::<Vec<_>>(),
        });
        if let Distortion::Perspective { radial, tangential } = self.lens.distortion {
            (json["k1"], json["k2"]) = (radial[0].into(), radial[1].into());
            (json["p1"], json["p2"]) = (tangential[0].into(), tangential[1].into());
        }
        let file = self.dir.path().join("transforms.json");
        std::fs::write(&file, json.to_string()).unwrap();
        file
    }

    fn read(&self, format: Format) -> (Result<PlacedPoses, PoseFileError>, Vec<String>) {
        poses_and_warnings(&self.write(format), &self.views)
    }

    /// Largest distance, px, of the projected points from their positions in the upright
    /// photographs, which have `size` before the rotation.
    fn error(
        &self,
        poses: &PlacedPoses,
        format: Format,
        size: (usize, usize),
        orientation: u16,
    ) -> f64 {
        let size = DVec2::new(size.0 as f64, size.1 as f64);
        let k = &self.lens.intrinsics;
        let scale = size / DVec2::new(k.width as f64, k.height as f64);
        let is_mirrored = [2, 4, 5, 7].contains(&orientation);
        let mut worst = 0.0f64;
        for (view, pose) in poses.views.iter().zip(&self.poses) {
            let found = view.camera.world_to_camera;
            assert!((found.determinant() - 1.0).abs() < 1e-9, "a left-handed camera");
            for (index, point) in self.points.iter().enumerate() {
                let stored = pose.transform_point3(*point);
                let pixel = self.lens.pixel(stored.truncate() / stored.z) * scale;
                let expected = upright_pixel(orientation, pixel, size);
                let world = match format {
                    Format::Model => poses.points[index].position.into(),
                    _ if is_mirrored => *point * DVec3::new(-1.0, 1.0, 1.0),
                    _ => *point,
                };
                let seen = found.transform_point3(world);
                assert!(seen.z > 0.0);
                let at = view.lens.pixel(seen.truncate() / seen.z);
                worst = worst.max(at.distance(expected));
            }
        }
        worst
    }
}

fn format() -> impl Strategy<Value = Format> {
    prop_oneof![Just(Format::Model), Just(Format::Transforms), Just(Format::PosesBounds)]
}

/// A lens that each format can represent, for a picture that is not square.
fn lens(format: Format) -> impl Strategy<Value = Lens> {
    let sides = (60..160usize, 60..160usize).prop_filter("square", |(w, h)| w.abs_diff(*h) > 8);
    let shares = (0.8..1.6f64, 0.9..1.1f64, -0.1..0.1f64, -0.1..0.1f64);
    let terms = prop::array::uniform4(-0.02..0.02f64);
    (sides, shares, terms).prop_map(move |((width, height), (f, aspect, x, y), terms)| {
        let plain = format == Format::PosesBounds;
        let fx = f * width.max(height) as f64;
        let middle =
            |side: usize, share: f64| side as f64 * (0.5 + if plain { 0.0 } else { share });
        Lens {
            intrinsics: Intrinsics {
                width,
                height,
                fx,
                fy: if plain { fx } else { fx * aspect },
                cx: middle(width, x),
                cy: middle(height, y),
            },
            distortion: match plain {
                true => Distortion::None,
                false => Distortion::Perspective {
                    radial: [terms[0], terms[1], 0.0, 0.0, 0.0, 0.0],
                    tangential: [terms[2], terms[3]],
                },
            },
        }
    })
}

fn resized(lens: &Lens, scale: f64) -> (usize, usize) {
    let side = |side: usize| (side as f64 * scale).round().max(1.0) as usize;
    (side(lens.intrinsics.width), side(lens.intrinsics.height))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn points_project_to_their_place_in_the_upright_photograph(
        (format, lens) in format().prop_flat_map(|format| (Just(format), lens(format))),
        orientation in 1..=8u16,
        scale in prop_oneof![Just(1.0), 0.5..2.0f64],
    ) {
        let size = resized(&lens, scale);
        let stored = Stored::new(lens, size, &[orientation]);
        let (poses, _) = stored.read(format);
        let error = stored.error(&poses.unwrap(), format, size, orientation);
        prop_assert!(error < 0.1, "{error} px off");
    }
}

/// A lens of 96 x 72 px without distortion.
fn plain() -> Lens {
    Lens {
        intrinsics: Intrinsics { width: 96, height: 72, fx: 90.0, fy: 92.0, cx: 50.0, cy: 33.0 },
        distortion: Distortion::None,
    }
}

#[test]
fn a_dot_in_each_orientation_is_where_its_point_projects() {
    for orientation in 1..=8 {
        let stored = Stored::new(plain(), (96, 72), &[orientation]);
        let dot = DVec2::new(70.5, 20.5);
        let mut samples = vec![60; 96 * 72];
        samples[20 * 96 + 70] = 255;
        write_png(&stored.views[0].file, orientation, (96, 72), &samples);
        let poses = stored.read(Format::Transforms).0.unwrap();
        let camera = poses.views[0].camera;
        let mirrored =
            DVec3::new(if camera_is_mirrored(orientation) { -1.0 } else { 1.0 }, 1.0, 1.0);
        let point =
            stored.poses[0].inverse().transform_point3(3.0 * stored.lens.ray(dot).extend(1.0));
        let (pixel, depth) = camera.project(point * mirrored).unwrap();
        assert!((depth - 3.0).abs() < 1e-9);
        let upright = Image::load(&stored.views[0].file).unwrap();
        let brightest = (0..upright.pixels())
            .max_by(|a, b| upright.plane(0)[*a].total_cmp(&upright.plane(0)[*b]))
            .unwrap();
        let at = DVec2::new(
            (brightest % upright.width()) as f64 + 0.5,
            (brightest / upright.width()) as f64 + 0.5,
        );
        assert!(pixel.distance(at) < 1e-6, "orientation {orientation}: {pixel}, not {at}");
        assert_eq!(
            (camera.intrinsics.width, camera.intrinsics.height),
            (upright.width(), upright.height())
        );
    }
}

fn camera_is_mirrored(orientation: u16) -> bool {
    [2, 4, 5, 7].contains(&orientation)
}

#[test]
fn a_quarter_turn_swaps_focal_lengths_and_moves_the_principal_point() {
    let stored = Stored::new(plain(), (96, 72), &[6]);
    let (poses, warnings) = stored.read(Format::Model);
    let k = poses.unwrap().views[0].lens.intrinsics;
    assert_eq!((k.width, k.height), (72, 96));
    assert_eq!((k.fx, k.fy, k.cx, k.cy), (92.0, 90.0, 72.0 - 33.0, 50.0));
    assert!(warnings.is_empty(), "the sizes tell: {warnings:?}");
}

#[test]
fn an_assumed_rotation_is_reported() {
    for (orientation, is_assumed) in [(1, false), (2, true), (3, true), (4, true), (8, false)] {
        let stored = Stored::new(plain(), (96, 72), &[orientation]);
        let warnings = stored.read(Format::Model).1;
        let warns = warnings.iter().any(|warning| warning.contains("as they are stored"));
        assert_eq!(warns, is_assumed, "{orientation}: {warnings:?}");
    }
}

#[test]
fn poses_of_pictures_already_rotated_are_used_unchanged() {
    let upright = Stored::new(plain(), (96, 72), &[1]);
    for (view, orientation) in upright.views.iter().zip([6, 8, 5, 7]) {
        write_png(&view.file, orientation, (72, 96), &[90; 96 * 72]);
    }
    for format in [Format::Model, Format::Transforms, Format::PosesBounds] {
        let poses = upright.read(format).0.unwrap();
        for (view, pose) in poses.views.iter().zip(&upright.poses) {
            assert!(view.camera.world_to_camera.abs_diff_eq(*pose, 1e-9));
            assert_eq!((view.lens.intrinsics.width, view.lens.intrinsics.height), (96, 72));
        }
    }
}

#[test]
fn photographs_whose_shape_differs_from_their_poses_are_refused_with_both_sizes() {
    // Cropped, squeezed, rotated without EXIF; with EXIF, matching neither shape.
    for (size, orientation, words) in [
        ((96, 60), 1, "96 x 60"),
        ((48, 72), 1, "48 x 72"),
        ((72, 96), 1, "turned by a quarter"),
        ((96, 60), 6, "by EXIF 60 x 96"),
    ] {
        let stored = Stored::new(plain(), size, &[orientation]);
        let (placed, warnings) = stored.read(Format::Model);
        assert!(placed.unwrap().views.is_empty());
        let message = warnings.join("\n");
        assert!(message.contains("96 x 72 px"), "{message}");
        assert!(message.contains(words), "{message}");
        assert!(message.contains("photo0.png, photo1.png, photo2.png, photo3.png: "), "{message}");
    }
}

#[test]
fn one_photograph_of_another_shape_is_left_out_by_name() {
    let stored = Stored::new(plain(), (96, 72), &[1]);
    write_png(&stored.views[2].file, 1, (96, 64), &[90; 96 * 64]);
    let (poses, warnings) = stored.read(Format::Transforms);
    let poses = poses.unwrap();
    let names: Vec<&str> = poses.views.iter().map(|view| &*view.name).collect();
    assert_eq!(names, ["photo0", "photo1", "photo3"]);
    let warns = |warning: &String| warning.contains("photo2.png:") && warning.contains("96 x 64");
    assert!(warnings.iter().any(warns), "{warnings:?}");
}

#[test]
fn mirrored_photographs_among_others_are_left_out_by_name() {
    let stored = Stored::new(plain(), (96, 72), &[1, 3, 6, 2]);
    let (poses, warnings) = stored.read(Format::Model);
    assert_eq!(poses.unwrap().views.len(), 3);
    let warns = |warning: &String| warning.contains("photo3.png:") && warning.contains("mirrored");
    assert!(warnings.iter().any(warns), "{warnings:?}");
}

#[test]
fn an_error_of_half_a_pixel_is_detected() {
    let stored = Stored::new(plain(), (96, 72), &[6]);
    let poses = stored.read(Format::Model).0.unwrap();
    let exact = stored.error(&poses, Format::Model, (96, 72), 6);
    assert!(exact < 1e-6, "{exact}");
    assert!(stored.error(&poses, Format::Model, (96, 72), 8) > 10.0);
    let mut moved = poses;
    moved.views[1].lens.intrinsics.cx += 0.5;
    assert!(stored.error(&moved, Format::Model, (96, 72), 6) > 0.4);
}
