//! The formats as other programs write them, and the expected results.

use glam::DVec2;
use serde_json::{Value, json};

use super::super::*;
use super::{Capture, capture, flipped, poses_and_warnings};
use crate::camera::Camera;
use crate::poses::Distortion;
use crate::poses::model::{ModelCamera, ModelImage};
use crate::poses::npy::Table;

/// A `transforms.json` with the capture's cameras, changed by `edit`.
fn transforms(capture: &Capture, edit: impl Fn(&mut Value)) -> Value {
    let frame = |(i, camera): (usize, &Camera)| {
        json!({
            "file_path": format!("images/photo{i}.png"),
            "transform_matrix": flipped(&camera.world_to_camera),
        })
    };
    let frames: Vec<Value> = capture.cameras.iter().enumerate().map(frame).collect();
    let mut json = json!({ "w": 80, "h": 60, "fl_x": 70.0, "frames": frames });
    edit(&mut json);
    json
}

impl Capture {
    /// The result for a file with this content.
    fn of(
        &self,
        name: &str,
        content: impl AsRef<[u8]>,
    ) -> (Result<PlacedPoses, PoseFileError>, Vec<String>) {
        let file = self.dir.path().join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, content).unwrap();
        poses_and_warnings(&file, &self.views)
    }

    pub(super) fn of_json(
        &self,
        edit: impl Fn(&mut Value),
    ) -> (Result<PlacedPoses, PoseFileError>, Vec<String>) {
        self.of("transforms.json", transforms(self, edit).to_string())
    }

    /// Asserts that the poses are the capture's, without warnings.
    pub(super) fn assert_plain(&self, result: (Result<PlacedPoses, PoseFileError>, Vec<String>)) {
        assert_eq!(result.1, [""; 0]);
        self.assert_right(&result.0.unwrap());
    }
}

pub(super) fn expect_warning(warnings: &[String], words: &[&str]) {
    let has_all = |warning: &String| words.iter().all(|word| warning.contains(word));
    assert!(warnings.iter().any(has_all), "{words:?} in {warnings:?}");
}

#[test]
fn byte_order_marks_and_rows_of_three_change_nothing() {
    let capture = capture();
    let text = transforms(&capture, |_| ()).to_string();
    capture.assert_plain(capture.of("transforms.json", format!("\u{feff}{text}")));
    let wide = |unit: fn(u16) -> [u8; 2]| -> Vec<u8> {
        let units = format!("\u{feff}{text}").encode_utf16().collect::<Vec<_>>();
        units.into_iter().flat_map(unit).collect()
    };
    capture.assert_plain(capture.of("transforms.json", wide(u16::to_le_bytes)));
    capture.assert_plain(capture.of("transforms.json", wide(u16::to_be_bytes)));
    capture.assert_plain(capture.of_json(|json| {
        for frame in json["frames"].as_array_mut().unwrap() {
            frame["transform_matrix"].as_array_mut().unwrap().truncate(3);
        }
    }));
}

#[test]
fn scaled_and_rounded_rotations_become_rotations_with_a_warning() {
    let capture = capture();
    for (scale, digits, limit) in [(1.18, 12, 1e-9), (0.5, 3, 2e-3), (1.0, 2, 2e-2)] {
        let step = 10f64.powi(-digits);
        let (poses, warnings) = capture.of_json(|json| {
            for frame in json["frames"].as_array_mut().unwrap() {
                for row in frame["transform_matrix"].as_array_mut().unwrap() {
                    for cell in row.as_array_mut().unwrap().iter_mut().take(3) {
                        let value = cell.as_f64().unwrap() * scale;
                        *cell = json!((value / step).round() * step);
                    }
                }
                frame["transform_matrix"][3] = json!([0.0, 0.0, 0.0, 1.0]);
            }
        });
        for (view, camera) in poses.unwrap().views.iter().zip(&capture.cameras) {
            let rotation = view.camera.rotation();
            assert!(rotation.abs_diff_eq(camera.rotation(), limit), "{scale}");
            assert!((rotation.determinant() - 1.0).abs() < 1e-12);
            assert!(view.camera.centre().distance(camera.centre()) < 1e-9);
        }
        expect_warning(&warnings, &["transforms.json", "transform_matrix", "images/photo0.png"]);
    }
}

