//! Where photographs are found, and that each keeps its own path and pose.

use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::camera::{Camera, Intrinsics};
use crate::image::Linear;
use crate::image::dng::{self, Sensor};
use crate::poses::bounds::{BoundedCamera, write_poses_bounds};
use crate::poses::model::SparseModel;

/// The camera of the photograph with this number.
fn camera(number: usize) -> Camera {
    let k = Intrinsics { width: 96, height: 64, fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };
    let eye = DVec3::new(number as f64, 0.25, -4.0);
    Camera::look_at(k, eye, DVec3::new(0.5, 0.0, 0.0), DVec3::Y)
}

/// The text files of a model with these names, each with the camera of its number.
fn model(names: impl IntoIterator<Item = (usize, String)>) -> Vec<(String, Vec<u8>)> {
    let views = names.into_iter().map(|(number, name)| (name, camera(number)));
    let model = SparseModel::of_views(views, [([0.0, 0.0, 1.0], [9, 9, 9])]);
    let files = model.text_files().into_iter();
    files.map(|(name, text)| (format!("sparse/0/{name}"), text.into_bytes())).collect()
}

fn given(capture: &Capture) -> &PlacedPoses {
    match &capture.poses.as_ref().expect("poses").placement {
        Placement::Placed(placed) => placed,
        unusable @ Placement::Unusable { .. } => panic!("{unusable:?}"),
    }
}

/// Opens these files as a folder and as a zip, and passes each result to `look`.
fn both(files: &[(String, Vec<u8>)], look: impl Fn(Result<Capture, CaptureError>)) {
    let files: Vec<(&str, Vec<u8>)> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    let home = folder(&files);
    look(Capture::open(&home.path().join("capture"), &home.path().join("scratch")));
    let zip = home.path().join("capture.zip");
    let pack = |writer: &mut ZipWriter<Cursor<Vec<u8>>>| {
        files.iter().for_each(|(name, bytes)| add(writer, name, bytes));
    };
    fs::write(&zip, zipped(&pack)).expect("written");
    look(Capture::open(&zip, &home.path().join("scratch")));
}

/// Photographs with these paths, numbered.
fn photographs(paths: &[&str]) -> Vec<(String, Vec<u8>)> {
    paths.iter().enumerate().map(|(i, path)| ((*path).to_owned(), jpeg(i))).collect()
}

/// The paths below their folder, and the warnings other than few photographs or unread poses.
fn read(files: &[(String, Vec<u8>)]) -> (Vec<String>, Vec<String>) {
    let files: Vec<(&str, Vec<u8>)> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())).collect();
    let capture = open_folder(&files).expect("a capture");
    let is_beside = |code: &str| ["few", "poses_unused"].contains(&code);
    let warnings = { capture.warnings.into_iter() }.filter(|w| !is_beside(&w.code));
    (
        capture.photographs.iter().map(ToString::to_string).collect(),
        warnings.map(|warning| warning.message).collect(),
    )
}

#[test]
fn photographs_are_found_where_programs_and_cameras_put_them() {
    let flat = ["0.jpg", "1.jpg", "2.jpg"];
    let nested = ["cam0/0.jpg", "cam0/1.jpg", "cam1/0.jpg"];
    let split = ["test/r_0.jpg", "train/r_0.jpg", "train/r_1.jpg"];
    let card = ["100CANON/0.jpg", "100CANON/1.jpg", "101CANON/0.jpg"];
    let cases: [(&str, [&str; 3], &[&str]); 11] = [
        ("pictures", flat, &["transforms.json"]),
        ("images_4", flat, &["poses_bounds.npy"]),
        ("images", flat, &[]),
        ("images", nested, &["notes.txt", "transforms.json"]),
        ("rgb", flat, &["depth/0.png", "depth/1.png", "transforms.json"]),
        ("", split, &["transforms.json"]),
        ("", split, &[]),
        ("", nested, &["sparse/0/readme.txt"]),
        ("DCIM", card, &["MISC/list.txt"]),
        ("keyframes/images", flat, &["keyframes/depth/0.png", "keyframes/cameras/0.json"]),
        ("my scene/images", nested, &["notes.txt", "my scene/transforms.json"]),
    ];
    for (folder, paths, others) in cases {
        let inside = |path: &&str| PhotoPath::new(path).inside(folder).to_string();
        let paths: Vec<String> = paths.iter().map(inside).collect();
        let mut files = photographs(&paths.iter().map(String::as_str).collect::<Vec<_>>());
        files.extend(others.iter().map(|name| ((*name).to_owned(), jpeg(50))));
        let expected: Vec<String> = paths
            .iter()
            .map(|p| p.trim_start_matches(folder).trim_start_matches('/').into())
            .collect();
        assert_eq!(read(&files), (expected, Vec::new()), "{folder} {others:?}");
    }
}

