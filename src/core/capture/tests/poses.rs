//! Which of a capture's files give its poses.

use super::*;

const CAMERAS: &[u8] = b"1 PINHOLE 96 64 80 80 48 32\n";

/// A text model of photographs of these names.
fn model(names: &[&str]) -> Vec<u8> {
    let lines = names.iter().zip(1..);
    let lines = lines.map(|(name, id)| format!("{id} 1 0 0 0 0 0 {id} 1 {name}\n\n"));
    lines.collect::<String>().into_bytes()
}

fn with(more: &[(&str, Vec<u8>)]) -> Capture {
    let photographs = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"];
    let photographs = photographs.map(|name| format!("images/{name}"));
    let mut files: Vec<(&str, Vec<u8>)> = { photographs.iter().zip(1..) }
        .map(|(name, seed)| (name.as_str(), jpeg(seed)))
        .collect();
    files.extend(more.iter().cloned());
    open_folder(&files).expect("a capture")
}

fn model_of(capture: &Capture) -> &Path {
    match &capture.poses {
        Some(GivenPosesFile::ColmapModel(path)) => path,
        other => panic!("{other:?}"),
    }
}

#[test]
fn of_several_models_the_one_of_most_photographs_is_taken_and_named() {
    let (all, two) = (["a.jpg", "b.jpg", "c.jpg"], ["a.jpg", "b.jpg"]);
    // More images, but not of these photographs.
    let strangers = ["u.jpg", "v.jpg", "w.jpg", "x.jpg", "y.jpg"];
    for (folders, taken) in [
        ([("sparse/0", &two[..]), ("sparse/1", &all[..])], "sparse/1"),
        ([("sparse/0", &all), ("sparse/1", &all)], "sparse/0"),
        ([("sparse/0", &strangers), ("sparse/2", &two)], "sparse/2"),
        (
            [("sparse", &two), ("colmap/sparse/0", &all)],
            "colmap/sparse/0",
        ),
        ([("dense/sparse", &all), ("sparse/0", &two)], "dense/sparse"),
    ] {
        let mut files = Vec::new();
        for (folder, names) in folders {
            files.push((format!("{folder}/cameras.txt"), CAMERAS.to_vec()));
            files.push((format!("{folder}/images.txt"), model(names)));
        }
        let files: Vec<_> = { files.iter() }
            .map(|(name, bytes)| (&**name, bytes.clone()))
            .collect();
        let capture = with(&files);
        assert!(
            model_of(&capture).ends_with(taken),
            "{taken}: {:?}",
            capture.poses
        );
        let said = |warning: &CaptureWarning| {
            warning.code == "models" && warning.message.contains(&format!("models {taken} is"))
        };
        assert!(capture.warnings.iter().any(said), "{:?}", capture.warnings);
    }
}

#[test]
fn a_model_that_cannot_be_read_is_not_taken_in_place_of_one_that_can() {
    let capture = with(&[
        ("sparse/0/cameras.txt", b"1 PINHOLE 96\n".to_vec()),
        (
            "sparse/0/images.txt",
            model(&["a.jpg", "b.jpg", "c.jpg", "d.jpg"]),
        ),
        ("sparse/1/cameras.txt", CAMERAS.to_vec()),
        ("sparse/1/images.txt", model(&["a.jpg", "b.jpg", "c.jpg"])),
    ]);
    assert!(model_of(&capture).ends_with("sparse/1"));
    let said = |warning: &CaptureWarning| warning.message.contains("sparse/0 cannot be read");
    assert!(capture.warnings.iter().any(said), "{:?}", capture.warnings);
}

#[test]
fn a_model_alone_is_taken_without_a_word_wherever_it_lies() {
    for folder in [
        "sparse/0/",
        "sparse/7/",
        "sparse/",
        "colmap/sparse/0/",
        "dense/sparse/",
        "",
    ] {
        let (cameras, images) = (
            format!("{folder}cameras.bin"),
            format!("{folder}images.bin"),
        );
        let capture = with(&[(&cameras, b"x".to_vec()), (&images, b"x".to_vec())]);
        assert!(
            model_of(&capture).ends_with(folder.trim_end_matches('/')),
            "{folder}"
        );
        assert!(
            capture
                .warnings
                .iter()
                .all(|warning| warning.code != "models")
        );
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
    let Some(GivenPosesFile::Transforms(file)) = &capture.poses else {
        panic!("{:?}", capture.poses);
    };
    assert!(file.ends_with("transforms_train.json"));
    assert_ne!(
        open(b"z").fingerprint,
        capture.fingerprint,
        "the test split counts, too"
    );
}