#[test]
fn an_unusable_frame_is_left_out_with_its_name_and_field() {
    let capture = capture();
    type Case = (&'static str, fn(&mut Value), &'static str);
    let cases: [Case; 7] = [
        ("transform_matrix", |f| f["transform_matrix"][0][0] = json!("NaN"), "NaN"),
        ("transform_matrix", |f| f["transform_matrix"] = json!([[1.0]]), "rows of 4"),
        (
            "transform_matrix",
            |f| f["transform_matrix"][3] = json!([1.0, 2.0, 3.0, 1.0]),
            "last row",
        ),
        (
            "transform_matrix",
            |f| f["transform_matrix"][0] = json!([0.0, 0.0, 0.0, 1.0]),
            "rotation",
        ),
        ("camera_model", |f| f["camera_model"] = json!("EQUIRECTANGULAR"), "EQUIRECTANGULAR"),
        ("fl_x", |f| f["fl_x"] = json!("wide"), "not a number"),
        ("k1", |f| f["k1"] = json!("Infinity"), "not a number"),
    ];
    for (field, spoil, words) in cases {
        let (poses, warnings) = capture.of_json(|json| spoil(&mut json["frames"][2]));
        assert_eq!(poses.unwrap().views.len(), 3, "{field}");
        expect_warning(&warnings, &["images/photo2.png: ", &format!("`{field}`"), words]);
    }
    let (poses, warnings) = capture.of_json(|json| {
        json["frames"][1].as_object_mut().unwrap().remove("file_path");
    });
    assert_eq!(poses.unwrap().views.len(), 3);
    expect_warning(&warnings, &["frame 1", "file_path"]);
}

#[test]
fn a_python_nan_or_infinity_affects_only_its_frame() {
    let capture = capture();
    let text = transforms(&capture, |json| {
        json["frames"][1]["transform_matrix"][1][3] = json!("HERE");
        json["frames"][0]["note"] = json!("a \\\"NaN\" in a text");
    });
    for no_number in ["NaN", "Infinity", "-Infinity"] {
        let text = text.to_string().replace("\"HERE\"", no_number);
        let (poses, warnings) = capture.of("transforms.json", text);
        let names: Vec<String> = poses.unwrap().views.into_iter().map(|view| view.name).collect();
        assert_eq!(names, ["photo0", "photo2", "photo3"]);
        expect_warning(&warnings, &["images/photo1.png", "transform_matrix", "NaN"]);
    }
}

#[test]
fn a_fault_of_all_frames_is_an_error_that_names_it() {
    let capture = capture();
    for (edit, words) in [
        (json!({ "camera_model": "EQUIRECTANGULAR" }), "`camera_model` is EQUIRECTANGULAR"),
        (json!({ "camera_model": "ORTHOPHOTO" }), "ORTHOPHOTO"),
        (json!({ "ftheta_p0": 1.0 }), "ftheta_p0"),
        (json!({ "latlong": true }), "`latlong`"),
        (json!({ "equirectangular": true }), "`equirectangular`"),
        (
            json!({ "fl_x": null, "camera_angle_x": 60.0 }),
            "`camera_angle_x` is 60, but must be in radians",
        ),
        (json!({ "distortion_params": [0.1, 0.0] }), "`distortion_params`"),
        (json!({ "k5": 0.1 }), "`k5`"),
        (json!({ "h": null }), "`w` without `h`"),
    ] {
        let (poses, _) = capture.of_json(|json| {
            let fields = edit.as_object().unwrap().clone();
            json.as_object_mut().unwrap().extend(fields);
        });
        let message = poses.unwrap_err().to_string();
        assert!(message.starts_with("transforms.json: images/photo0.png"), "{message}");
        assert!(message.contains(words), "{message}");
    }
    let mirrored = |json: &mut Value| {
        for frame in json["frames"].as_array_mut().unwrap() {
            for row in 0..3 {
                let cell = &mut frame["transform_matrix"][row][0];
                *cell = json!(-cell.as_f64().unwrap());
            }
        }
    };
    let message = capture.of_json(mirrored).0.unwrap_err().to_string();
    assert!(message.contains("`transform_matrix` is a mirror image"), "{message}");
}

