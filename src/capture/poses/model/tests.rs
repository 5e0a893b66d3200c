use proptest::prelude::*;

use glam::{DQuat, DVec3};

use super::*;
use crate::camera::{Camera, Intrinsics};

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![-1e6..1e6f64, -1e-6..1e-6f64]
}

fn camera(id: u32) -> impl Strategy<Value = ModelCamera> {
    let model = (0..CameraModel::NAMES.len()).prop_map(|i| CameraModel::NAMES[i].0);
    (model, 1..5000usize, 1..5000usize, prop::collection::vec(1e-3..1e4f64, 12)).prop_map(
        move |(model, width, height, mut params)| {
            params.truncate(model.parameters());
            ModelCamera { id, model, width, height, params }
        },
    )
}

fn image(cameras: u32) -> impl Strategy<Value = ModelImage> {
    let keypoint = (number(), number(), prop::option::of(0..1u64 << 40));
    (
        any::<u32>(),
        prop::array::uniform4(0.1..1.0f64),
        prop::array::uniform3(number()),
        0..cameras,
        "[a-z0-9é]([a-z0-9 _.é-]{0,12}[a-z0-9])?",
        prop::collection::vec(keypoint, 0..4),
    )
        .prop_map(|(id, rotation, translation, camera_id, name, keypoints)| ModelImage {
            id,
            rotation,
            translation,
            camera_id,
            name,
            keypoints,
        })
}

fn point() -> impl Strategy<Value = ModelPoint> {
    (
        0..u64::MAX,
        prop::array::uniform3(number()),
        any::<[u8; 3]>(),
        0.0..10.0f64,
        prop::collection::vec(any::<(u32, u32)>(), 0..5),
    )
        .prop_map(|(id, position, colour, error, track)| ModelPoint {
            id,
            position,
            colour,
            error,
            track,
        })
}

fn model() -> impl Strategy<Value = SparseModel> {
    (
        [camera(0), camera(1)],
        prop::collection::vec(image(2), 0..5),
        prop::collection::vec(point(), 0..5),
    )
        .prop_map(|(cameras, images, points)| SparseModel {
            cameras: cameras.to_vec(),
            images,
            points,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn text_and_binary_models_read_back_as_written(model in model()) {
        let dir = tempfile::tempdir().unwrap();
        model.write_text(dir.path()).unwrap();
        prop_assert_eq!(&SparseModel::read(dir.path()).unwrap(), &model);
        model.write_binary(dir.path()).unwrap();
        prop_assert_eq!(&SparseModel::read(dir.path()).unwrap(), &model);
    }

    #[test]
    fn a_binary_file_cut_anywhere_is_an_error_and_never_a_panic(
        model in model(),
        cut in 0.0..1.0f64,
        which in 0..3usize,
    ) {
        let dir = tempfile::tempdir().unwrap();
        model.write_binary(dir.path()).unwrap();
        let file = dir.path().join(["cameras.bin", "images.bin", "points3D.bin"][which]);
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..(bytes.len() as f64 * cut) as usize]).unwrap();
        prop_assert!(SparseModel::read(dir.path()).is_err());
    }
}

#[test]
fn a_text_model_in_colmaps_form_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let save = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    save(
        "cameras.txt",
        "# Camera list\n# Number of cameras: 1\n7 SIMPLE_RADIAL 640 480 500.5 320 240 -0.01\n",
    );
    save(
        "images.txt",
        "# Image list\n3 1 0 0 0 0.5 -1 2 7 a b.png\n10.5 20.25 -1 11 21 4\n4 0 1 0 0 0 0 0 7 c.png\n\n",
    );
    save("points3D.txt", "# points\n4 1 2 3 10 20 30 0.75 3 1\n");
    let model = SparseModel::read(dir.path()).unwrap();
    assert_eq!(model.images.len(), 2);
    assert_eq!(model.images[0].name, "a b.png");
    assert_eq!(model.images[0].keypoints, [(10.5, 20.25, None), (11.0, 21.0, Some(4))]);
    assert!(model.images[1].keypoints.is_empty());
    let lens = model.camera_of(&model.images[0]).lens();
    assert_eq!((lens.intrinsics.fx, lens.intrinsics.fy), (500.5, 500.5));
    assert_eq!(model.points[0].track, [(3, 1)]);
    assert_eq!(model.mean_track(), Some(1.0));
}

