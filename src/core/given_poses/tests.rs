use glam::{DMat4, DVec3};

use super::*;
use crate::camera::Intrinsics;
use crate::capture::{CaptureView, PreparedImage};
use crate::dataset::GivenPoses;
use crate::event::{Event, Silent};
use crate::image::{Image, Srgb};
use crate::photo_path::PhotoPath;
use crate::pipeline::poses::pose_view;
use crate::poses::bounds::{BoundedCamera, write_poses_bounds};

struct Capture {
    dir: tempfile::TempDir,
    photographs: Vec<CaptureView>,
    views: Vec<PoseView>,
    cameras: Vec<Camera>,
}

/// Four photographs of 40x30 with poses for 80x60.
fn capture() -> Capture {
    let dir = tempfile::tempdir().unwrap();
    let k = Intrinsics { width: 80, height: 60, fx: 70.0, fy: 70.0, cx: 40.0, cy: 30.0 };
    let photograph = |i: usize| {
        let name = format!("photo{i}");
        let file = dir.path().join(format!("{name}.png"));
        let image: Image<Srgb> = Image::new(40, 30);
        image.save(&file).unwrap();
        let prepared =
            PreparedImage::write(&image.to_linear(), &file.with_extension("half")).unwrap();
        let path = PhotoPath::new(&format!("{name}.png"));
        CaptureView { file, ..CaptureView::upright(name, path, prepared) }
    };
    let photographs: Vec<CaptureView> = (0..4).map(photograph).collect();
    let views = photographs.iter().map(pose_view).collect();
    let eye = |i: usize| DVec3::new(i as f64 - 1.5, 0.1 * i as f64, -4.0);
    let cameras =
        (0..4).map(|i| Camera::look_at(k, eye(i), DVec3::new(0.0, 0.0, 0.5), DVec3::Y)).collect();
    Capture { dir, photographs, views, cameras }
}

impl Capture {
    fn sfm(&self, file: &str) -> GivenSfm {
        let path = self.dir.path().join(file);
        let names: Vec<_> = self.photographs.iter().map(|view| view.path.clone()).collect();
        let placed = GivenPoses::open(&path, &names).unwrap().place(&self.photographs).unwrap();
        let placement = Placement::Placed(placed);
        let file = match file {
            "transforms.json" => GivenPosesFile::Transforms(path),
            _ => GivenPosesFile::PosesBounds(path),
        };
        GivenSfm::new(&CapturePoses { file, placement }).unwrap()
    }

    fn poses(&self, file: &str) -> Result<Poses, PosesError> {
        self.sfm(file).poses(&self.request(), &mut Silent, &CancelToken::new())
    }

    fn request(&self) -> PoseRequest<'_> {
        PoseRequest {
            views: &self.views,
            work_dir: self.dir.path(),
            seed: 3,
            stamp: "",
            earlier: &[],
        }
    }

    /// The true cameras as `poses_bounds.npy`.
    fn write_bounds(&self) {
        let row = |camera: &Camera| BoundedCamera { camera: *camera, near: 2.0, far: 8.0 };
        let rows: Vec<_> = self.cameras.iter().map(row).collect();
        write_poses_bounds(&self.dir.path().join("poses_bounds.npy"), &rows).unwrap();
    }
}

/// The poses of a file, refined by swapping the first two, with the focal lengths passed to it.
fn refined(capture: &Capture, file: &str, fails: bool) -> (Poses, Vec<Option<f64>>, Vec<String>) {
    let seen = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let (passed, mut warned) = (seen.clone(), Vec::new());
    let sfm = capture.sfm(file).refined_by(Box::new(move |request, views, _, _| {
        let focals = request.views.iter().map(|view| view.focal_px);
        passed.lock().unwrap().extend(focals);
        if fails {
            return Err(PosesError::Matching { detail: "no such node".to_owned() });
        }
        let mut views = views.to_vec();
        views.swap(0, 1);
        let registered = views.len();
        let source = "refined".to_owned();
        Ok(Some(Poses { views, registered, source, ..Poses::default() }))
    }));
    let mut sink = |event: &Event| {
        if let Event::Warning { code, .. } = event {
            warned.push(code.clone());
        }
    };
    let poses = sfm.poses(&capture.request(), &mut sink, &CancelToken::new()).unwrap();
    let focals = seen.lock().unwrap().clone();
    (poses, focals, warned)
}

#[test]
fn phone_poses_are_refined_and_bundle_adjusted_ones_are_not() {
    let capture = capture();
    let matrix = DMat4::IDENTITY.to_cols_array_2d();
    let frame =
        |i| serde_json::json!({ "file_path": format!("photo{i}.png"), "transform_matrix": matrix });
    let frames: Vec<_> = (0..4).map(frame).collect();
    let json = serde_json::json!({ "fl_x": 70.0, "w": 80, "h": 60, "frames": frames });
    std::fs::write(capture.dir.path().join("transforms.json"), json.to_string()).unwrap();
    let (poses, focals, warned) = refined(&capture, "transforms.json", false);
    assert_eq!((&*poses.source, &*poses.views[0].name), ("refined", "photo1"));
    assert_eq!(focals, [Some(35.0); 4], "at the photographs' size");
    assert!(warned.is_empty());
    let (poses, _, warned) = refined(&capture, "transforms.json", true);
    assert_eq!((poses.registered, &*poses.views[0].name), (4, "photo0"));
    assert_eq!(warned, ["poses_unrefined", "points_guessed"]);
    capture.write_bounds();
    let (poses, focals, _) = refined(&capture, "poses_bounds.npy", false);
    assert_eq!((poses.registered, focals.len()), (4, 0));
}

