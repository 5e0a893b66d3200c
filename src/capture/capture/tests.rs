//! Captures of every shape, good and bad.

mod masks;
mod places;
mod poses;
mod prepared;
mod watched;
mod zips;

use super::*;
use crate::image::{EncodeFormat, Image, Srgb};
use std::fs;
use std::io::{Cursor, Write};
use std::path::PathBuf;
use zip::write::{SimpleFileOptions, ZipWriter};

/// A picture with structure, different for each seed.
fn picture(seed: usize, width: usize, height: usize) -> Image<Srgb> {
    let value =
        |i: usize| ((i / 7 * 2_654_435_761 + seed * 40_503) >> 5 & 255) as f32 / 255.0 * 0.3;
    Image::from_planar(width, height, (0..3 * width * height).map(value).collect())
}

fn jpeg(seed: usize) -> Vec<u8> {
    picture(seed, 96, 64).encode(EncodeFormat::Jpeg(90)).expect("encoded")
}

/// A folder of files by relative path.
fn folder(files: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, bytes) in files {
        let path = folder.path().join("capture").join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, bytes).expect("written");
    }
    folder
}

fn open_folder(files: &[(&str, Vec<u8>)]) -> Result<Capture, CaptureError> {
    let folder = folder(files);
    Capture::open(&folder.path().join("capture"), &folder.path().join("scratch"))
}

type Packer<'a> = &'a dyn Fn(&mut ZipWriter<Cursor<Vec<u8>>>);

fn zipped(pack: Packer<'_>) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    pack(&mut writer);
    writer.finish().expect("packed").into_inner()
}

fn add(writer: &mut ZipWriter<Cursor<Vec<u8>>>, name: &str, bytes: &[u8]) {
    writer.start_file(name, SimpleFileOptions::default()).expect("started");
    writer.write_all(bytes).expect("packed");
}

/// Whether the prepared image of a view is that of this file.
fn shows(view: &CaptureView, file: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("picture");
    fs::write(&path, file).expect("written");
    let image = Image::load_light(&path, PREPARED_SIDE).expect("a picture");
    let prepared = view.prepared.load().expect("prepared");
    let (width, height) = (image.width(), image.height());
    let pairs = || image.data().iter().zip(prepared.data());
    (prepared.width(), prepared.height()) == (width, height)
        && pairs().all(|(a, b)| (a - b).abs() <= a.abs() / 1024.0 + 1e-6)
}

/// Opens a zip of these bytes; returns the outcome, and the zip and the files unpacked from it.
fn open_zip(bytes: &[u8]) -> (Result<Capture, CaptureError>, Vec<PathBuf>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("capture.zip");
    fs::write(&path, bytes).expect("written");
    let scratch = folder.path().join("scratch");
    fs::create_dir(&scratch).expect("made");
    let outcome = Capture::open(&path, &scratch);
    assert!(!scratch.join("prepared/.unpacked").exists());
    if outcome.is_ok() {
        archive::unpack(&path, &folder.path().join("unpacked")).expect("unpacked before");
    }
    let is_prepared = |path: &&PhotoPath| path.as_str().starts_with("scratch/prepared/");
    let left = entries::of_folder(folder.path()).expect("listed");
    let left = left.iter().map(|entry| &entry.path);
    let left = left.filter(|path| outcome.is_err() || !is_prepared(path));
    let left = left.map(|path| path.as_str().into()).collect();
    (outcome, left)
}

#[test]
fn photographs_are_found_in_the_root_or_images_also_inside_a_wrapper() {
    for prefix in ["", "images/", "my scene/", "my scene/images/"] {
        let names: Vec<String> = [10, 2, 1].iter().map(|i| format!("{prefix}img{i}.jpg")).collect();
        let mut files: Vec<(&str, Vec<u8>)> =
            names.iter().enumerate().map(|(i, name)| (name.as_str(), jpeg(i))).collect();
        files.push((
            if prefix.contains("my") { "my scene/notes.txt" } else { "notes.txt" },
            b"hello".to_vec(),
        ));
        let capture = open_folder(&files).expect("a capture");
        let names: Vec<_> = capture.views.iter().map(|view| view.name.as_str()).collect();
        assert_eq!(names, ["img1", "img2", "img10"], "{prefix}");
        assert_eq!(capture.views[0].path, PhotoPath::new("img1.jpg"));
        assert_eq!(capture.assessments.len(), 3);
        assert!(capture.warnings.iter().any(|warning| warning.code == "few"));
    }
}

