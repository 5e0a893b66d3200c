mod doubts;
mod formats;
mod turned;

use glam::{DMat4, DVec3};

use super::*;
use crate::camera::{Camera, Intrinsics};
use crate::capture::PreparedImage;
use crate::image::{Image, Srgb};
use crate::poses::bounds::{BoundedCamera, write_poses_bounds};
use crate::poses::model::{ModelCamera, ModelImage};

/// A pose as in `transforms.json`: rows of OpenGL's camera to world.
fn flipped(world_to_camera: &DMat4) -> [[f64; 4]; 4] {
    let flip = DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
    let camera_to_world = world_to_camera.inverse() * flip;
    camera_to_world.transpose().to_cols_array_2d()
}

/// The poses of a file, and the warnings.
fn poses_and_warnings(
    file: &Path,
    views: &[CaptureView],
) -> (Result<PlacedPoses, PoseFileError>, Vec<String>) {
    let paths: Vec<PhotoPath> = views.iter().map(|view| view.path.clone()).collect();
    let placed = GivenPoses::open(file, &paths).unwrap().place(views);
    let warnings = placed.iter().flat_map(|placed| &placed.warnings);
    let warnings = warnings.map(|warning| warning.message.clone()).collect();
    (placed, warnings)
}

/// A photograph of 40 x 30 px.
fn photograph(name: String, path: &str, file: PathBuf) -> CaptureView {
    let image: Image<Srgb> = Image::new(40, 30);
    image.save(&file).unwrap();
    let prepared = PreparedImage::write(&image.to_linear(), &file.with_extension("half")).unwrap();
    CaptureView { file, ..CaptureView::upright(name, PhotoPath::new(path), prepared) }
}

struct Capture {
    dir: tempfile::TempDir,
    views: Vec<CaptureView>,
    cameras: Vec<Camera>,
}

/// Four photographs of 40x30 with poses for 80x60.
fn capture() -> Capture {
    let dir = tempfile::tempdir().unwrap();
    let k = Intrinsics { width: 80, height: 60, fx: 70.0, fy: 70.0, cx: 40.0, cy: 30.0 };
    let view = |i: usize| {
        let path = format!("photo{i}.png");
        photograph(format!("photo{i}"), &path, dir.path().join(&path))
    };
    let views = (0..4).map(view).collect();
    let eye = |i: usize| DVec3::new(i as f64 - 1.5, 0.1 * i as f64, -4.0);
    let cameras =
        (0..4).map(|i| Camera::look_at(k, eye(i), DVec3::new(0.0, 0.0, 0.5), DVec3::Y)).collect();
    Capture { dir, views, cameras }
}

impl Capture {
    fn poses(&self, path: &str) -> Result<PlacedPoses, PoseFileError> {
        GivenPoses::open(&self.dir.path().join(path), &self.paths())?.place(&self.views)
    }

    fn paths(&self) -> Vec<PhotoPath> {
        self.views.iter().map(|view| view.path.clone()).collect()
    }

    /// The true cameras as `poses_bounds.npy`.
    fn write_bounds(&self) -> PathBuf {
        let rows: Vec<_> = self
            .cameras
            .iter()
            .map(|camera| BoundedCamera { camera: *camera, near: 2.0, far: 8.0 })
            .collect();
        let file = self.dir.path().join("poses_bounds.npy");
        write_poses_bounds(&file, &rows).unwrap();
        file
    }

    fn assert_right(&self, poses: &PlacedPoses) {
        assert_eq!(poses.views.len(), 4);
        for (view, camera) in poses.views.iter().zip(&self.cameras) {
            assert!(view.camera.world_to_camera.abs_diff_eq(camera.world_to_camera, 1e-9));
            assert_eq!(view.camera.intrinsics, camera.intrinsics.resized(40, 30));
        }
    }
}

#[test]
fn a_colmap_model_gives_its_poses_and_points_by_name() {
    let capture = capture();
    let image = |(i, camera): (usize, &Camera)| {
        ModelImage::posed(i as u32, 1, format!("sub/photo{i}.jpg"), camera)
    };
    let model = SparseModel {
        cameras: vec![ModelCamera::pinhole(1, &capture.cameras[0].intrinsics)],
        // Deliberately out of order.
        images: capture.cameras.iter().enumerate().map(image).rev().collect(),
        points: vec![crate::poses::model::ModelPoint {
            id: 1,
            position: [1.0, 2.0, 3.0],
            colour: [4, 5, 6],
            error: 0.5,
            track: vec![(1, 0), (2, 0)],
        }],
    };
    model.write_text(&capture.dir.path().join("sparse")).unwrap();
    let poses = capture.poses("sparse").unwrap();
    capture.assert_right(&poses);
    assert_eq!((poses.points.len(), poses.points[0].track, poses.mean_track), (1, 2, Some(2.0)));
}

#[test]
#[should_panic(expected = "abs_diff_eq")]
fn a_pose_that_is_off_by_a_millionth_is_not_right() {
    let capture = capture();
    let image = |(i, camera): (usize, &Camera)| {
        ModelImage::posed(i as u32, 1, format!("photo{i}.jpg"), camera)
    };
    let model = SparseModel {
        cameras: vec![ModelCamera::pinhole(1, &capture.cameras[0].intrinsics)],
        images: capture.cameras.iter().enumerate().map(image).collect(),
        points: Vec::new(),
    };
    model.write_text(&capture.dir.path().join("sparse")).unwrap();
    let mut poses = capture.poses("sparse").unwrap();
    poses.views[2].camera.world_to_camera.w_axis.x += 1e-6;
    capture.assert_right(&poses);
}