#[test]
fn unread_pictures_are_reported() {
    let inside = photographs(&["images/0.jpg", "images/1.jpg", "images/2.jpg", "cover.jpg"]);
    let (paths, warnings) = read(&inside);
    assert_eq!(paths, ["0.jpg", "1.jpg", "2.jpg"]);
    assert!(warnings[0].contains("images/") && warnings[0].contains("(1 picture)"), "{warnings:?}");
    let beside = photographs(&["0.jpg", "1.jpg", "2.jpg", "edited/a.jpg", "edited/b.jpg"]);
    let (paths, warnings) = read(&beside);
    assert_eq!(paths.len(), 3);
    assert!(warnings[0].contains("edited/ (2 pictures)"), "{warnings:?}");
    let cover = photographs(&["a walk/0.jpg", "a walk/1.jpg", "a walk/2.jpg", "cover.jpg"]);
    let (paths, warnings) = read(&cover);
    assert_eq!(paths, ["a walk/0.jpg", "a walk/1.jpg", "a walk/2.jpg"]);
    assert_eq!(
        warnings[0],
        "photographs are read from a walk/ (3 pictures); not from the capture's own folder (1 \
         picture): move them there if they belong to it"
    );
}

#[test]
fn captures_with_several_scenes_or_none_are_refused_with_their_folders() {
    let refused = |files: &[(String, Vec<u8>)]| {
        let errors = std::cell::RefCell::new(Vec::new());
        both(files, |opened| {
            let error = opened.expect_err("no capture");
            errors.borrow_mut().push(format!("{error}; {}", error.hint()));
        });
        let errors = errors.into_inner();
        assert_eq!(errors[0], errors[1]);
        assert!(!errors[0].contains("0 of 0"), "{}", errors[0]);
        errors[0].clone()
    };
    let albums = photographs(&["garden/0.jpg", "garden/1.jpg", "kitchen/0.jpg"]);
    let error = refused(&albums);
    assert!(error.contains("garden/ (2 pictures) and kitchen/ (1 picture)"), "{error}");
    assert!(error.contains("into a folder images/"), "{error}");
    let scenes = photographs(&["a/images/0.jpg", "a/images/1.jpg", "b/images/0.jpg"]);
    assert!(refused(&scenes).contains("a/images/ (2"));
    let made = photographs(&["scan/depth/0.png", "scan/depth/1.png", "scan/notes.txt"]);
    assert!(refused(&made).contains("depth/ (2 pictures)"), "{}", refused(&made));
    assert!(refused(&photographs(&["notes.txt"])).contains("no photograph"));
    // Poses show that they are one scene.
    let mut posed = albums;
    posed.push(("transforms.json".to_owned(), b"{}".to_vec()));
    assert_eq!(read(&posed).0.len(), 3);
}

/// Whether an image matches a file with these bytes, to the precision of half floats.
fn is_prepared(image: &Image<Linear>, bytes: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("a");
    fs::write(&file, bytes).expect("written");
    let wanted = Image::load_light(&file, PREPARED_SIDE).expect("read");
    let mut pairs = image.data().iter().zip(wanted.data());
    pairs.all(|(a, b)| (a - b).abs() <= b / 2048.0 + 1e-6)
}