#[test]
fn ground_truth_is_matched_by_stem_and_ignored_if_broken_or_of_another_shape() {
    for truth in ["gt", "HL"] {
        let sharp = |width| picture(9, width, 64).encode(EncodeFormat::Png).expect("encoded");
        let capture = open_folder(&[
            ("images/a.jpg", jpeg(1)),
            ("images/b.jpg", jpeg(2)),
            ("images/c.jpg", jpeg(3)),
            ("images/d.jpg", jpeg(4)),
            (&format!("{truth}/A.png"), sharp(96)),
            (&format!("{truth}/b.png"), sharp(64)),
            (&format!("{truth}/d.png"), sharp(96)[..2000].to_vec()),
        ])
        .expect("a capture");
        let has: Vec<bool> = capture.views.iter().map(|view| view.gt.is_some()).collect();
        assert_eq!(has, [true, false, false, false], "{truth}");
        let codes: Vec<_> = capture.warnings.iter().map(|warning| warning.code.as_str()).collect();
        assert!(codes.contains(&"gt_missing") && codes.contains(&"gt_size"), "{codes:?}");
    }
}

#[test]
fn given_poses_are_found_in_order_of_preference_without_those_of_the_ground_truth() {
    let photographs =
        || vec![("images/a.jpg", jpeg(1)), ("images/b.jpg", jpeg(2)), ("images/c.jpg", jpeg(3))];
    let with = |more: &[&'static str]| {
        let mut files = photographs();
        files.extend(more.iter().map(|name| (*name, b"x".to_vec())));
        open_folder(&files).expect("a capture").poses.map(|poses| poses.file)
    };
    assert_eq!(with(&["sparse_gt/cameras.txt", "sparse_gt/images.txt"]), None);
    assert!(matches!(with(&["poses_bounds.npy"]), Some(GivenPosesFile::PosesBounds(_))));
    assert!(matches!(
        with(&["poses_bounds.npy", "transforms.json"]),
        Some(GivenPosesFile::Transforms(_))
    ));
    let model = with(&["sparse/0/cameras.bin", "sparse/0/images.bin", "transforms.json"]);
    assert!(matches!(model, Some(GivenPosesFile::ColmapModel(path)) if path.ends_with("sparse/0")));
    assert_eq!(with(&["sparse/cameras.txt", "sparse/points3D.txt"]), None);
}

#[test]
fn a_capture_sets_its_held_out_photographs_also_from_a_zip() {
    let held = |name: &'static str| {
        let photographs = ["images/a.jpg", "images/b.jpg", "images/c.jpg"];
        let mut files: Vec<_> = (1..).map(jpeg).zip(photographs).collect();
        files.push((Vec::new(), name));
        let files: Vec<_> = files.into_iter().map(|(bytes, name)| (name, bytes)).collect();
        let (folder, zip) = (
            open_folder(&files).expect("a capture"),
            open_zip(&zipped(&|writer| {
                let mut pack = |(name, bytes): &(&str, Vec<u8>)| add(writer, name, bytes);
                files.iter().for_each(&mut pack);
            })),
        );
        let zip = zip.0.expect("a capture");
        assert_eq!((folder.hold, &folder.fingerprint), (zip.hold, &zip.fingerprint));
        (folder.hold, folder.fingerprint)
    };
    let (nothing, without) = held("hold=one");
    let (eighth, with) = held("hold=8");
    assert_eq!((nothing, eighth, held("hold=1").0), (None, Some(8), None));
    assert_ne!(without, with);
}

