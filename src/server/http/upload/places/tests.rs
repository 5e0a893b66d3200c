//! Tests where an upload's files are stored, and that they keep their names.

use std::fs;

use fled_core::camera::{Camera, Intrinsics};
use fled_core::cancel::CancelToken;
use fled_core::capture::Capture;
use fled_core::event::Silent;
use fled_core::given_poses::GivenSfm;
use fled_core::image::{EncodeFormat, Image, Srgb};
use fled_core::pipeline::poses::pose_view;
use fled_core::poses::model::SparseModel;
use fled_core::poses::{PoseRequest, PoseView, Poses, PosesError, Sfm};
use glam::DVec3;
use proptest::prelude::*;

use super::*;

#[test]
fn no_name_leaves_its_folder_or_reaches_a_command_line() {
    for name in [
        "../../etc/passwd",
        "-rf.png",
        "a\nb.jpg",
        "日本.png",
        ".hidden",
        "",
        "x".repeat(300).as_str(),
    ] {
        let safe = safe_name(name);
        assert!(
            !safe.starts_with(['-', '.']) && safe.len() <= 161 && !safe.is_empty(),
            "{name:?} -> {safe:?}"
        );
        assert!(!safe.contains(['/', '\\', '\n', '\0']), "{name:?} -> {safe:?}");
    }
    assert_eq!(safe_name("IMG 0001.JPG"), "IMG 0001.JPG");
}

#[test]
fn true_poses_are_not_mistaken_for_the_captures_own() {
    let mut places = Places::default();
    for (name, place) in [
        ("fern/sparse/0/images.txt", "sparse/images.txt"),
        ("fern/sparse/0/cameras.txt", "sparse/cameras.txt"),
        ("fern/sparse/1/images.txt", "sparse-2/images.txt"),
        ("fern/sparse_gt/images.txt", "sparse_gt/images.txt"),
        ("fern/sparse_gt/0/Points3D.txt", "sparse_gt-2/points3D.txt"),
        ("cameras.bin", "sparse-3/cameras.bin"),
    ] {
        let placed = places.place("images", name).expect("placed");
        assert_eq!(placed, Path::new(place), "{name}");
    }
}

#[test]
fn only_paths_from_a_root_or_a_drive_lose_their_folders() {
    for (sent, called) in [
        ("b:c/a.png", "b:c/a.png"),
        ("12:30/a.png", "12:30/a.png"),
        ("C:\\set\\a.png", "a.png"),
        ("C:/set/a.png", "a.png"),
        ("/home/me/set/a.png", "a.png"),
    ] {
        assert_eq!(sent_path("images", sent).as_str(), called);
    }
}

#[test]
fn thousands_of_equal_names_cost_no_more_than_different_ones() {
    let mut places = Places::default();
    let start = std::time::Instant::now();
    let paths: HashSet<PathBuf> =
        (0..20_000).map(|_| places.place("images", "photograph.jpg").expect("placed")).collect();
    assert_eq!(paths.len(), 20_000);
    assert!(paths.contains(Path::new("images/photograph-20000.jpg")));
    assert!(start.elapsed() < std::time::Duration::from_secs(2), "{:?}", start.elapsed());
}

/// A photograph with structure, different for each number.
fn photograph(number: usize) -> Vec<u8> {
    let value = |i: usize| ((i / 7 * 2_654_435_761 + number * 40_503) >> 5 & 255) as f32 / 900.0;
    let image: Image<Srgb> = Image::from_planar(80, 64, (0..3 * 80 * 64).map(value).collect());
    image.encode(EncodeFormat::Png).expect("encoded")
}

/// The camera of a photograph.
fn camera(number: usize) -> Camera {
    let k = Intrinsics { width: 80, height: 64, fx: 70.0, fy: 70.0, cx: 40.0, cy: 32.0 };
    let eye = DVec3::new(number as f64, 0.25, -4.0);
    Camera::look_at(k, eye, DVec3::new(0.5, 0.0, 0.0), DVec3::Y)
}

/// Stores parts like an upload: field, name and content.
fn store(dir: &Path, parts: &[(&str, String, Vec<u8>)]) {
    let mut places = Places::default();
    for (part, name, bytes) in parts {
        let file = dir.join(places.place(part, name).expect("placed"));
        fs::create_dir_all(file.parent().expect("a folder")).expect("made");
        fs::write(file, bytes).expect("written");
    }
    if let Some(names) = places.names() {
        fs::write(dir.join(fled_core::capture::NAMES), names).expect("written");
    }
}

/// The files of a model with these names, as parts of this field below this folder.
fn model(
    part: &'static str,
    folder: &str,
    names: &[String],
) -> Vec<(&'static str, String, Vec<u8>)> {
    let views = names.iter().cloned().enumerate().map(|(at, name)| (name, camera(at)));
    let model = SparseModel::of_views(views, [([0.0, 0.0, 1.0], [9, 9, 9])]);
    let files = model.text_files().into_iter();
    files.map(|(name, text)| (part, format!("{folder}{name}"), text.into_bytes())).collect()
}

