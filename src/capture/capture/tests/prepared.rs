//! Prepared images, and how often photographs are decoded for them.

use std::collections::BTreeSet;

use super::*;
use crate::image::DECODED;

/// Three photographs of 96 x 64 px, the first with ground truth.
fn capture() -> tempfile::TempDir {
    folder(&[
        ("images/a.jpg", jpeg(1)),
        ("images/b.jpg", jpeg(2)),
        ("images/c.jpg", jpeg(3)),
        ("gt/a.png", picture(9, 96, 64).encode(EncodeFormat::Png).expect("encoded")),
    ])
}

fn open(folder: &Path, side: usize) -> Capture {
    Capture::open_at(&folder.join("capture"), &folder.join("scratch"), side).expect("a capture")
}

/// How often files below a folder were decoded.
fn decodes(folder: &Path) -> usize {
    let decoded = DECODED.lock().expect("unpoisoned");
    decoded.iter().filter(|path| path.starts_with(folder.join("capture"))).count()
}

#[test]
fn each_photograph_is_decoded_once() {
    let folder = capture();
    let opened = open(folder.path(), PREPARED_SIDE);
    assert_eq!(decodes(folder.path()), 4, "three photographs and a ground truth");
    for size in [560, 48] {
        for view in &opened.views {
            let read = view.prepared.load_at_most(size).expect("a view");
            assert_eq!(read.width(), size.min(96));
            assert!(view.gt.iter().all(|gt| gt.load_at_most(size).is_ok()));
        }
    }
    assert_eq!(open(folder.path(), PREPARED_SIDE).assessments, opened.assessments);
    assert_eq!(decodes(folder.path()), 4);
    fs::write(folder.path().join("capture/images/d.gpr"), "raw").expect("written");
    let more = open(folder.path(), PREPARED_SIDE);
    assert_eq!((more.views.len(), more.assessments.len()), (3, 4), "another file is listed");
    fs::write(folder.path().join("capture/images/c.jpg"), jpeg(7)).expect("written");
    assert_ne!(open(folder.path(), PREPARED_SIDE).fingerprint, opened.fingerprint);
    assert_eq!(decodes(folder.path()), 12, "another capture is prepared again");
}

#[test]
fn images_are_prepared_no_larger_than_asked_for_and_averaged_in_light() {
    let folder = capture();
    let opened = open(folder.path(), 48);
    for view in &opened.views {
        assert_eq!((view.width, view.height), (96, 64));
        assert_eq!((view.prepared.width, view.prepared.height), (48, 32));
        let wanted = Image::load_light(&view.file, 48).expect("read");
        let image = view.prepared.load().expect("read");
        let mut pairs = image.data().iter().zip(wanted.data());
        assert!(pairs.all(|(a, b)| (a - b).abs() <= b / 2048.0 + 1e-6), "{}", view.path);
    }
    let larger = open(folder.path(), 96);
    assert!(larger.views.iter().all(|view| view.prepared.width == 96));
    let small = larger.views[0].prepared.load_at_most(24).expect("read");
    assert_eq!((small.width(), small.height()), (24, 16));
}

#[test]
fn only_accepted_photographs_leave_images() {
    let folder = capture();
    let copy = folder.path().join("capture/images/b copy.jpg");
    fs::write(copy, jpeg(2)).expect("written");
    let black = Image::<Srgb>::new(96, 64).encode(EncodeFormat::Png).expect("encoded");
    fs::write(folder.path().join("capture/images/black.png"), black).expect("written");
    let opened = open(folder.path(), PREPARED_SIDE);
    assert_eq!(opened.views.len(), 3);
    let listed = || {
        let files = fs::read_dir(folder.path().join("scratch/prepared")).expect("listed");
        let names = files.map(|file| file.expect("a file").file_name().into_string());
        let names: BTreeSet<String> = names.map(|name| name.expect("UTF-8")).collect();
        names.into_iter().filter(|name| name != ".lock").collect::<Vec<_>>()
    };
    let names = ["a.half", "a.truth.half", "b.half", "c.half", "manifest.json"];
    assert_eq!(listed(), names, "each by the name of its view");
    let masks = folder.path().join("capture/masks");
    fs::create_dir(&masks).expect("made");
    for name in ["a", "b copy"] {
        let mask = picture(3, 96, 64).encode(EncodeFormat::Png).expect("encoded");
        fs::write(masks.join(format!("{name}.png")), mask).expect("written");
    }
    assert_eq!(open(folder.path(), PREPARED_SIDE).views.len(), 3);
    let names = [&["a.half", "a.mask.half"], &names[1..]].concat();
    assert_eq!(listed(), names);
    let few = folder.path().join("capture/images/a.jpg");
    fs::remove_file(few).expect("removed");
    fs::remove_file(folder.path().join("capture/images/b.jpg")).expect("removed");
    let scratch = folder.path().join("scratch");
    let outcome = Capture::open(&folder.path().join("capture"), &scratch);
    assert!(matches!(outcome, Err(CaptureError::TooFew { accepted: 2, .. })), "{outcome:?}");
    assert!(!scratch.join("prepared").exists());
}