#[test]
fn ground_truth_has_the_same_folders_as_its_photographs() {
    let mut files = photographs(&["images/cam0/0.jpg", "images/cam1/0.jpg", "images/cam1/1.jpg"]);
    files.extend(photographs(&["gt/cam0/0.png", "gt/cam1/0.png", "gt/cam1/1.png"]));
    both(&files, |opened| {
        let capture = opened.expect("a capture");
        for (number, view) in capture.views.iter().enumerate() {
            let truth = view.gt.as_ref().expect("truth").load().expect("read");
            assert!(is_prepared(&truth, &jpeg(number)), "{}", view.path);
        }
        let names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
        assert_eq!(names, ["cam0_0", "cam1_0", "cam1_1"]);
    });
}

#[test]
fn rows_of_poses_bounds_belong_to_all_photographs_in_byte_order() {
    // In byte order, with the number of each row's camera.
    let names = ["B.jpg", "a_1.jpg", "a_10.jpg", "a_2.jpg", "broken_3.jpg", "c_é.jpg"];
    let mut files: Vec<(String, Vec<u8>)> = photographs(&names);
    files[4].1.truncate(300);
    let row = |number| BoundedCamera { camera: camera(number), near: 1.0, far: 9.0 };
    let home = tempfile::tempdir().expect("a temporary folder");
    let bounds = home.path().join("poses_bounds.npy");
    write_poses_bounds(&bounds, &[0, 1, 2, 3, 4, 5].map(row)).expect("written");
    files.push(("poses_bounds.npy".to_owned(), fs::read(&bounds).expect("read")));
    both(&files, |opened| {
        let capture = opened.expect("a capture");
        let poses = given(&capture);
        assert_eq!(poses.views.len(), 5);
        for (view, posed) in capture.views.iter().zip(&poses.views) {
            let number = names.iter().position(|n| *n == view.path.as_str()).expect("known");
            let (found, right) = (posed.camera.world_to_camera, camera(number).world_to_camera);
            assert!(found.abs_diff_eq(right, 1e-9), "{}", view.path);
        }
    });
}

#[test]
fn scenes_with_separate_poses_are_not_one_scene() {
    for (scenes, poses) in [
        (["a/images", "b/images"], "transforms.json"),
        (["tandt/train/images", "tandt/truck/images"], "../sparse/0/images.bin"),
        (["garden", "kitchen"], "transforms.json"),
    ] {
        let mut files = Vec::new();
        for (number, scene) in scenes.iter().enumerate() {
            files.extend((0..3).map(|i| (format!("{scene}/{i}.jpg"), jpeg(3 * number + i))));
            let file = PhotoPath::new(&format!("{scene}/{poses}")).to_string();
            files.push((file, b"x".to_vec()));
        }
        both(&files, |opened| {
            let error = opened.expect_err("several scenes");
            assert!(matches!(error, CaptureError::Scattered { .. }), "{error}");
        });
    }
}

#[test]
fn a_few_pictures_in_images_give_way_to_photographs_elsewhere() {
    for (others, expected) in [("photos/", "photos/ (3"), ("", "own folder (3"), ("a/", "a/ (3")] {
        let paths = ["0.jpg", "1.jpg", "2.jpg"].map(|name| format!("{others}{name}"));
        let mut files = photographs(&paths.each_ref().map(String::as_str));
        files.push(("images/logo.jpg".to_owned(), jpeg(9)));
        if others == "a/" {
            both(&files, |opened| {
                let error = opened.expect_err("scattered").to_string();
                assert!(error.contains("a/ (3 pictures) and images/ (1"), "{error}");
            });
            continue;
        }
        let (found, warnings) = read(&files);
        assert_eq!(found, ["0.jpg", "1.jpg", "2.jpg"]);
        assert!(
            warnings[0].contains(expected) && warnings[0].contains("not from images/ (1 picture)"),
            "{warnings:?}"
        );
    }
}