#[test]
fn poses_bounds_are_matched_by_order_and_points_guessed_in_view_of_two_cameras() {
    let capture = capture();
    capture.write_bounds();
    let mut codes = Vec::new();
    let mut sink = |event: &Event| {
        if let Event::Warning { code, .. } = event {
            codes.push(code.clone());
        }
    };
    let request = capture.request();
    let given = capture.sfm("poses_bounds.npy");
    let poses = given.poses(&request, &mut sink, &CancelToken::new()).unwrap();
    assert_eq!((poses.registered, poses.total), (4, 4));
    assert_eq!(codes, ["points_guessed"]);
    assert_eq!(poses.points.len(), GUESSED_POINTS);
    let seen_by = |point: &SparsePoint| {
        let sees = |camera: &&Camera| {
            camera.project(DVec3::from(point.position)).is_some_and(|(p, depth)| {
                p.x >= 0.0 && p.y >= 0.0 && p.x <= 80.0 && p.y <= 60.0 && depth > 1.5
            })
        };
        capture.cameras.iter().filter(sees).count()
    };
    let shared = poses.points.iter().filter(|point| seen_by(point) >= 2).count();
    assert!(shared as f64 > 0.95 * GUESSED_POINTS as f64, "{shared}");
    let again = given.poses(&request, &mut Silent, &CancelToken::new()).unwrap();
    assert_eq!(again.points, poses.points);
}

#[test]
fn enough_triangulated_points_replace_guessed_ones() {
    let capture = capture();
    capture.write_bounds();
    let request = capture.request();
    let point = SparsePoint { position: [0.0; 3], colour: [9; 3], error: 0.5, track: 3 };
    let loose = SparsePoint { error: 1.6, track: 2, ..point };
    for (found, point, code) in [
        (LEAST_POINTS, point, None),
        (LEAST_POINTS, loose, Some("poses_unlikely")),
        (LEAST_POINTS, SparsePoint { track: 3, ..loose }, None),
        (LEAST_POINTS, SparsePoint { error: 0.7, ..loose }, None),
        (LEAST_POINTS - 1, point, Some("points_guessed")),
    ] {
        let mut codes = Vec::new();
        let mut sink = |event: &Event| {
            if let Event::Warning { code, .. } = event {
                codes.push(code.clone());
            }
        };
        let given =
            capture.sfm("poses_bounds.npy").triangulated_by(Box::new(move |_, views, _, _| {
                Ok(vec![point; found * views.len().min(1)])
            }));
        let points = given.poses(&request, &mut sink, &CancelToken::new()).unwrap().points;
        assert_eq!(codes, Vec::from_iter(code));
        let is_found = points.iter().all(|p| *p == point);
        assert_eq!(is_found, code != Some("points_guessed"));
    }
}

#[test]
fn names_without_photographs_are_too_few_poses() {
    let capture = capture();
    let json = serde_json::json!({ "fl_x": 70.0, "w": 80, "h": 60, "frames": [] });
    std::fs::write(capture.dir.path().join("transforms.json"), json.to_string()).unwrap();
    let refused = capture.poses("transforms.json").expect_err("none of them");
    let PosesError::TooFew { registered: 0, total: 4, advice } = refused else {
        panic!("{refused}");
    };
    assert!(
        advice.starts_with("the names in transforms.json must be"),
        "the file's name and not where it lies: {advice}"
    );
    let matrix = DMat4::IDENTITY.to_cols_array_2d();
    let frames = serde_json::json!([
        { "file_path": "photo0.png", "transform_matrix": [[1.0]] },
        { "file_path": "photo1.png", "transform_matrix": matrix },
    ]);
    let json = serde_json::json!({ "fl_x": 70.0, "w": 80, "h": 60, "frames": frames });
    std::fs::write(capture.dir.path().join("transforms.json"), json.to_string()).unwrap();
    let message = capture.poses("transforms.json").expect_err("no use").to_string();
    assert!(message.starts_with("transforms.json: 1 of 4 photographs"), "{message}");
    assert!(message.contains("photo0.png: "), "{message}");
}

#[test]
fn unusable_poses_are_an_error_that_names_their_file() {
    let (file, reason) = ("transforms.json".to_owned(), "no JSON".to_owned());
    let placement = Placement::Unusable { file, reason };
    let file = GivenPosesFile::Transforms("capture/transforms.json".into());
    let error = GivenSfm::new(&CapturePoses { file, placement }).err().expect("an error");
    assert_eq!(error.to_string(), "transforms.json: no JSON");
}
