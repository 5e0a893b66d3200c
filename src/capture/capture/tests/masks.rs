//! Masks included in a capture.

use super::*;
use crate::mask::Mask;

fn mask_of(width: usize, height: usize, is_white: impl Fn(usize, usize) -> bool) -> Vec<u8> {
    let mut image: Image<Srgb> = Image::new(width, height);
    for (x, y) in (0..width * height).map(|i| (i % width, i / width)) {
        image.set(x, y, [if is_white(x, y) { 1.0 } else { 0.0 }; 3]);
    }
    image.encode(EncodeFormat::Png).expect("encoded")
}

fn left_hidden() -> Vec<u8> {
    mask_of(96, 64, |x, _| x >= 48)
}

/// A capture of three photographs and these files, and its warnings about masks.
fn with(files: &[(&str, Vec<u8>)]) -> (tempfile::TempDir, Capture, Vec<String>) {
    let names = ["images/a.jpg", "images/b.jpg", "images/c.jpg"];
    let mut all: Vec<_> = names.iter().enumerate().map(|(i, name)| (*name, jpeg(i))).collect();
    for (name, bytes) in files {
        all.retain(|(other, _)| other != name);
        all.push((name, bytes.clone()));
    }
    let home = folder(&all);
    let opened = Capture::open(&home.path().join("capture"), &home.path().join("scratch"));
    let capture = opened.expect("a capture");
    let masks = capture.warnings.iter().filter(|warning| warning.code == "masks");
    let messages = masks.map(|warning| warning.message.clone()).collect();
    (home, capture, messages)
}

fn load(capture: &Capture, view: usize) -> Option<Mask> {
    let view = &capture.views[view];
    let mask = view.mask.as_ref()?;
    Some(mask.load_mask((view.width, view.height), Clone::clone).expect("read"))
}

#[test]
fn masks_hide_black_areas_and_are_not_photographs() {
    let half = mask_of(48, 32, |x, _| x >= 24);
    let white = mask_of(96, 64, |x, _| x < 48);
    let files = [
        ("masks/a.png", left_hidden()),
        ("masks/b.jpg.png", half),
        ("images/dynamic_mask_c.png", white),
    ];
    let (_home, capture, messages) = with(&files);
    assert_eq!(capture.photographs.len(), 3);
    for view in 0..3 {
        let mask = load(&capture, view).expect("a mask");
        let wrong = (0..96 * 64).filter(|i| mask.holds(i % 96, i / 96) != (i % 96 >= 48));
        assert_eq!(wrong.count(), 0, "{view}");
    }
    assert_eq!(messages.len(), 1, "{messages:?}");
    assert!(messages[0].starts_with("3 of 3 photographs have masks"), "{messages:?}");
    assert!(capture.warnings.iter().all(|w| w.code != "elsewhere"), "{:?}", capture.warnings);
    let (_home, without, _) = with(&files[..2]);
    assert_ne!(capture.fingerprint, without.fingerprint);
}

#[test]
fn mask_path_of_a_frame_names_a_mask_anywhere() {
    let json = r#"{"frames": [
        {"file_path": "images/b.jpg", "mask_path": "hands/0001.png"},
        {"file_path": "images/c.jpg", "mask_path": "hands/lost.png"}]}"#;
    let files = [("hands/0001.png", left_hidden()), ("transforms.json", json.into())];
    let (_home, capture, messages) = with(&files);
    assert!(load(&capture, 0).is_none() && load(&capture, 2).is_none());
    assert!(!load(&capture, 1).expect("a mask").holds(0, 0));
    assert!(messages.iter().any(|m| m.contains("hands/lost.png")), "{messages:?}");
    assert!(messages.iter().any(|m| m.contains("1 of 3 photographs have masks")), "{messages:?}");
}