fn given(capture: &Capture) -> Result<Poses, PosesError> {
    let views: Vec<PoseView> = capture.views.iter().map(pose_view).collect();
    let request = PoseRequest {
        views: &views,
        work_dir: Path::new("unused"),
        seed: 0,
        stamp: "",
        earlier: &[],
    };
    let given = GivenSfm::new(capture.poses.as_ref().expect("poses"))?;
    given.poses(&request, &mut Silent, &CancelToken::new())
}

#[test]
fn ambiguous_names_without_folders_are_refused() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let names = ["a.png", "0.png", "b.png", "0.png"].map(str::to_owned);
    let parts = names.iter().enumerate().map(|(i, n)| ("images", n.clone(), photograph(i)));
    let parts: Vec<_> = parts.chain(model("poses", "", &names[..3])).collect();
    store(dir.path(), &parts);
    let capture = Capture::open(dir.path(), dir.path()).expect("a capture");
    assert_eq!(capture.views.len(), 4);
    let error = given(&capture).expect_err("a tie").to_string();
    assert!(error.contains("`0.png` may be any of 2 photographs"), "{error}");
}

#[test]
fn models_sent_as_poses_stay_separate() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let names = ["a.png", "b.png", "c.png", "d.png"].map(str::to_owned);
    let parts = names.iter().enumerate().map(|(i, n)| ("images", n.clone(), photograph(i)));
    let parts = parts.chain(model("poses", "sparse/0/", &names));
    let parts: Vec<_> = parts.chain(model("poses", "sparse/1/", &names[..3])).collect();
    store(dir.path(), &parts);
    let capture = Capture::open(dir.path(), dir.path()).expect("a capture");
    assert_eq!(given(&capture).expect("poses").views.len(), 4);
    let mut places = Places::default();
    places.place("poses", "images.bin").expect("placed");
    let problem = places.place("poses", "images.bin").expect_err("sent twice");
    assert!(format!("{problem:?}").contains("`sparse/images.bin` is sent twice"));
}

#[test]
fn a_plain_upload_is_stored_under_its_own_names() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let names = ["a.png", "b.png", "c d.png"].map(str::to_owned);
    let parts = names.iter().enumerate().map(|(i, n)| ("images", n.clone(), photograph(i)));
    let parts: Vec<_> = parts.chain(model("poses", "", &names)).collect();
    store(dir.path(), &parts);
    assert!(!dir.path().join(fled_core::capture::NAMES).exists(), "the places say it all");
    for name in &names {
        assert!(dir.path().join("images").join(name).exists(), "{name}");
    }
    let capture = Capture::open(dir.path(), dir.path()).expect("a capture");
    assert_eq!(given(&capture).expect("poses").views.len(), 3);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    /// Whatever the files and their paths, each photograph has its own pose.
    #[test]
    fn every_photograph_of_an_upload_has_its_own_pose(
        paths in prop::collection::hash_set(
            "((cam[01]|A|a|e\u{301}|b:c)/){0,2}(DSC[ _?\"])?[0-3aA]{1,2}\\.(png|PNG)", 4..8),
        around in prop::sample::select(&["", "images/", "my scene/images/", "my scene\\images\\"][..]),
        by_field in any::<bool>(),
        left_out in any::<bool>(),
    ) {
        let paths: Vec<String> = paths.into_iter().collect();
        let known = &paths[..paths.len() - usize::from(left_out)];
        let photographs = paths.iter().enumerate().map(|(number, path)| {
            ("images", format!("{around}{path}"), photograph(number))
        });
        let wrapper = if around.starts_with("my") { "my scene/" } else { "" };
        let model = match by_field {
            true => model("poses", "", known),
            false => model("images", &format!("{wrapper}sparse/0/"), known),
        };
        let dir = tempfile::tempdir().expect("a temporary folder");
        store(dir.path(), &photographs.chain(model).collect::<Vec<_>>());
        let capture = Capture::open(dir.path(), dir.path()).expect("a capture");
        prop_assert_eq!(capture.views.len(), paths.len());
        let poses = given(&capture).expect("poses");
        prop_assert_eq!(poses.views.len(), known.len());
        for view in &capture.views {
            let bytes = fs::read(&view.file).expect("read");
            let number = (0..paths.len()).find(|&n| photograph(n) == bytes).expect("known");
            let posed = poses.views.iter().find(|posed| posed.name == view.name);
            prop_assert_eq!(posed.is_some(), number < known.len(), "{}", view.path);
            let right = camera(number).world_to_camera;
            prop_assert!(
                posed.is_none_or(|p| p.camera.world_to_camera.abs_diff_eq(right, 1e-9)),
                "{}", view.path
            );
        }
    }
}