#[test]
fn broken_json_is_located_by_its_frame() {
    let capture = capture();
    let text = transforms(&capture, |_| ()).to_string();
    let cut = text.rfind("transform_matrix").unwrap();
    let message = capture.of("transforms.json", &text[..cut]).0.unwrap_err().to_string();
    assert!(message.contains("cut short") && message.contains("photo3.png"), "{message}");
    let spoiled = text.replacen("[[", "[[,", 2);
    let message = capture.of("transforms.json", spoiled).0.unwrap_err().to_string();
    assert!(message.contains("not valid JSON") && message.contains("photo0.png"), "{message}");
    assert!(!message.contains("column"), "{message}");
    let message = capture.of("transforms.json", "{}").0.unwrap_err().to_string();
    assert!(message.contains("`frames`"), "{message}");
}

#[test]
fn each_frame_has_its_own_camera_model() {
    let capture = capture();
    let (poses, warnings) = capture.of_json(|json| {
        json["camera_model"] = json!("OPENCV");
        json["k1"] = json!(-0.05);
        json["frames"][1]["camera_model"] = json!("OPENCV_FISHEYE");
        json["frames"][2]["camera_model"] = json!("OPENCV_FISHEYE");
        json["frames"][2]["k1"] = json!(0.03);
        json["frames"][3]["k2"] = json!(0.01);
    });
    assert_eq!(warnings, [""; 0]);
    let found: Vec<_> = poses.unwrap().views.iter().map(|view| view.lens.distortion).collect();
    let perspective = |k1, k2| Distortion::Perspective {
        radial: [k1, k2, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0; 2],
    };
    let fisheye = |k1| Distortion::Fisheye { radial: [k1, 0.0, 0.0, 0.0] };
    // A perspective term does not apply to a fisheye, and a frame's own terms replace the file's.
    let expected = [perspective(-0.05, 0.0), fisheye(0.0), fisheye(0.03), perspective(0.0, 0.01)];
    assert_eq!(found, expected);
}

#[test]
fn k4_is_the_fourth_term_of_a_polynomial_or_of_the_angle_or_opencvs() {
    let capture = capture();
    let at = |model: &str| {
        let (poses, _) = capture.of_json(|json| {
            json["camera_model"] = json!(model);
            json["k4"] = json!(-0.2);
        });
        poses.unwrap().views[0].lens.distortion.distort(DVec2::new(0.6, 0.0)).x
    };
    let (r, angle) = (0.6f64, 0.6f64.atan());
    assert!((at("OPENCV") - r * (1.0 - 0.2 * r.powi(8))).abs() < 1e-12);
    assert!((at("OPENCV_FISHEYE") - angle * (1.0 - 0.2 * angle.powi(8))).abs() < 1e-12);
    assert!((at("FULL_OPENCV") - r / (1.0 - 0.2 * r * r)).abs() < 1e-12);
}