#[test]
fn bad_files_are_rejected_individually() {
    let whole = jpeg(4);
    let capture = open_folder(&[
        ("1.jpg", jpeg(1)),
        ("2.jpg", jpeg(2)),
        ("3.jpg", jpeg(3)),
        ("4.jpg", whole[..whole.len() / 2].to_vec()),
        ("5.jpg", Vec::new()),
        ("6.jpg", b"a text".to_vec()),
        ("7.avif", b"\0\0\0\x18ftypavif\0\0\0\0mif1avif".to_vec()),
        ("8.jpg", jpeg(1)),
        ("9.png", Image::<Srgb>::new(96, 64).encode(EncodeFormat::Png).expect("encoded")),
        (".hidden.jpg", jpeg(5)),
    ])
    .expect("a capture");
    assert_eq!(capture.views.len(), 3);
    let reasons: Vec<String> = capture.assessments[3..]
        .iter()
        .map(|assessment| assessment.reason.clone().expect("rejected"))
        .collect();
    let parts = ["cut short", "empty", "not a JPEG", "AVIF", "same picture as 1.jpg", "black"];
    for (reason, part) in reasons.iter().zip(parts) {
        assert!(reason.contains(part), "{reason} should say {part}");
    }
    assert_eq!(reasons.len(), parts.len());
    assert!(
        capture.assessments[6].unsupported_format && !capture.assessments[5].unsupported_format
    );
}

#[test]
fn captures_without_enough_usable_photographs_are_refused_with_figures() {
    let same = jpeg(1);
    let identical: Vec<(String, Vec<u8>)> =
        (0..20).map(|i| (format!("{i}.jpg"), same.clone())).collect();
    let identical: Vec<(&str, Vec<u8>)> =
        identical.iter().map(|(n, b)| (n.as_str(), b.clone())).collect();
    let two = [("a.jpg", jpeg(1)), ("b.jpg", jpeg(2))];
    let cases = [(vec![("a.jpg", b"x".to_vec())], 0), (two.to_vec(), 2), (identical, 1)];
    for (files, usable) in cases {
        let error = open_folder(&files).expect_err("too few");
        assert!(
            matches!(&error, CaptureError::TooFew { accepted, .. } if *accepted == usable),
            "{error}"
        );
        assert!(error.to_string().starts_with(&format!("{usable} of ")), "{error}");
        assert!(!error.is_of_the_machine());
        assert!(error.hint().contains("20 to 60"));
    }
}

#[test]
fn hostile_names_never_become_our_own_names() {
    let long = format!("{}.jpg", "x".repeat(240));
    let capture = open_folder(&[
        ("-rf.jpg", jpeg(1)),
        ("new\nline.jpg", jpeg(2)),
        ("📷📷.jpg", jpeg(3)),
        (&long, jpeg(4)),
        ("<script>.jpg", jpeg(5)),
    ])
    .expect("a capture");
    assert_eq!(capture.views.len(), 5);
    for view in &capture.views {
        assert!(view.name.len() <= 40 && !view.name.starts_with('-'), "{}", view.name);
        assert!(
            view.name.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c)),
            "{}",
            view.name
        );
    }
}

#[test]
fn the_development_captures_are_accepted_completely() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/captures");
    for (name, count, size) in [("fox", 20, (315, 559)), ("sceaux", 11, (581, 427))] {
        if !root.join(name).is_dir() {
            return;
        }
        let scratch = tempfile::tempdir().expect("a temporary folder");
        let capture = Capture::open(&root.join(name), scratch.path()).expect("a capture");
        assert_eq!(capture.views.len(), count);
        assert!(
            capture.views.iter().all(|view| view.gt.is_some() && (view.width, view.height) == size)
        );
        assert_eq!(capture.poses, None);
        assert_eq!(
            capture.assessments.iter().map(|v| v.warnings.len()).sum::<usize>(),
            0,
            "{:?}",
            capture.assessments
        );
    }
}

/// Patches of uniform random colour and uniform brightness: sharp edges everywhere.
fn patches(seed: usize, size: usize, gain: f32) -> Image<Srgb> {
    let mut image = Image::new(size, size);
    for y in 0..size {
        for x in 0..size {
            let hash = ((y / 9 * 31 + x / 9 + seed * 977) * 2_654_435_761) >> 9 & 255;
            image.set(x, y, [gain * hash as f32 / 255.0; 3]);
        }
    }
    image
}