#[test]
fn system_files_are_ignored_also_under_stored_names() {
    let mut files = photographs(&["images/0.jpg", "images/1.jpg", "images/2.jpg"]);
    let traces = [
        "images/@eaDir/0.jpg/SYNOPHOTO_THUMB_XL.jpg",
        "images/._0.jpg",
        "__MACOSX/images/._0.jpg",
        "$RECYCLE.BIN/S-1/$R0.jpg",
        ".thumbnails/0.jpg",
    ];
    files.extend(traces.iter().zip(9..).map(|(name, seed)| ((*name).to_owned(), jpeg(seed))));
    both(&files, |opened| {
        let capture = opened.expect("a capture");
        assert_eq!(capture.assessments.len(), 3);
        assert!(capture.warnings.iter().all(|w| w.code == "few"), "{:?}", capture.warnings);
    });
    // As the service stores them: the original names are in a file beside them.
    let names: serde_json::Map<_, _> = { files.iter().enumerate() }
        .map(|(i, (name, _))| (format!("images/{i}.jpg"), name.as_str().into()))
        .collect();
    let mut stored: Vec<(String, Vec<u8>)> = { files.into_iter().enumerate() }
        .map(|(i, (_, bytes))| (format!("images/{i}.jpg"), bytes))
        .collect();
    stored.push((NAMES.to_owned(), serde_json::to_vec(&names).expect("written")));
    assert_eq!(read(&stored), (["0.jpg", "1.jpg", "2.jpg"].map(str::to_owned).to_vec(), vec![]));
}

#[test]
fn photographs_with_the_same_name_get_distinct_names() {
    // As the service stores them when a phone names every file `image.jpg`.
    let sent = ["image.jpg", "image.jpg", "image-2.jpg", "image.jpg"];
    let stored = ["image.jpg", "image-2.jpg", "image-2-2.jpg", "image-3.jpg"];
    let names: serde_json::Map<_, _> = { stored.iter().zip(sent) }
        .map(|(stored, sent)| (format!("images/{stored}"), sent.into()))
        .collect();
    let mut files: Vec<(String, Vec<u8>)> = { stored.iter().enumerate() }
        .map(|(i, stored)| (format!("images/{stored}"), jpeg(i)))
        .collect();
    files.push((NAMES.to_owned(), serde_json::to_vec(&names).expect("written")));
    let home = folder(&files.iter().map(|(n, b)| (n.as_str(), b.clone())).collect::<Vec<_>>());
    let seen = std::sync::Mutex::new(std::collections::BTreeMap::new());
    let tell = |look: Look<'_>| {
        if let Look::Seen(name, file, _) = look {
            let file = file.file_name().expect("a name").to_string_lossy().into_owned();
            let before = seen.lock().expect("unpoisoned").insert(name.to_owned(), file);
            assert_eq!(before, None, "two are called {name}");
        }
    };
    let watch = Watch { tell: &tell, ..Watch::silent() };
    let out = home.path().join("out");
    let capture = Capture::prepare(&home.path().join("capture"), &out, ASSESSED_SIDE, &watch);
    let capture = capture.expect("a capture");
    let names: Vec<&str> = capture.assessments.iter().map(|one| one.name.as_str()).collect();
    assert_eq!(
        names,
        ["image-2.jpg", "image.jpg", "image-3.jpg", "image-4.jpg"],
        "the second image.jpg is not taken for image-2.jpg"
    );
    let seen = seen.into_inner().expect("unpoisoned");
    for (name, file) in [
        ("image.jpg", "image.jpg"),
        ("image-2.jpg", "image-2-2.jpg"),
        ("image-3.jpg", "image-2.jpg"),
        ("image-4.jpg", "image-3.jpg"),
    ] {
        assert_eq!(seen.get(name).map(String::as_str), Some(file), "{name}");
    }
    let views = view_names(names.into_iter());
    let opened = Capture::open(&home.path().join("capture"), &home.path().join("scratch"));
    let opened = opened.expect("a capture");
    assert!(opened.views.iter().map(|view| &view.name).eq(&views), "{views:?}");
}