#[test]
fn angles_apply_to_width_and_height() {
    let capture = capture();
    let focal = |edit: Value| {
        let (poses, _) = capture.of_json(|json| {
            let object = json.as_object_mut().unwrap();
            object.remove("fl_x");
            object.extend(edit.as_object().unwrap().clone());
        });
        let k = poses.unwrap().views[0].lens.intrinsics;
        (k.fx, k.fy)
    };
    let angle = |side: f64, focal: f64| 2.0 * (0.5 * side / focal).atan();
    // At 40 x 30 px.
    let near = |(fx, fy): (f64, f64), expected: (f64, f64)| {
        assert!((fx - expected.0).abs() < 1e-9 && (fy - expected.1).abs() < 1e-9, "{fx} {fy}");
    };
    let (x, y) = (angle(80.0, 70.0), angle(60.0, 72.0));
    near(focal(json!({ "camera_angle_x": x })), (35.0, 35.0));
    near(focal(json!({ "camera_angle_x": x, "camera_angle_y": y })), (35.0, 36.0));
    near(focal(json!({ "camera_angle_y": y })), (36.0, 36.0));
    let degrees = json!({ "x_fov": x.to_degrees(), "y_fov": y.to_degrees() });
    near(focal(degrees), (35.0, 36.0));
    near(focal(json!({ "fl_y": 72.0 })), (36.0, 36.0));
}

#[test]
fn split_files_are_read_together_and_the_test_split_is_held_out() {
    let capture = capture();
    let all = transforms(&capture, |_| ());
    let part = |frames: &[usize]| {
        let mut part = all.clone();
        part["frames"] = frames.iter().map(|i| all["frames"][*i].clone()).collect();
        part.to_string()
    };
    let folder = capture.dir.path();
    std::fs::write(folder.join("transforms_test.json"), part(&[3])).unwrap();
    std::fs::write(folder.join("transforms_val.json"), part(&[0])).unwrap();
    let (poses, _) = capture.of("transforms_train.json", part(&[1, 2]));
    let poses = poses.unwrap();
    capture.assert_right(&poses);
    assert_eq!(poses.held_out, ["photo0", "photo3"]);
    let (poses, _) = capture.of_json(|json| json["test_filenames"] = json!(["images/photo1.png"]));
    assert_eq!(poses.unwrap().held_out, ["photo1"]);
    let (poses, _) = capture.of_json(|json| {
        json["val_filenames"] = json!(["images/photo1.png", "images/photo2.png"]);
        json["train_filenames"] = json!(["images/photo0.png", "images/photo2.png"]);
    });
    assert_eq!(poses.unwrap().held_out, ["photo1"]);
}

#[test]
fn a_frame_of_two_splits_trains() {
    let capture = capture();
    let all = transforms(&capture, |_| ()).to_string();
    for split in ["val", "test"] {
        let file = capture.dir.path().join(format!("transforms_{split}.json"));
        std::fs::write(file, &all).unwrap();
    }
    let (poses, warnings) = capture.of("transforms_train.json", &all);
    assert_eq!(poses.as_ref().unwrap().held_out, [""; 0]);
    capture.assert_plain((poses, warnings));
}

#[test]
fn file_pixels_scale_with_a_frame_of_another_size() {
    let capture = capture();
    capture.assert_plain(capture.of_json(|json| {
        json["cx"] = json!(40.0);
        json["cy"] = json!(30.0);
        let frames = json["frames"].as_array_mut().unwrap();
        (frames[1]["w"], frames[1]["h"]) = (json!(160), json!(120));
        (frames[2]["w"], frames[2]["h"]) = (json!(160), json!(120));
        (frames[2]["fl_x"], frames[2]["cx"]) = (json!(140.0), json!(80.0));
    }));
}

#[test]
fn mitsuba_and_opencv_axes_are_read_if_a_file_declares_them() {
    let capture = capture();
    for (key, value, signs) in [
        ("from_na", json!(true), [1.0, -1.0, -1.0]),
        ("from_na", json!(false), [1.0, 1.0, 1.0]),
        ("from_mitsuba", json!(true), [-1.0, 1.0, -1.0]),
        ("normal_mts_args", json!({ "spp": 16 }), [-1.0, 1.0, -1.0]),
    ] {
        capture.assert_plain(capture.of_json(|json| {
            json[key] = value.clone();
            for frame in json["frames"].as_array_mut().unwrap() {
                for (row, column) in (0..9).map(|i| (i / 3, i % 3)) {
                    let cell = &mut frame["transform_matrix"][row][column];
                    *cell = json!(signs[column] * cell.as_f64().unwrap());
                }
            }
        }));
    }
}

