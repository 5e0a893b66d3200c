//! Which files of a capture supply its poses.

use super::*;

const CAMERAS: &[u8] = b"1 PINHOLE 96 64 80 80 48 32\n";

/// A text model of photographs with these names.
fn model(names: &[&str]) -> Vec<u8> {
    let lines = names.iter().zip(1..);
    let lines = lines.map(|(name, id)| format!("{id} 1 0 0 0 0 0 {id} 1 {name}\n\n"));
    lines.collect::<String>().into_bytes()
}

fn with(more: &[(&str, Vec<u8>)]) -> Capture {
    let photographs = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"];
    let photographs = photographs.map(|name| format!("images/{name}"));
    let mut files: Vec<(&str, Vec<u8>)> =
        { photographs.iter().zip(1..) }.map(|(name, seed)| (name.as_str(), jpeg(seed))).collect();
    files.extend(more.iter().cloned());
    open_folder(&files).expect("a capture")
}

fn file_of(capture: &Capture) -> Option<&GivenPosesFile> {
    capture.poses.as_ref().map(|poses| &poses.file)
}

fn model_of(capture: &Capture) -> &Path {
    match file_of(capture) {
        Some(GivenPosesFile::ColmapModel(path)) => path,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_model_with_most_photographs_is_used_and_named() {
    let (all, two) = (["a.jpg", "b.jpg", "c.jpg"], ["a.jpg", "b.jpg"]);
    // More images, but not of these photographs.
    let strangers = ["u.jpg", "v.jpg", "w.jpg", "x.jpg", "y.jpg"];
    for (folders, taken) in [
        ([("sparse/0", &two[..]), ("sparse/1", &all[..])], "sparse/1"),
        ([("sparse/0", &all), ("sparse/1", &all)], "sparse/0"),
        ([("sparse/0", &strangers), ("sparse/2", &two)], "sparse/2"),
        ([("sparse", &two), ("colmap/sparse/0", &all)], "colmap/sparse/0"),
        ([("dense/sparse", &all), ("sparse/0", &two)], "dense/sparse"),
    ] {
        let mut files = Vec::new();
        for (folder, names) in folders {
            files.push((format!("{folder}/cameras.txt"), CAMERAS.to_vec()));
            files.push((format!("{folder}/images.txt"), model(names)));
        }
        let files: Vec<_> =
            { files.iter() }.map(|(name, bytes)| (&**name, bytes.clone())).collect();
        let capture = with(&files);
        assert!(model_of(&capture).ends_with(taken), "{taken}: {:?}", capture.poses);
        let mentions = |warning: &CaptureWarning| {
            warning.code == "models" && warning.message.contains(&format!("of {taken} are taken"))
        };
        assert!(capture.warnings.iter().any(mentions), "{:?}", capture.warnings);
    }
}

#[test]
fn an_unreadable_model_does_not_replace_a_readable_one() {
    let capture = with(&[
        ("sparse/0/cameras.txt", b"1 PINHOLE 96\n".to_vec()),
        ("sparse/0/images.txt", model(&["a.jpg", "b.jpg", "c.jpg", "d.jpg"])),
        ("sparse/1/cameras.txt", CAMERAS.to_vec()),
        ("sparse/1/images.txt", model(&["a.jpg", "b.jpg", "c.jpg"])),
    ]);
    assert!(model_of(&capture).ends_with("sparse/1"));
    let mentions = |warning: &CaptureWarning| warning.message.contains("sparse/0 cannot be read");
    assert!(capture.warnings.iter().any(mentions), "{:?}", capture.warnings);
}

#[test]
fn a_single_model_is_used_without_a_warning_wherever_it_is() {
    for folder in ["sparse/0/", "sparse/7/", "sparse/", "colmap/sparse/0/", "dense/sparse/", ""] {
        let (cameras, images) = (format!("{folder}cameras.bin"), format!("{folder}images.bin"));
        let capture = with(&[(&cameras, b"x".to_vec()), (&images, b"x".to_vec())]);
        assert!(model_of(&capture).ends_with(folder.trim_end_matches('/')), "{folder}");
        assert!(capture.warnings.iter().all(|warning| warning.code != "models"));
    }
}

#[test]
fn low_light_sets_have_their_photographs_in_low_and_the_truth_in_high() {
    let bright = |seed| {
        let image = picture(seed, 96, 64);
        image.encode(EncodeFormat::Png).expect("encoded")
    };
    let open = |test: &[u8]| {
        open_folder(&[
            ("low/1.png", jpeg(1)),
            ("low/2.png", jpeg(2)),
            ("low/3.png", jpeg(3)),
            ("high/2.png", bright(9)),
            ("transforms_train.json", b"x".to_vec()),
            ("transforms_test.json", test.to_vec()),
        ])
        .expect("a capture")
    };
    let capture = open(b"y");
    let names: Vec<_> = capture.views.iter().map(|view| &*view.name).collect();
    assert_eq!(names, ["1", "2", "3"]);
    let truths: Vec<bool> = capture.views.iter().map(|view| view.gt.is_some()).collect();
    assert_eq!(truths, [false, true, false]);
    let Some(GivenPosesFile::Transforms(file)) = file_of(&capture) else {
        panic!("{:?}", capture.poses);
    };
    assert!(file.ends_with("transforms_train.json"));
    assert_ne!(open(b"z").fingerprint, capture.fingerprint, "the test split counts, too");
}

#[test]
fn poses_in_other_folders_are_used_and_named() {
    let all = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"];
    for folder in ["colmap_text", "images", "dslr_calibration", "export/model/0"] {
        let (cameras, images) = (format!("{folder}/Cameras.txt"), format!("{folder}/images.txt"));
        let capture = with(&[(&cameras, CAMERAS.to_vec()), (&images, model(&all))]);
        assert!(model_of(&capture).ends_with(folder), "{:?}", capture.poses);
        let mentions = |w: &CaptureWarning| w.message.contains(&format!("of {folder} are taken"));
        assert!(capture.warnings.iter().any(mentions), "{:?}", capture.warnings);
    }
    let transforms = transforms(&all.map(|name| format!("../images/{name}")));
    let capture = with(&[("nerf/transforms.json", transforms)]);
    assert!(matches!(
        file_of(&capture),
        Some(GivenPosesFile::Transforms(file)) if file.ends_with("nerf/transforms.json")
    ));
}

/// A `transforms.json` for photographs with these names.
fn transforms(names: &[String]) -> Vec<u8> {
    let one = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
    let frame = |name| serde_json::json!({ "file_path": name, "transform_matrix": one });
    let frames: Vec<_> = names.iter().map(frame).collect();
    let file = serde_json::json!({ "w": 96, "h": 64, "fl_x": 80, "frames": frames });
    file.to_string().into_bytes()
}

#[test]
fn unused_poses_are_reported() {
    for (files, words) in [
        (
            vec![("sparse/0/images.txt", model(&["a.jpg"]))],
            "no poses are read from sparse/0/images.txt: a COLMAP model is `cameras` and `images`",
        ),
        (
            vec![
                ("undistorted/cameras.txt", CAMERAS.to_vec()),
                ("undistorted/images.txt", model(&["a.png", "b.png", "c.png"])),
                ("undistorted/a.png", jpeg(7)),
                ("undistorted/b.png", jpeg(8)),
                ("undistorted/c.png", jpeg(9)),
            ],
            "poses beside other pictures are those of them",
        ),
        (
            vec![
                ("old/cameras.txt", CAMERAS.to_vec()),
                ("old/images.txt", model(&["u.jpg", "v.jpg", "w.jpg"])),
                ("other/transforms.json", b"{".to_vec()),
            ],
            "old 0, other/transforms.json cannot be read",
        ),
    ] {
        let capture = with(&files);
        assert_eq!(capture.poses, None);
        let mentions = |w: &CaptureWarning| w.code == "poses_unused" && w.message.contains(words);
        assert!(capture.warnings.iter().any(mentions), "{:?}", capture.warnings);
    }
}

#[test]
fn poses_with_most_photographs_are_used_in_any_format() {
    let all = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"];
    let capture = with(&[
        ("sparse/0/cameras.txt", CAMERAS.to_vec()),
        ("sparse/0/images.txt", model(&all[..3])),
        ("transforms.json", transforms(&all.map(|name| format!("images/{name}")))),
    ]);
    assert!(matches!(file_of(&capture), Some(GivenPosesFile::Transforms(_))));
    let mentions = |w: &CaptureWarning| w.message.contains("sparse/0 3, transforms.json 4");
    assert!(capture.warnings.iter().any(mentions), "{:?}", capture.warnings);
}

#[test]
fn poses_beside_the_photographs_take_precedence() {
    let names = ["a.jpg", "b.jpg", "c.jpg"];
    let mut files: Vec<(String, Vec<u8>)> = { names.iter().zip(1..) }
        .map(|(name, seed)| (format!("dense/images/{name}"), jpeg(seed)))
        .collect();
    for folder in ["sparse/0", "dense/sparse"] {
        files.push((format!("{folder}/cameras.txt"), CAMERAS.to_vec()));
        files.push((format!("{folder}/images.txt"), model(&names)));
    }
    let files: Vec<_> = { files.iter() }.map(|(name, bytes)| (&**name, bytes.clone())).collect();
    let capture = open_folder(&files).expect("a capture");
    assert!(model_of(&capture).ends_with("dense/sparse"), "{:?}", capture.poses);
}

#[test]
fn pictures_named_by_poses_are_read_instead_of_their_namesakes() {
    let names = ["a.jpg", "b.jpg", "c.jpg"];
    let files: Vec<(String, Vec<u8>)> = { names.iter().zip(1..) }
        .flat_map(|(name, seed)| {
            let images = (format!("images/{name}"), jpeg(seed));
            let copies = (format!("images_2/{name}"), jpeg(seed + 20));
            [images, copies, (format!("dark/{name}"), jpeg(seed + 10))]
        })
        .collect();
    let read_from = |folder: &str, name: &dyn Fn(&str) -> String| {
        let mut files = files.clone();
        files.push(("transforms.json".to_owned(), transforms(&names.map(name))));
        let files: Vec<_> = { files.iter() }.map(|(name, b)| (&**name, b.clone())).collect();
        let capture = open_folder(&files).expect("a capture");
        let paths: Vec<&str> = capture.photographs.iter().map(PhotoPath::as_str).collect();
        assert_eq!(paths, names, "{folder}");
        let lies = |view: &CaptureView| view.file.parent().is_some_and(|f| f.ends_with(folder));
        assert!(capture.views.iter().all(lies), "{folder}: {:?}", capture.views);
    };
    read_from("dark", &|name| format!("./dark/{name}"));
    read_from("images", &|name| format!("images/{name}"));
    read_from("images", &|name| format!("images_2/{name}"));
    read_from("images", &|name| name.to_owned());
}

#[test]
fn poses_of_other_programs_are_reported_whatever_their_file_name() {
    let warnings_of = |files: &[(&str, &str)]| -> Vec<String> {
        let files: Vec<_> =
            { files.iter() }.map(|(name, text)| (*name, text.as_bytes().to_vec())).collect();
        let warnings = with(&files).warnings.into_iter();
        let unused = warnings.filter(|warning| warning.code == "poses_unused");
        unused.map(|warning| warning.message).collect()
    };
    let metashape = "<?xml version=\"1.0\"?>\r\n<document version=\"2.0.0\">\r\n<chunk label=\"1\">\
                     <sensors/><cameras><camera id=\"0\" label=\"a\"></camera></cameras>";
    let xmp = "<x:xmpmeta><rdf:Description xcr:Version=\"3\"><xcr:Rotation>1 0</xcr:Rotation>";
    for (path, text, program) in [
        ("scene_cameras.xml", metashape, "Metashape"),
        ("blocks.xml", "<BlocksExchange version=\"3.2\"><Photo><Pose>", "ContextCapture"),
        ("images/a.xmp", xmp, "RealityScan"),
        ("registration.csv", "#name,x,y,alt,heading,pitch,roll\na.jpg,1,2,3\n", "RealityScan"),
        ("scene.out", "# Bundle file v0.3\n12 0\n", "Bundler"),
        ("scene.nvm", "NVM_V3\n\n12\n", "VisualSFM"),
        ("my.json", r#"{"sfm_data_version": "0.3", "views": [], "extrinsics": []}"#, "OpenMVG"),
        ("a.sfm", r#"{"views": [{"viewId": "1"}], "poses": []}"#, "Meshroom"),
        ("rec.json", r#"[{"cameras": {}, "shots": {"a.jpg": {"rotation": []}}}]"#, "OpenSfM"),
        ("cameras/17.json", r#"{"t_00": 1, "t_23": 0}"#, "Polycam"),
        ("metadata.json", r#"{"h": 64, "K": [80, 0], "poses": [[0, 0, 0, 1]]}"#, "Record3D"),
        ("input.txt", "# Image list with two lines of data per image:\n", "cameras.txt"),
        ("pose/0001.txt", "1 0 0 0", "NSVF"),
    ] {
        let warnings = warnings_of(&[(path, text)]);
        let is_reported =
            warnings.len() == 1 && warnings[0].starts_with(path) && warnings[0].contains(program);
        assert!(is_reported, "{path}: {warnings:?}");
    }
    let sidecars =
        warnings_of(&[("images/a.xmp", xmp), ("images/b.xmp", xmp), ("s.xml", metashape)]);
    assert!(sidecars[0].starts_with("s.xml holds poses"), "{sidecars:?}");
    assert!(sidecars[1].starts_with("images/a.xmp and 1 more files hold"), "{sidecars:?}");
    let lightroom = "<x:xmpmeta><rdf:Description crs:Exposure2012=\"0.5\"/>";
    for (path, text) in [
        ("pose/0001.jpg", "{}"),
        ("notes.txt", "cameras, poses and frames"),
        ("a.xmp", lightroom),
        ("cameras.xml", "<html></html>"),
        ("metadata.json", r#"{"title": "a walk"}"#),
    ] {
        assert_eq!(warnings_of(&[(path, text)]), [""; 0], "{path}");
    }
    let utf16: Vec<u8> = { "\u{feff}".encode_utf16().chain(metashape.encode_utf16()) }
        .flat_map(u16::to_le_bytes)
        .collect();
    let mentions = |w: &CaptureWarning| w.message.starts_with("wide.xml holds poses");
    assert!(with(&[("wide.xml", utf16)]).warnings.iter().any(mentions));
}

#[test]
fn transforms_under_another_name_are_used() {
    let names = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"].map(|name| format!("images/{name}"));
    for path in ["transforms_undistorted.json", "nerf/export-2.JSON", "images/frames.json"] {
        let capture = with(&[(path, transforms(&names))]);
        let taken = file_of(&capture).map(GivenPosesFile::path);
        assert!(taken.is_some_and(|taken| taken.ends_with(path)), "{path}: {:?}", capture.warnings);
        let mentions = |w: &CaptureWarning| w.message.contains(&format!("of {path} are taken"));
        assert!(capture.warnings.iter().any(mentions), "{path}: {:?}", capture.warnings);
    }
    // Files with a program's own name come first.
    let capture = with(&[("transforms.json", transforms(&names)), ("a.json", transforms(&names))]);
    let taken = file_of(&capture).expect("poses").path();
    assert!(taken.ends_with("transforms.json"));
}
