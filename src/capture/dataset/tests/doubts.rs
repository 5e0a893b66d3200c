//! Poses that are used unchanged, with a warning.

use serde_json::{Value, json};

use super::formats::{CAMERAS, expect_warning, images};
use super::{Capture, capture};

/// The warnings about good poses changed by `edit`.
fn warnings(capture: &Capture, edit: &Value) -> Vec<String> {
    let (poses, warnings) = capture.of_json(|json| {
        let fields = edit.as_object().unwrap().clone();
        json.as_object_mut().unwrap().extend(fields);
    });
    assert_eq!(poses.unwrap().views.len(), 4);
    warnings
}

#[test]
fn impossible_lenses_are_reported_with_their_values() {
    let capture = capture();
    for (edit, words) in [
        (json!({ "fl_x": 4.25 }), "focal length of 2.1250 px"),
        (json!({ "fl_x": 4.25e3 }), "focal length of 2125.0000 px"),
        (json!({ "cx": 0.5, "cy": 0.5 }), "principal point of 0.2500, 0.2500 px"),
        (json!({ "cx": 1.5, "cy": -0.7 }), "principal point of 0.7500, -0.3500 px"),
        (json!({ "cx": 160.0, "cy": 120.0 }), "principal point of 80.0000, 60.0000 px"),
        (json!({ "k1": -9.0 }), "distortion that leaves"),
        (json!({ "k1": 900.0 }), "distortion that leaves"),
    ] {
        let warnings = warnings(&capture, &edit);
        expect_warning(&warnings, &["transforms.json: photo0.png, photo1.png", words]);
    }
    for good in [
        json!({ "fl_x": 20.0 }),
        json!({ "fl_x": 900.0 }),
        json!({ "cx": 25.0, "cy": 40.0 }),
        json!({ "k1": -0.3, "k2": 0.08 }),
        json!({ "k1": 0.4 }),
        json!({ "fl_x": 19.0, "camera_model": "OPENCV_FISHEYE" }),
    ] {
        assert_eq!(warnings(&capture, &good), [""; 0], "{good}");
    }
}

#[test]
fn a_pose_of_nearly_the_same_size_is_reported_with_both_sizes() {
    let capture = capture();
    for (width, height, is_known) in [
        (80, 60, false),
        (41, 31, false),
        (40, 30, false),
        (44, 33, true),
        (36, 27, true),
        (20, 15, false),
    ] {
        let edit = json!({ "w": width, "h": height, "fl_x": 0.875 * f64::from(width) });
        let warnings = warnings(&capture, &edit);
        match is_known {
            true => expect_warning(&warnings, &["40 x 30 px", &format!("{width} x {height} px")]),
            false => assert_eq!(warnings, [""; 0], "{width} x {height}"),
        }
    }
}

#[test]
fn a_view_without_visible_points_is_reported_by_name() {
    let capture = capture();
    let folder = capture.dir.path().join("sparse/0");
    std::fs::create_dir_all(&folder).unwrap();
    let point = |i: i32| {
        let (x, y) = (f64::from(i % 8) / 8.0 - 0.5, f64::from(i / 8) / 8.0 - 0.5);
        format!("{i} {x} {y} 0.5 9 9 9 0\n")
    };
    let points: String = (0..64).map(point).collect();
    std::fs::write(folder.join("points3D.txt"), points).unwrap();
    capture.assert_plain(capture.of_model(CAMERAS, &images(&capture, None, "\n")));
    // It faces away from them.
    let images = images(&capture, Some("1 0 0 0 0 0 -9"), "\n");
    let warnings = capture.of_model(CAMERAS, &images).1;
    expect_warning(&warnings, &["sparse/0: photo1.png: none of the points"]);
}