/// Writes the files of a run with these options into this folder.
fn result(folder: &str) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<(String, Vec<u8>)> = { 0..3 }
        .flat_map(|i| ["inputs", "restored", "rounds/1/renders"].map(|f| format!("{f}/{i}.jpg")))
        .zip((50..).map(jpeg))
        .collect();
    files.push((
        "config.json".to_owned(),
        br#"{"pose_source": "auto", "lut_scope": "view", "deblur": "auto"}"#.to_vec(),
    ));
    files.push(("cameras.json".to_owned(), br#"[{"world_to_camera": []}]"#.to_vec()));
    files.into_iter().map(|(n, b)| (PhotoPath::new(&n).inside(folder).to_string(), b)).collect()
}

#[test]
fn results_of_fled_are_not_part_of_a_capture() {
    let evaluation = br#"{"training_views": 9, "tied_views": 9, "camera_error": 0.1}"#.to_vec();
    let report = br#"{"rounds": [{"gaussians": 9}], "registered": 9, "best_round": 1}"#.to_vec();
    for around in ["", "images/", "walk/"] {
        let names = ["0.jpg", "1.jpg", "2.jpg"].map(|name| format!("{around}{name}"));
        let own = photographs(&names.each_ref().map(String::as_str));
        let alone = |files: &[(String, Vec<u8>)]| {
            let fingerprint = std::cell::RefCell::new(Vec::new());
            both(files, |opened| {
                let capture = opened.expect("a capture");
                assert_eq!(capture.assessments.len(), 3, "{:?}", capture.assessments);
                let codes = capture.warnings.iter().map(|warning| warning.code.as_str());
                assert!(codes.eq(["few"]), "{:?}", capture.warnings);
                fingerprint.borrow_mut().push(capture.fingerprint);
            });
            fingerprint.into_inner()
        };
        let before = alone(&own);
        let judged =
            [("judged/evaluation.json", evaluation.clone()), ("judged/0.truth.jpg", jpeg(70))];
        let shown =
            [("demo/metrics.json", report.clone()), ("demo/capture/images/0.jpg", jpeg(71))];
        let others = judged.into_iter().chain(shown).map(|(name, bytes)| (name.to_owned(), bytes));
        let others: Vec<_> = others.collect();
        // The last two are in the folder of the photographs.
        for more in [result("result"), result("a/b"), others, result(""), result(around)] {
            assert_eq!(alone(&[own.clone(), more].concat()), before, "{around}");
        }
    }
    let error =
        open_folder(&result("").iter().map(|(n, b)| (n.as_str(), b.clone())).collect::<Vec<_>>());
    let error = error.expect_err("no photographs").to_string();
    assert!(error.contains("this folder holds a result of fled"), "{error}");
    // Files of the user that only share these names.
    let mut own = photographs(&["images/0.jpg", "images/1.jpg", "images/2.jpg"]);
    own.push(("images/config.json".to_owned(), br#"{"rounds": 3}"#.to_vec()));
    assert_eq!(read(&own).0.len(), 3);
}

/// A `transforms.json` for photographs with these names, for pictures of 96 px and this height.
fn transforms(names: &[&str], height: usize) -> Vec<u8> {
    let one = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
    let frame = |name| serde_json::json!({ "file_path": name, "transform_matrix": one });
    let frames: Vec<_> = names.iter().map(frame).collect();
    let file = serde_json::json!({ "w": 96, "h": height, "fl_x": 80, "frames": frames });
    file.to_string().into_bytes()
}

#[test]
fn of_two_versions_the_one_with_poses_is_read_and_the_other_named() {
    let names = ["0.jpg", "1.jpg", "2.jpg"];
    let set = |folder: &str, seed: usize, height: usize| -> Vec<(String, Vec<u8>)> {
        let picture = |at| picture(seed + at, 96, height).encode(EncodeFormat::Jpeg(90));
        let one = |(at, name): (usize, &str)| {
            (PhotoPath::new(name).inside(folder).to_string(), picture(at).expect("encoded"))
        };
        names.into_iter().enumerate().map(one).collect()
    };
    let (plain, undistorted) = ("resized_images", "resized_undistorted_images");
    let json = |path: &str, height| (path.to_owned(), transforms(&names, height));
    let colmap = || {
        let files = model(names.iter().enumerate().map(|(at, name)| (at, (*name).to_owned())));
        files.into_iter().map(|(n, b)| (n.replace("sparse/0", "colmap"), b)).collect::<Vec<_>>()
    };
    let both_poses =
        || vec![json("nerf/transforms.json", 64), json("nerf/transforms_undistorted.json", 64)];
    let cases = [
        // As in ScanNet++; a folder around the whole scene changes nothing.
        (plain, undistorted, 64, [colmap(), both_poses()].concat(), plain, "colmap"),
        (plain, undistorted, 64, both_poses(), plain, "nerf/transforms.json"),
        (plain, undistorted, 64, both_poses().split_off(1), undistorted, "undistorted.json"),
        // The sizes decide.
        ("before", "after", 80, vec![json("poses/a.json", 64)], "before", "poses/a.json"),
        ("before", "after", 80, vec![json("poses/a.json", 80)], "after", "poses/a.json"),
        // The names decide.
        ("", "edited", 64, colmap(), "", "colmap"),
    ];
    for (first, second, height, poses, taken, model) in cases {
        for around in ["", "scene/", "data/scene/"] {
            let mut files = [set(first, 0, 64), set(second, 20, height), poses.clone()].concat();
            files.iter_mut().for_each(|file| file.0.insert_str(0, around));
            if around.starts_with("data") {
                files.push(("data/scan/notes.pdf".to_owned(), b"%PDF".to_vec()));
                files.push(("data/scan/walk.mov".to_owned(), b"a video".to_vec()));
            }
            both(&files, |opened| {
                let capture = opened.expect("a capture");
                assert_eq!(capture.views.len(), 3, "{first} {second} {model} in {around}");
                let expected = if taken == first { 0 } else { 20 };
                for (at, view) in capture.views.iter().enumerate() {
                    let height = if expected == 0 { 64 } else { height };
                    let right = picture(expected + at, 96, height).encode(EncodeFormat::Jpeg(90));
                    let right = right.expect("encoded");
                    assert!(shows(view, &right), "{taken} of {first} and {second}");
                }
                let has = |code: &str, words: &str| {
                    let mut all = capture.warnings.iter();
                    all.any(|w| w.code == code && w.message.contains(words))
                };
                let other = if taken == first { second } else { first };
                assert!(has("elsewhere", other), "{other}: {:?}", capture.warnings);
                assert!(has("models", model), "{model}: {:?}", capture.warnings);
            });
        }
    }
}

#[test]
fn folders_with_the_same_names_are_parts_only_if_poses_name_them() {
    let names = ["a/0.jpg", "a/1.jpg", "a/2.jpg", "b/0.jpg", "b/1.jpg", "b/2.jpg"];
    let mut files = photographs(&names);
    files.push(("transforms.json".to_owned(), transforms(&names, 64)));
    both(&files, |opened| assert_eq!(opened.expect("a capture").views.len(), 6));
    files[6].1 = transforms(&["0.jpg", "1.jpg", "2.jpg"], 64);
    both(&files, |opened| {
        let error = opened.expect_err("two sets").to_string();
        assert!(error.contains("a/ (3 pictures) and b/ (3 pictures)"), "{error}");
    });
}

#[test]
fn of_two_files_of_one_exposure_one_is_used() {
    let png = |seed: usize| picture(seed, 96, 64).encode(EncodeFormat::Png).expect("encoded");
    let own = [("0.jpg", jpeg(0)), ("1.jpg", jpeg(1)), ("2.jpg", jpeg(2)), ("3.jpg", jpeg(3))];
    let open = |more: &[(&str, Vec<u8>)]| {
        let home = folder(&[&own[..], more].concat());
        let capture = Capture::open(&home.path().join("capture"), home.path());
        let capture = capture.expect("a capture");
        let used: Vec<&str> = capture.views.iter().map(|view| view.path.as_str()).collect();
        (used.join(" "), capture, home)
    };
    // Use the file that preserves more, or the one that the poses name.
    let (used, capture, _) = open(&[("0.PNG", png(0)), ("1.png", png(1))]);
    assert_eq!(used, "0.PNG 1.png 2.jpg 3.jpg");
    let listed = capture.assessments.iter().find(|one| one.name == "0.jpg").expect("listed");
    assert_eq!(listed.reason.as_deref(), Some("the same exposure as 0.PNG"));
    let poses = ("transforms.json", transforms(&["0.jpg", "1.png", "2.jpg", "3.jpg"], 64));
    let (used, ..) = open(&[("0.png", png(0)), ("1.png", png(1)), poses]);
    assert_eq!(used, "0.jpg 1.png 2.jpg 3.jpg");
    // Names without extensions refer to the exposure.
    let poses = ("transforms.json", transforms(&["0", "1", "2", "3"], 64));
    let (used, capture, _home) = open(&[("0.png", png(0)), ("1.png", png(1)), poses]);
    assert_eq!(used, "0.png 1.png 2.jpg 3.jpg");
    assert_eq!(given(&capture).views.len(), 4);
    // Under another name or in another folder it is still the same picture.
    let smooth = patches(1, 160, 0.6).resize_area(12, 12).resize_bilinear(160, 160);
    let saved = |format| smooth.encode(format).expect("encoded");
    let twins = [("4.jpg", saved(EncodeFormat::Jpeg(90))), ("a.png", saved(EncodeFormat::Png))];
    assert_eq!(open(&twins).0, "0.jpg 1.jpg 2.jpg 3.jpg a.png");
    // Photographs that share only a name.
    let (used, ..) = open(&[("0.png", png(10)), ("1.png", png(11))]);
    assert_eq!(used, "0.jpg 0.png 1.jpg 1.png 2.jpg 3.jpg");
}

/// A camera writes both. Raw files have one white balance, whatever each was shot with.
#[test]
fn of_a_raw_file_and_its_jpeg_the_raw_file_is_used() {
    let dng = |seed: usize, red: f64| {
        let light = patches(seed, 160, 0.6).to_linear();
        let at = |x: usize, y: usize| light.get(x, y).map(f64::from);
        dng::written(Sensor::Bayer, (160, 160), 1, [red, 1.0, 1.0], at)
    };
    let jpeg = patches(0, 160, 0.6).encode(EncodeFormat::Jpeg(90)).expect("encoded");
    let home = folder(&[
        ("a.jpg", jpeg),
        ("A.DNG", dng(0, 1.0)),
        ("b.dng", dng(1, 1.0)),
        ("c.dng", dng(2, 1.4)),
    ]);
    let capture = Capture::open(&home.path().join("capture"), home.path()).expect("a capture");
    let used: Vec<&str> = capture.views.iter().map(|view| view.path.as_str()).collect();
    assert_eq!(used, ["A.DNG", "b.dng", "c.dng"]);
    let listed = capture.assessments.iter().find(|one| one.name == "a.jpg").expect("listed");
    assert_eq!(listed.reason.as_deref(), Some("the same exposure as A.DNG"));
    let raw = capture.assessments.iter().find(|one| one.name == "c.dng").expect("listed");
    assert_eq!(raw.colours.as_deref(), Some("raw, Fled Test"));
    for (view, seed) in capture.views.iter().zip(0..) {
        let (found, wanted) =
            (view.prepared.load().expect("read"), patches(seed, 160, 0.6).to_linear());
        let mean = |image: &Image<Linear>| {
            [0, 1, 2]
                .map(|channel| image.plane(channel).iter().sum::<f32>() / image.pixels() as f32)
        };
        for (found, wanted) in mean(&found).into_iter().zip(mean(&wanted)) {
            assert!((found - wanted).abs() < 0.02, "{}: {found} for {wanted}", view.name);
        }
    }
}

#[test]
fn files_like_photographs_are_listed_with_advice() {
    let home = folder(&[("0.jpg", jpeg(0)), ("1.jpg", jpeg(1)), ("2.jpg", jpeg(2))]);
    let capture = home.path().join("capture");
    for (name, words) in [
        ("a.insp", "INSP photographs are not read"),
        ("b.gpr", "a raw file that is not read"),
        ("more.zip", "inner ZIP archives are not read: unpack it"),
        (".3.jpg.icloud", "iCloud's stand-in"),
    ] {
        fs::write(capture.join(name), b"II*\0").expect("written");
        let opened = Capture::open(&capture, home.path()).expect("a capture");
        let is_reported = |a: &Assessment| {
            a.name == name && a.reason.as_ref().is_some_and(|reason| reason.contains(words))
        };
        assert!(opened.assessments.iter().any(is_reported), "{:?}", opened.assessments);
        assert_eq!(opened.views.len(), 3, "{name}");
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("/nowhere/3.jpg", capture.join("3.jpg")).expect("linked");
        let opened = Capture::open(&capture, home.path()).expect("a capture");
        let is_reported = |a: &Assessment| a.reason.as_deref() == Some("a link that leads nowhere");
        assert!(opened.assessments.iter().any(is_reported), "{:?}", opened.assessments);
    }
}

#[test]
fn of_equal_pictures_the_original_is_kept() {
    let files = photographs(&["0.jpg", "1.jpg", "2.jpg"]);
    let copies = [("0 (1).jpg", 0), ("1 copy.jpg", 1), ("2 - Copy.jpg", 2)];
    let copies = copies.map(|(name, seed)| (name.to_owned(), jpeg(seed)));
    both(&[files, copies.to_vec()].concat(), |opened| {
        let capture = opened.expect("a capture");
        let paths: Vec<&str> = capture.views.iter().map(|view| view.path.as_str()).collect();
        assert_eq!(paths, ["0.jpg", "1.jpg", "2.jpg"]);
        let copy = capture.assessments.iter().find(|a| a.name == "1 copy.jpg").expect("listed");
        assert_eq!(copy.reason.as_deref(), Some("the same picture as 1.jpg"));
    });
}

#[test]
fn trainer_output_is_not_ground_truth() {
    let bright = |seed| picture(seed, 96, 64).encode(EncodeFormat::Png).expect("encoded");
    let mut files = photographs(&["images/0.jpg", "images/1.jpg", "images/2.jpg"]);
    files.push(("output/test/ours_30000/gt/0.png".to_owned(), bright(9)));
    both(&files, |opened| {
        let capture = opened.expect("a capture");
        assert!(capture.views.iter().all(|view| view.gt.is_none()));
    });
    files.push(("gt/1.png".to_owned(), bright(9)));
    both(&files, |opened| {
        let capture = opened.expect("a capture");
        let has: Vec<bool> = capture.views.iter().map(|view| view.gt.is_some()).collect();
        assert_eq!(has, [false, true, false]);
    });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    /// Whatever the names and folders of photographs, each has its own pose.
    #[test]
    fn every_photograph_keeps_its_own_pose(
        paths in prop::collection::hash_set(
            "((cam[01]|A|a|e\u{301}|b c)/){0,2}(DSC[ _])?[0-3aA]{1,2}\\.(jpg|JPG|jpeg)", 4..8),
        around in prop::sample::select(
            &["", "images/", "rgb/", "my scene/images/", "my scene/", "keyframes/images/"][..]),
        left_out in 0..8usize,
    ) {
        let paths: Vec<String> = paths.into_iter().collect();
        let known: Vec<(usize, String)> =
            paths.iter().cloned().enumerate().filter(|(at, _)| *at != left_out).collect();
        let mut files: Vec<(String, Vec<u8>)> = paths
            .iter()
            .enumerate()
            .map(|(number, path)| (format!("{around}{path}"), jpeg(number)))
            .collect();
        let wrapper = if around.starts_with("my") { "my scene/" } else { "" };
        files.extend(model(known.clone()).into_iter().map(|(n, b)| (format!("{wrapper}{n}"), b)));
        // The only folder is that of the photographs.
        let top = |path: &String| path.split_once('/').map(|(top, _)| PhotoPath::new(top));
        let first = top(&paths[0]).filter(|_| ["", "my scene/"].contains(&around));
        let is_only = |folder: &PhotoPath| {
            paths.iter().all(|path| top(path).as_ref() == Some(folder))
        };
        let only = first.filter(is_only).unwrap_or_default();
        both(&files, |opened| {
            let capture = opened.expect("a capture");
            assert_eq!(capture.views.len(), paths.len(), "{:?}", capture.warnings);
            let poses = given(&capture);
            assert_eq!(poses.views.len(), known.len());
            for view in &capture.views {
                let number = (0..paths.len()).find(|&n| shows(view, &jpeg(n))).expect("known");
                let own = PhotoPath::new(&paths[number]).below(only.as_str());
                assert_eq!(Some(&view.path), own.as_ref());
                let posed = poses.views.iter().find(|posed| posed.name == view.name);
                let right = |c: &Camera| c.world_to_camera.abs_diff_eq(
                    camera(number).world_to_camera, 1e-9);
                assert_eq!(posed.is_some(), number != left_out, "{}", view.path);
                assert!(posed.is_none_or(|posed| right(&posed.camera)), "{}", view.path);
            }
        });
    }
}
