use std::fs;

use super::dng::{Sensor, balance, written};
use super::*;
use crate::image::read_header;

const SENSORS: [Sensor; 3] = [Sensor::Bayer, Sensor::XTrans, Sensor::Linear];

fn opened(sensor: Sensor, size: (usize, usize), light: impl Fn(usize, usize) -> [f64; 3]) -> Raw {
    Raw::open(written(sensor, size, 1, [1.0; 3], light)).expect("a DNG")
}

/// The largest difference of an inner part of an image from what is wanted there.
fn error(image: &Image<Linear>, margin: usize, wanted: impl Fn(usize, usize) -> [f64; 3]) -> f64 {
    let mut worst = 0.0_f64;
    for y in margin..image.height() - margin {
        for x in margin..image.width() - margin {
            for (value, wanted) in image.get(x, y).into_iter().zip(wanted(x, y)) {
                worst = worst.max((f64::from(value) - wanted).abs());
            }
        }
    }
    worst
}

#[test]
fn patches_of_known_light_are_read_from_every_kind_of_sensor() {
    let patches = [[0.4, 0.2, 0.1], [0.02, 0.03, 0.01], [0.3, 0.3, 0.3], [0.05, 0.5, 0.1]];
    for sensor in SENSORS {
        for long_side in [96, 48, 32] {
            let raw = opened(sensor, (96, 72), |x, _| patches[x / 24]);
            let image = raw.light(long_side, None).expect("light");
            assert_eq!((image.width(), image.height()), (long_side, long_side * 3 / 4));
            for (index, wanted) in patches.iter().enumerate() {
                let x = (2 * index + 1) * long_side / 8;
                let found = image.get(x, long_side / 3);
                for (value, wanted) in found.into_iter().zip(wanted) {
                    let off = (f64::from(value) - wanted).abs();
                    assert!(off < 2e-3, "patch {index} at {long_side} px: {found:?}");
                }
            }
        }
    }
}

/// Each colour of a mosaic lies elsewhere; a ramp shows a shift of one against the others.
#[test]
fn no_colour_of_a_mosaic_is_shifted() {
    let ramp = |x: f64, y: f64| [0.004 * x + 0.001 * y + 0.05; 3];
    for sensor in SENSORS {
        let raw = opened(sensor, (96, 72), |x, y| ramp(x as f64, y as f64));
        for scale in [1, 2, 3] {
            let image = raw.light(96 / scale, None).expect("light");
            let centre = |i: usize| (i as f64 + 0.5) * scale as f64 - 0.5;
            let off = error(&image, 6, |x, y| ramp(centre(x), centre(y)));
            // The samples of X-Trans lie unevenly, by about one.
            let tolerance = if matches!(sensor, Sensor::XTrans) { 5e-3 } else { 4e-4 };
            assert!(off < tolerance, "at 1:{scale} off by {off}");
        }
    }
}

#[test]
fn noise_below_black_stays_so_that_its_mean_is_black() {
    let noise =
        |x: usize, y: usize| [0.01 * if (x / 2 + y / 2).is_multiple_of(2) { 1.0 } else { -1.0 }; 3];
    let raw = opened(Sensor::Bayer, (96, 72), noise);
    let full = raw.light(96, None).expect("light");
    let least = full.data().iter().copied().fold(0.0_f32, f32::min);
    assert!(least < -0.004, "{least}");
    let mean = raw.light(12, None).expect("light");
    assert!(error(&mean, 1, |_, _| [0.0; 3]) < 1e-3);
}

#[test]
fn clipped_lights_are_white_and_no_other_colour() {
    let raw = opened(Sensor::Bayer, (48, 36), |_, _| [9.0; 3]);
    assert!(error(&raw.light(48, None).expect("light"), 0, |_, _| [1.0; 3]) < 1e-3);
}

#[test]
fn a_capture_can_have_one_white_balance() {
    let grey = |_: usize, _: usize| [0.2; 3];
    let other = written(Sensor::Bayer, (48, 36), 1, [1.25, 1.0, 0.8], grey);
    let raw = Raw::open(other).expect("a DNG");
    let as_shot = raw.light(48, None).expect("light").get(24, 18);
    assert!(as_shot[0] < 0.19 && as_shot[2] > 0.22, "{as_shot:?}");
    let common = raw.light(48, Some(balance())).expect("light");
    assert!(error(&common, 2, |_, _| [0.2; 3]) < 2e-3);
}

#[test]
fn a_header_has_the_upright_size_the_exposure_and_the_focal_length() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.dng");
    let corner = |x: usize, y: usize| if x < 48 && y < 36 { [0.5; 3] } else { [0.1; 3] };
    fs::write(&path, written(Sensor::Bayer, (96, 72), 6, [1.0; 3], corner)).expect("written");
    let header = read_header(&path).expect("a header");
    assert_eq!((header.width, header.height), (72, 96));
    let shot = header.shot.expect("an exposure");
    assert_eq!((shot.seconds, shot.iso, shot.f_number), (0.05, 1600.0, Some(2.0)));
    let focal = header.focal_px.expect("a focal length");
    assert!((focal - 28.0 / 43.266_615 * 96_f64.hypot(72.0)).abs() < 0.01, "{focal}");
    let raw = header.raw.expect("raw");
    assert!(raw.white_balance.iter().zip(balance()).all(|(a, b)| (a - b).abs() < 1e-3));
    // Turned by a quarter clockwise: the first corner is at the top right.
    let image = Image::<Linear>::load_light(&path, usize::MAX).expect("light");
    assert!(image.get(60, 12)[1] > 0.4 && image.get(12, 12)[1] < 0.2);
}

/// The decoder is given what a stranger may send; it must answer, and within its limits.
#[test]
fn cut_and_changed_files_are_read_or_refused() {
    let whole = written(Sensor::Bayer, (64, 48), 1, [1.0; 3], |x, _| [0.004 * x as f64; 3]);
    let outcome = |bytes: Vec<u8>| {
        super::super::decode::guarded(|| {
            let raw = Raw::open(bytes)?;
            if raw.decoded_bytes() > 64 << 20 {
                return Err(unsupported("too large for this test".to_owned()));
            }
            raw.light(32, None)
        })
    };
    assert!(outcome(whole.clone()).is_ok());
    let mut refused = 0;
    for cut in 0..200 {
        let length = whole.len() * cut / 200;
        refused += usize::from(outcome(whole[..length].to_vec()).is_err());
    }
    assert_eq!(refused, 200, "a file that is cut has lost samples");
    let mut state = 1_u64;
    for _ in 0..2_000 {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let mut bytes = whole.clone();
        // Within the directory and its values, where a byte matters.
        let at = (state >> 33) as usize % 800;
        bytes[at] = (state >> 20) as u8;
        if let Ok(image) = outcome(bytes) {
            assert!(image.data().iter().all(|value| value.is_finite()));
        }
    }
}

#[test]
fn what_is_no_raw_file_is_refused_with_advice() {
    let error = Raw::open(b"II*\0 not a raw file at all".to_vec()).err().expect("refused");
    assert!(error.is_unsupported_format() || matches!(error, ImageError::Damaged { .. }));
    let error = Raw::open(vec![7; 4000]).err().expect("refused").to_string();
    assert!(error.contains("dcraw_emu"), "{error}");
}