#[test]
fn transparent_pixels_are_masked() {
    let cut = ::image::RgbaImage::from_fn(96, 64, |x, y| {
        let alpha = if x < 48 { 0 } else { 255 };
        ::image::Rgba([(x * 7 % 256) as u8, (y * 11 % 256) as u8, 90, alpha])
    });
    let encoded = |format| {
        let mut bytes = Cursor::new(Vec::new());
        cut.write_to(&mut bytes, format).expect("encoded");
        bytes.into_inner()
    };
    let files = [
        ("images/d.png", encoded(::image::ImageFormat::Png)),
        ("images/e.webp", picture_of(&cut.clone(), 1)),
    ];
    let (_home, capture, messages) = with(&files);
    let mask = load(&capture, 3).expect("a mask");
    assert!(!mask.holds(10, 10) && mask.holds(60, 10));
    assert!(load(&capture, 4).is_some() && load(&capture, 0).is_none());
    assert!(messages[0].starts_with("2 of 5 photographs have masks"), "{messages:?}");
}

/// The cut-out with different colours, as WebP.
fn picture_of(cut: &::image::RgbaImage, seed: u8) -> Vec<u8> {
    let mut other = cut.clone();
    other.pixels_mut().for_each(|pixel| pixel.0[2] = pixel.0[0].wrapping_mul(seed + 2));
    let mut bytes = Cursor::new(Vec::new());
    other.write_to(&mut bytes, ::image::ImageFormat::WebP).expect("encoded");
    bytes.into_inner()
}

#[test]
fn an_unusable_mask_is_reported_with_the_reason() {
    let files = [
        ("masks/a.png", mask_of(64, 64, |_, _| true)),
        ("masks/b.png", b"no picture".to_vec()),
        ("masks/z.png", left_hidden()),
    ];
    let (_home, capture, messages) = with(&files);
    assert!((0..3).all(|view| load(&capture, view).is_none()));
    assert!(
        messages.iter().any(|m| m.contains(
            "2 masks are not used, the first is masks/a.png: it has \
        other proportions"
        )),
        "{messages:?}"
    );
    assert!(
        messages.iter().any(|m| m.contains("no photograph") && m.contains("masks/z.png")),
        "{messages:?}"
    );
}

#[test]
fn a_fully_masked_photograph_is_not_used() {
    let files = [("images/d.jpg", jpeg(7)), ("masks/d.png", mask_of(96, 64, |_, _| false))];
    let (_home, capture, messages) = with(&files);
    assert_eq!(capture.views.len(), 3);
    let hidden = &capture.assessments[3];
    assert!(!hidden.accepted && hidden.reason.as_deref() == Some("its mask hides all of it"));
    assert!(messages.iter().any(|m| m.starts_with("1 photographs are not used")), "{messages:?}");
}

#[test]
fn a_mask_is_rotated_like_the_stored_pixels_of_its_photograph() {
    let exif = crate::image::exif_block(&[(exif::Tag::Orientation, exif::Value::Short(vec![6]))]);
    let mut turned = jpeg(9);
    let mut segment = vec![0xff, 0xe1];
    let payload = [b"Exif\0\0".to_vec(), exif].concat();
    segment.extend(u16::try_from(payload.len() + 2).expect("short").to_be_bytes());
    segment.extend(payload);
    turned.splice(2..2, segment);
    let upright = mask_of(64, 96, |_, y| y >= 48);
    for (name, mask) in [("stored", left_hidden()), ("upright", upright)] {
        let files = [("images/d.jpg", turned.clone()), ("masks/d.png", mask)];
        let (_home, capture, messages) = with(&files);
        let view = &capture.views[3];
        assert_eq!((view.width, view.height), (64, 96), "{name}: {messages:?}");
        let mask = load(&capture, 3).expect("a mask");
        let wrong = (0..96 * 64).filter(|i| mask.holds(i % 64, i / 64) != (i / 64 >= 48));
        assert_eq!(wrong.count(), 0, "{name}");
    }
}