#[test]
fn transforms_json_uses_opengl_axes() {
    let capture = capture();
    let frame = |(i, camera): (usize, &Camera)| {
        let matrix = flipped(&camera.world_to_camera);
        serde_json::json!({ "file_path": format!("./images/photo{i}"), "transform_matrix": matrix })
    };
    let frames: Vec<_> = capture.cameras.iter().enumerate().map(frame).collect();
    let angle = 2.0 * (40.0f64 / 70.0).atan();
    let json = serde_json::json!({ "camera_angle_x": angle, "w": 80, "h": 60, "frames": frames });
    std::fs::write(capture.dir.path().join("transforms.json"), json.to_string()).unwrap();
    let poses = capture.poses("transforms.json").unwrap();
    assert_eq!(poses.views.len(), 4);
    for (view, camera) in poses.views.iter().zip(&capture.cameras) {
        assert!(view.camera.world_to_camera.abs_diff_eq(camera.world_to_camera, 1e-9));
        assert!((view.camera.intrinsics.fx - 35.0).abs() < 1e-9);
    }
}

#[test]
fn a_frames_own_intrinsics_take_precedence_and_distortion_is_kept() {
    let capture = capture();
    let matrix = DMat4::IDENTITY.to_cols_array_2d();
    let frames: Vec<_> = (0..4)
        .map(|i| match i {
            0 => serde_json::json!({ "file_path": "photo0.png", "transform_matrix": matrix, "fl_x": 90.0 }),
            _ => serde_json::json!({ "file_path": format!("photo{i}.png"), "transform_matrix": matrix }),
        })
        .collect();
    let json = serde_json::json!({ "fl_x": 70.0, "w": 80, "h": 60, "k1": -0.1, "frames": frames });
    std::fs::write(capture.dir.path().join("transforms.json"), json.to_string()).unwrap();
    let poses = capture.poses("transforms.json").unwrap();
    assert!((poses.views[0].lens.intrinsics.fx - 45.0).abs() < 1e-9);
    assert!((poses.views[1].lens.intrinsics.fx - 35.0).abs() < 1e-9);
    assert!(!poses.views[1].lens.distortion.is_none());
    assert!(
        poses.views[1].camera.intrinsics.fx < 35.0,
        "a barrel's pinhole sees as much as it may"
    );
}

#[test]
fn transforms_without_a_size_use_the_photographs_size() {
    let capture = capture();
    let matrix = DMat4::IDENTITY.to_cols_array_2d();
    let frames: Vec<_> = (0..4)
        .map(|i| serde_json::json!({ "file_path": format!("./train/photo{i}"), "transform_matrix": matrix }))
        .collect();
    let angle = 2.0 * (20.0f64 / 35.0).atan();
    for optics in [
        serde_json::json!({ "camera_angle_x": angle }),
        serde_json::json!({ "fl_x": 35.0, "fl_y": 36.0, "cx": 19.0 }),
    ] {
        let mut json = optics.clone();
        json["frames"] = frames.clone().into();
        let file = capture.dir.path().join("transforms.json");
        std::fs::write(&file, json.to_string()).unwrap();
        let poses = capture.poses("transforms.json").unwrap();
        let k = poses.views[0].camera.intrinsics;
        assert_eq!((k.width, k.height), (40, 30), "{optics}");
        assert!((k.fx - 35.0).abs() < 1e-9, "{optics}: {k:?}");
        let is_square = optics.get("fl_y").is_none();
        assert!((k.fy - if is_square { 35.0 } else { 36.0 }).abs() < 1e-9);
        assert!((k.cx - if is_square { 20.0 } else { 19.0 }).abs() < 1e-9);
        assert!((k.cy - 15.0).abs() < 1e-9, "{optics}: {k:?}");
    }
    // One size without the other, or no focal length at all, are not intrinsics.
    for optics in [
        serde_json::json!({ "fl_x": 35.0, "w": 40 }),
        serde_json::json!({ "cx": 20.0 }),
        serde_json::json!({ "camera_angle_x": -1.0 }),
    ] {
        let mut json = optics.clone();
        json["frames"] = frames.clone().into();
        let file = capture.dir.path().join("transforms.json");
        std::fs::write(&file, json.to_string()).unwrap();
        assert!(
            matches!(capture.poses("transforms.json"), Err(PoseFileError::BadFile { .. })),
            "{optics}"
        );
    }
}

#[test]
fn a_count_that_differs_from_the_photographs_is_refused() {
    let capture = capture();
    let row = BoundedCamera { camera: capture.cameras[0], near: 2.0, far: 8.0 };
    write_poses_bounds(&capture.dir.path().join("poses_bounds.npy"), &[row; 3]).unwrap();
    let error = capture.poses("poses_bounds.npy").unwrap_err().to_string();
    assert!(error.contains("3 poses for 4 photographs"), "{error}");
}