#[test]
fn a_bad_line_is_named() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("cameras.txt"), "# x\n1 PINHOLE 640 480 500 500 320\n").unwrap();
    let error = SparseModel::read(dir.path()).unwrap_err().to_string();
    assert!(error.contains("line 2") && error.contains("4 parameters"), "{error}");
}

#[test]
fn an_image_without_its_camera_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let camera = Camera::from_pose(
        Intrinsics { width: 4, height: 4, fx: 1.0, fy: 1.0, cx: 2.0, cy: 2.0 },
        DQuat::IDENTITY,
        DVec3::ZERO,
    );
    let images = vec![ModelImage::posed(1, 9, "a", &camera)];
    SparseModel { images, ..SparseModel::default() }.write_binary(dir.path()).unwrap();
    assert!(SparseModel::read(dir.path()).unwrap_err().to_string().contains("camera 9"));
}

/// A binary model with one PINHOLE camera before and one after a camera of model `number` with this
/// many parameters, and an image of each.
fn model_with(dir: &Path, number: i32, parameters: usize) {
    let k = Intrinsics { width: 96, height: 64, fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };
    let pose = Camera::from_pose(k, DQuat::IDENTITY, DVec3::ZERO);
    let images = [1, 2, 3].map(|id| ModelImage::posed(id, id, format!("{id}.jpg"), &pose));
    let cameras = vec![ModelCamera::pinhole(1, &k), ModelCamera::pinhole(3, &k)];
    SparseModel { cameras, images: images.to_vec(), points: Vec::new() }.write_binary(dir).unwrap();
    let file = dir.join("cameras.bin");
    let mut bytes = std::fs::read(&file).unwrap();
    let row = (bytes.len() - 8) / 2;
    let mut other = 2_u32.to_le_bytes().to_vec();
    other.extend(number.to_le_bytes());
    other.extend([192_u64, 96].map(u64::to_le_bytes).concat());
    other.extend((0..parameters).flat_map(|i| (0.5 * i as f64).to_le_bytes()));
    bytes.splice(8 + row..8 + row, other);
    bytes[0] = 3;
    std::fs::write(&file, bytes).unwrap();
}

#[test]
fn a_binary_model_loses_only_images_of_unsupported_cameras() {
    // All models that COLMAP 4.1 has and we do not, then some of future versions.
    for (number, parameters, name) in [
        (7, 5, "FOV"),
        (10, 12, "THIN_PRISM_FISHEYE"),
        (11, 16, "RAD_TAN_THIN_PRISM_FISHEYE"),
        (12, 4, "SIMPLE_DIVISION"),
        (13, 5, "DIVISION"),
        (16, 6, "EUCM"),
        (17, 2, "EQUIRECTANGULAR"),
        (18, 0, "18"),
        (18, 9, "18"),
        (23, 16, "23"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        model_with(dir.path(), number, parameters);
        let (model, left_out) = SparseModel::read_usable(dir.path()).expect(name);
        let names: Vec<&str> = model.images.iter().map(|image| image.name.as_str()).collect();
        assert_eq!(names, ["1.jpg", "3.jpg"], "{name}");
        assert_eq!(left_out.len(), 1);
        let reason = format!("camera model {name} is not read");
        assert!(left_out[0].name == "2.jpg" && left_out[0].reason.starts_with(&reason), "{name}");
    }
}

#[test]
fn an_impossible_camera_model_number_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    model_with(dir.path(), 1_000_000, 4);
    let error = SparseModel::read(dir.path()).unwrap_err().to_string();
    assert!(error.contains("camera model 1000000"), "{error}");
}