#[cfg(unix)]
#[test]
fn a_capture_with_a_name_that_is_not_utf8_is_prepared_once() {
    use std::os::unix::ffi::OsStrExt;
    let folder = capture();
    let name = std::ffi::OsStr::from_bytes(b"\xff.jpg");
    fs::write(folder.path().join("capture/images").join(name), jpeg(5)).expect("written");
    let opened = open(folder.path(), PREPARED_SIDE);
    let count = decodes(folder.path());
    let again = open(folder.path(), PREPARED_SIDE);
    assert_eq!((again.views.len(), decodes(folder.path())), (4, count));
    assert_eq!(again.assessments, opened.assessments);
}

#[test]
fn files_stored_in_another_order_are_prepared_again() {
    let folder = folder(&[]);
    let (zip, scratch) = (folder.path().join("capture.zip"), folder.path().join("scratch"));
    let of = |order: [usize; 3]| {
        let bytes = zipped(&|writer| {
            order.iter().for_each(|i| add(writer, &format!("{i}.jpg"), &jpeg(*i)));
        });
        fs::write(&zip, bytes).expect("written");
        Capture::open(&zip, &scratch).expect("a capture")
    };
    let (first, second) = (of([0, 1, 2]), of([2, 1, 0]));
    assert_eq!(first.fingerprint, second.fingerprint);
    for view in &second.views {
        let number: usize = view.name.parse().expect("a number");
        assert!(shows(view, &jpeg(number)), "{}", view.path);
    }
}

#[test]
fn a_place_that_cannot_be_written_to_is_no_fault_of_the_photographs() {
    let folder = capture();
    let scratch = folder.path().join("scratch");
    fs::create_dir(&scratch).expect("made");
    fs::write(scratch.join("prepared"), "a file").expect("written");
    let outcome = Capture::open(&folder.path().join("capture"), &scratch);
    assert!(matches!(outcome, Err(CaptureError::Io { .. })), "{outcome:?}");
}

#[test]
fn a_damaged_image_is_an_error_until_the_capture_is_opened_again() {
    let folder = capture();
    let opened = open(folder.path(), PREPARED_SIDE);
    let file = folder.path().join("scratch/prepared/a.half");
    let bytes = fs::read(&file).expect("read");
    fs::write(&file, &bytes[..bytes.len() - 2]).expect("written");
    assert!(opened.views[0].prepared.load().is_err());
    let again = open(folder.path(), PREPARED_SIDE);
    assert!(again.views[0].prepared.load().is_ok(), "prepared again");
}

#[test]
fn a_manifest_that_no_preparation_wrote_is_refused() {
    let folder = capture();
    open(folder.path(), PREPARED_SIDE);
    let prepared = folder.path().join("scratch/prepared");
    let manifest = prepared.join("manifest.json");
    let whole: serde_json::Value =
        serde_json::from_slice(&fs::read(&manifest).expect("read")).expect("JSON");
    assert!(Capture::is_prepared(&prepared) && Capture::prepared(&prepared).is_ok());
    let given = Capture::given(&prepared).expect("a capture");
    assert_ne!(given.fingerprint, Capture::prepared(&prepared).expect("read").fingerprint);
    type Change = fn(&mut serde_json::Value);
    let changes: [Change; 6] = [
        |manifest| manifest["fled_capture"] = 3.into(),
        |manifest| manifest["capture"]["views"][0]["name"] = "../a".into(),
        |manifest| manifest["capture"]["views"][0]["name"] = "b".into(),
        |manifest| manifest["capture"]["views"][0]["prepared"]["width"] = 0.into(),
        |manifest| manifest["capture"]["views"][0]["prepared"]["file"] = "../view.half".into(),
        |manifest| {
            manifest["capture"]["views"].as_array_mut().expect("views").pop();
        },
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut changed = whole.clone();
        change(&mut changed);
        fs::write(&manifest, changed.to_string()).expect("written");
        let outcome = Capture::prepared(&prepared);
        assert!(matches!(outcome, Err(CaptureError::Unprepared { .. })), "{number}: {outcome:?}");
    }
}

#[test]
fn one_folder_is_prepared_by_one_process_at_a_time() {
    let folder = capture();
    let captures: Vec<Capture> = std::thread::scope(|scope| {
        let run = || scope.spawn(|| open(folder.path(), PREPARED_SIDE));
        [run(), run(), run()].map(|thread| thread.join().expect("prepared")).into()
    });
    assert!(captures.iter().all(|capture| capture.views.len() == 3));
    assert_eq!(decodes(folder.path()), 4, "the others find it prepared");
}