#[test]
fn dark_blurred_and_odd_sized_photographs_each_get_a_warning() {
    let png = |image: Image<Srgb>| image.encode(EncodeFormat::Png).expect("encoded");
    let blurred = patches(4, 160, 0.6).resize_area(12, 12).resize_bilinear(160, 160);
    let capture = open_folder(&[
        ("1.png", png(patches(1, 160, 0.6))),
        ("2.png", png(patches(2, 160, 0.3))),
        ("3.png", png(patches(3, 160, 0.02))),
        ("4.png", png(blurred)),
        ("5.png", png(patches(5, 200, 0.6))),
    ])
    .expect("a capture");
    let codes: Vec<Vec<&str>> = capture
        .assessments
        .iter()
        .map(|assessment| assessment.warnings.iter().map(|warning| warning.code.as_str()).collect())
        .collect();
    assert_eq!(codes, [vec![], vec![], vec!["dark"], vec!["blurred"], vec![]]);
    let mixed =
        capture.warnings.iter().find(|warning| warning.code == "mixed_sizes").expect("a warning");
    assert!(mixed.message.starts_with("1 of 5"), "{}", mixed.message);
}

#[test]
fn a_phones_videos_beside_its_photographs_are_listed_and_change_nothing() {
    let photographs = [("1.jpg", jpeg(1)), ("2.jpg", jpeg(2)), ("3.jpg", jpeg(3))];
    let alone = open_folder(&photographs).expect("a capture");
    let video = [("2.MOV", b"\0\0\0\x14ftypqt  ".to_vec())];
    let with_video = open_folder(&[&photographs[..], &video].concat()).expect("a capture");
    assert_eq!(with_video.views.len(), 3);
    assert_eq!(with_video.fingerprint, alone.fingerprint);
    let last = with_video.assessments.last().expect("listed");
    assert_eq!(last.name, "2.MOV");
    assert!(last.reason.as_ref().is_some_and(|reason| reason.contains("by itself")));
}

#[test]
fn unsupported_archives_and_videos_are_named_with_advice() {
    let photographs = [("1.jpg", jpeg(1)), ("2.jpg", jpeg(2)), ("3.jpg", jpeg(3))];
    let others = [
        ("4.bmp", b"BM\x36".to_vec()),
        ("more.tar.gz", b"\x1f\x8b".to_vec()),
        ("walk.mkv", b"\x1a\x45\xdf\xa3".to_vec()),
    ];
    let capture = open_folder(&[&photographs[..], &others].concat()).expect("a capture");
    let listed: Vec<String> = capture.assessments[3..]
        .iter()
        .map(|one| format!("{}: {}", one.name, one.reason.as_deref().unwrap_or_default()))
        .collect();
    for (listed, words) in
        listed.iter().zip(["4.bmp: BMP", "more.tar.gz: gzip", "walk.mkv: Matroska"])
    {
        assert!(listed.starts_with(words), "{listed}");
    }
    assert_eq!(listed.len(), 3);
    // As in an upload, which puts everything in one folder.
    for (name, bytes) in others {
        let error = open_folder(&[(&format!("images/{name}"), bytes.clone())]).expect_err(name);
        assert!(error.to_string().contains("not read: "), "{name}: {error}");
        let folder = folder(&[(name, bytes)]);
        let path = folder.path().join("capture").join(name);
        let error = Capture::open(&path, folder.path()).expect_err(name);
        assert!(matches!(error, CaptureError::Unread { .. }), "{name}: {error}");
    }
}

#[test]
fn a_path_that_is_not_a_capture_is_a_user_error() {
    let folder = folder(&[("a.txt", b"text".to_vec())]);
    let open =
        |name: &str| Capture::open(&folder.path().join(name), folder.path()).expect_err(name);
    assert!(matches!(open("capture/a.txt"), CaptureError::NotACapture { .. }));
    assert!(!open("missing").is_of_the_machine());
}
