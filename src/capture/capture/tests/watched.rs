//! Callbacks during the assessment of photographs.

use std::cell::Cell;
use std::sync::Mutex;

use super::{folder, jpeg, picture};
use crate::capture::{ASSESSED_SIDE, Capture, DecodeBudget, Look, Watch};
use crate::image::EncodeFormat;

#[test]
fn a_watch_lends_memory_for_the_two_largest_and_sees_every_photograph() {
    let png = |width, height| {
        let picture = picture(7, width, height).encode(EncodeFormat::Png);
        picture.expect("encoded")
    };
    let files = [
        ("images/a.png", png(100, 90)),
        ("images/b.png", png(200, 100)),
        ("images/c.jpg", jpeg(3)),
        ("images/d.jpg", b"no picture".to_vec()),
        ("gt/c.png", png(96, 64)),
    ];
    let folder = folder(&files);
    let asked = Cell::new(0);
    let reported = Mutex::new(Vec::new());
    let shown = Mutex::new(Vec::new());
    let watch = Watch {
        lend: &|bytes| {
            asked.set(bytes);
            DecodeBudget::new(bytes)
        },
        tell: &|look| {
            let (name, step) = match look {
                Look::Begins(name) => (name.to_owned(), 1),
                Look::Seen(name, _, small) => {
                    shown.lock().expect("shown").push((name.to_owned(), small.width()));
                    return;
                }
                Look::Ended(name) => (name.to_owned(), -1),
            };
            reported.lock().expect("reported").push((name, step));
        },
    };
    let capture = folder.path().join("capture");
    let out = folder.path().join("scratch");
    let opened = Capture::prepare(&capture, &out, ASSESSED_SIDE, &watch);
    assert_eq!(opened.expect("a capture").views.len(), 3);
    assert!(asked.get() >= 3 * (200 * 100 + 100 * 90), "{}", asked.get());
    assert!(asked.get() < 3 * (200 * 100 + 100 * 90 + 96 * 64));
    let mut shown = shown.into_inner().expect("shown");
    shown.sort();
    let names: Vec<&str> = shown.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["a.png", "b.png", "c.jpg"], "what is decoded, and no ground truth");
    assert!(shown.iter().all(|(_, width)| *width <= 320));
    let reported = reported.into_inner().expect("reported");
    for name in ["a.png", "b.png", "c.jpg", "d.jpg", "gt/c.png"] {
        let of_it = reported.iter().filter(|(found, _)| found == name);
        let steps: Vec<i32> = of_it.map(|(_, step)| *step).collect();
        assert!(!steps.is_empty(), "{name} was not reported");
        assert_eq!(steps.iter().sum::<i32>(), 0, "{name} has no end");
        assert!(steps.chunks(2).all(|pair| pair == [1, -1]), "{name}");
    }
}