#[test]
fn the_neus2_matrix_gives_focal_lengths_and_principal_point() {
    let capture = capture();
    let matrix = json!([[70.0, 0.0, 40.0, 0.0], [0.0, 70.0, 30.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
    let with = |matrix: &Value| {
        capture.of_json(|json| {
            json.as_object_mut().unwrap().remove("fl_x");
            for frame in json["frames"].as_array_mut().unwrap() {
                frame["intrinsic_matrix"] = matrix.clone();
            }
        })
    };
    capture.assert_plain(with(&matrix));
    let message = with(&json!([70.0, 70.0])).0.unwrap_err().to_string();
    assert!(message.contains("`intrinsic_matrix`"), "{message}");
}

#[test]
fn nerfstudios_list_of_terms_equals_the_named_terms() {
    let capture = capture();
    let distortion = |edit: Value| {
        let (poses, _) = capture.of_json(|json| {
            json["camera_model"] = json!("OPENCV");
            let fields = edit.as_object().unwrap().clone();
            json.as_object_mut().unwrap().extend(fields);
        });
        poses.unwrap().views[1].lens.distortion
    };
    let named = json!({ "k1": -0.1, "k2": 0.02, "k3": 0.003, "p1": 0.001, "p2": -0.002 });
    let list = json!({ "distortion_params": [-0.1, 0.02, 0.003, 0.0, 0.001, -0.002] });
    assert_eq!(distortion(list), distortion(named));
}

#[test]
fn names_may_contain_dots_and_lack_an_extension() {
    let capture = capture();
    let dotted = capture.views.iter().enumerate().map(|(i, view)| {
        let file = view.file.with_file_name(format!("scan.{i}.png"));
        std::fs::rename(&view.file, &file).unwrap();
        CaptureView {
            name: format!("scan_{i}"),
            path: PhotoPath::new(&format!("images/scan.{i}.png")),
            file,
            ..view.clone()
        }
    });
    let views: Vec<CaptureView> = dotted.collect();
    for name in ["images/scan.{}", "./scan.{}.jpg"] {
        let json = transforms(&capture, |json| {
            for (i, frame) in json["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
                frame["file_path"] = json!(name.replace("{}", &i.to_string()));
            }
        });
        let file = capture.dir.path().join("transforms.json");
        std::fs::write(&file, json.to_string()).unwrap();
        capture.assert_right(&poses_and_warnings(&file, &views).0.unwrap());
    }
}

/// A text model of the capture, with another quaternion and translation for its second image.
pub(super) fn images(capture: &Capture, second: Option<&str>, keypoints: &str) -> String {
    let line = |(i, camera): (usize, &Camera)| {
        let image = ModelImage::posed(i as u32 + 1, 1, "", camera);
        let [w, x, y, z] = image.rotation;
        let [a, b, c] = image.translation;
        let pose = format!("{w} {x} {y} {z} {a} {b} {c}");
        let pose = second.filter(|_| i == 1).map_or(pose, ToOwned::to_owned);
        format!("{} {pose} 1 photo{i}.png\n{keypoints}", i + 1)
    };
    capture.cameras.iter().enumerate().map(line).collect()
}

impl Capture {
    pub(super) fn of_model(
        &self,
        cameras: &str,
        images: &str,
    ) -> (Result<PlacedPoses, PoseFileError>, Vec<String>) {
        let folder = self.dir.path().join("sparse/0");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("cameras.txt"), cameras).unwrap();
        std::fs::write(folder.join("images.txt"), images).unwrap();
        poses_and_warnings(&folder, &self.views)
    }
}

pub(super) const CAMERAS: &str = "1 PINHOLE 80 60 70 70 40 30\n";

#[test]
fn models_without_points_key_points_or_with_byte_order_marks_are_read() {
    let capture = capture();
    for keypoints in ["", "\n", "10.5 20.25 -1 11 21 4\n", "1 1 7 0 0 8 0 0 1\n"] {
        capture.assert_plain(capture.of_model(CAMERAS, &images(&capture, None, keypoints)));
    }
    let marked = format!("\u{feff}{}", images(&capture, None, "\n"));
    capture.assert_plain(capture.of_model(&format!("\u{feff}{CAMERAS}"), &marked));
}

#[test]
fn images_with_nan_are_left_out_by_name() {
    let capture = capture();
    for (pose, keypoints) in
        [("nan nan nan nan 0 0 4", "\n"), ("1 0 0 0 -nan(ind) 0 4", ""), ("0 0 0 0 1 2 3", "\n")]
    {
        let images = images(&capture, Some(pose), keypoints);
        let (poses, warnings) = capture.of_model(CAMERAS, &images);
        let names: Vec<String> = poses.unwrap().views.into_iter().map(|view| view.name).collect();
        assert_eq!(names, ["photo0", "photo2", "photo3"]);
        expect_warning(&warnings, &["sparse/0", "photo1.png"]);
    }
    let (poses, _) =
        capture.of_model("1 PINHOLE 80 60 nan 70 40 30\n", &images(&capture, None, ""));
    let placed = poses.unwrap();
    assert!(placed.views.is_empty() && placed.left_out.len() == 4, "{placed:?}");
    assert_eq!(placed.file, "sparse/0");
    assert!(placed.left_out[0].reason.contains("camera 1"), "{placed:?}");
}

#[test]
fn content_in_place_of_key_points_is_reported() {
    let capture = capture();
    let images = images(&capture, None, "some words here\n");
    let message = capture.of_model(CAMERAS, &images).0.unwrap_err().to_string();
    assert!(message.contains("line 2") && message.contains("key points"), "{message}");
}

#[test]
fn newer_equidistant_fisheyes_are_read() {
    let capture = capture();
    for camera in ["1 SIMPLE_FISHEYE 80 60 70 40 30\n", "1 FISHEYE 80 60 70 70 40 30\n"] {
        let (poses, _) = capture.of_model(camera, &images(&capture, None, "\n"));
        let lens = poses.unwrap().views[0].lens;
        assert_eq!(lens.distortion, Distortion::Fisheye { radial: [0.0; 4] });
        assert_eq!((lens.intrinsics.fx, lens.intrinsics.cy), (35.0, 15.0));
    }
}

#[test]
fn an_image_with_an_unsupported_camera_is_left_out_by_name() {
    let capture = capture();
    let known = ModelCamera::pinhole(1, &capture.cameras[0].intrinsics);
    let strange = "2 FOV 80 60 70 70 40 30 0.9\n";
    let mut model = SparseModel::of_views(
        (0..).map(|i| format!("photo{i}.png")).zip(capture.cameras.iter().copied()),
        [],
    );
    model.images[1].camera_id = 2;
    let [(_, cameras), (_, images), _] = model.text_files();
    let (poses, warnings) = capture.of_model(&format!("{strange}{cameras}"), &images);
    assert_eq!(poses.unwrap().views.len(), capture.cameras.len() - 1);
    expect_warning(&warnings, &["photo1.png: camera model FOV is not read"]);
    // In binary form: a row of 4 numbers becomes one of 5.
    let folder = capture.dir.path().join("binary");
    model.cameras = vec![known.clone(), ModelCamera { id: 2, ..known }];
    model.write_binary(&folder).unwrap();
    let file = folder.join("cameras.bin");
    let mut bytes = std::fs::read(&file).unwrap();
    let last = bytes.len() - (4 + 4 + 8 + 8 + 4 * 8);
    bytes[last + 4] = 7;
    bytes.extend(0.9_f64.to_le_bytes());
    std::fs::write(&file, bytes).unwrap();
    let (poses, warnings) = poses_and_warnings(&folder, &capture.views);
    assert_eq!(poses.unwrap().views.len(), capture.cameras.len() - 1);
    expect_warning(&warnings, &["photo1.png: camera model FOV is not read"]);
}

#[test]
fn a_git_lfs_pointer_is_named_as_such() {
    let capture = capture();
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n";
    for (name, file) in [("transforms.json", ""), ("b/cameras.bin", "b"), ("t/cameras.txt", "t")] {
        let path = capture.dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, pointer).unwrap();
        std::fs::write(path.with_file_name("images.bin"), pointer).unwrap();
        let file = if file.is_empty() { path } else { capture.dir.path().join(file) };
        let (poses, _) = poses_and_warnings(&file, &capture.views);
        let message = poses.unwrap_err().to_string();
        assert!(message.contains("Git LFS"), "{message}");
    }
}

#[test]
fn poses_bounds_are_read_as_float32_and_without_an_invalid_row() {
    let capture = capture();
    let file = capture.write_bounds();
    let table = Table::parse(&std::fs::read(&file).unwrap()).unwrap();
    let narrow = table.values.iter().flat_map(|v| (*v as f32).to_le_bytes());
    std::fs::write(&file, npy("<f4", "(4, 17)", narrow)).unwrap();
    let (poses, _) = poses_and_warnings(&file, &capture.views);
    for (view, camera) in poses.unwrap().views.iter().zip(&capture.cameras) {
        assert!(view.camera.world_to_camera.abs_diff_eq(camera.world_to_camera, 1e-5));
        assert!((view.lens.intrinsics.fx - 35.0).abs() < 1e-5);
    }
    let mut spoiled = table;
    spoiled.values[17 + 3] = f64::NAN;
    std::fs::write(&file, spoiled.to_bytes()).unwrap();
    let (poses, warnings) = poses_and_warnings(&file, &capture.views);
    let names: Vec<String> = poses.unwrap().views.into_iter().map(|view| view.name).collect();
    assert_eq!(names, ["photo0", "photo2", "photo3"]);
    expect_warning(&warnings, &["poses_bounds.npy", "row 1", "NaN"]);
    for (number, shape, reason) in [
        ("<i8", "(4, 17)", "float64"),
        ("<f8", "(4, 3, 5)", "two dimensions"),
        (">f8", "(4, 17)", "a picture of 0 x 0 px"),
    ] {
        std::fs::write(&file, npy(number, shape, [0; 8 * 4 * 17])).unwrap();
        let (poses, _) = poses_and_warnings(&file, &capture.views);
        let message = poses.unwrap_err().to_string();
        assert!(message.contains(reason), "{message}");
    }
}

/// A NumPy file.
fn npy(number: &str, shape: &str, values: impl IntoIterator<Item = u8>) -> Vec<u8> {
    let header = format!("{{'descr': '{number}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let length = (header.len() as u16).to_le_bytes();
    let mut bytes = [b"\x93NUMPY\x01\0", &length[..], header.as_bytes()].concat();
    bytes.extend(values);
    bytes
}

#[test]
fn impossible_depths_do_not_discard_a_pose() {
    let capture = capture();
    let file = capture.write_bounds();
    let table = Table::parse(&std::fs::read(&file).unwrap()).unwrap();
    for (near, far) in [(0.0, 8.0), (-1.0, 8.0), (2.0, f64::INFINITY), (f64::NAN, f64::NAN)] {
        let mut table = table.clone();
        (table.values[17 + 15], table.values[17 + 16]) = (near, far);
        std::fs::write(&file, table.to_bytes()).unwrap();
        capture.assert_plain(poses_and_warnings(&file, &capture.views));
    }
}
