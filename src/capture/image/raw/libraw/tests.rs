//! LibRaw's programs must be installed: `make setup`.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use super::super::dng::{Sensor, balance, written};
use super::super::{Raw, own_exif};
use super::*;
use crate::image::{linear_to_srgb, read_header};

const PATCHES: [[f64; 3]; 4] = [[0.4, 0.2, 0.1], [0.02, 0.03, 0.01], [0.3; 3], [0.05, 0.5, 0.1]];

fn saved(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("written");
    path
}

/// The largest difference of two lights, levels of 255 of sRGB; LibRaw cuts below black.
fn levels(found: [f32; 3], wanted: [f32; 3]) -> f32 {
    let off = |(a, b): (f32, f32)| (linear_to_srgb(a.max(0.0)) - linear_to_srgb(b.max(0.0))).abs();
    255.0 * found.into_iter().zip(wanted).map(off).fold(0.0, f32::max)
}

/// A sensor of four colours.
#[test]
fn a_raw_file_that_flashraw_refuses_is_read_by_libraw_and_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let patch = |x: usize, _: usize| PATCHES[x / 48];
    for orientation in [1, 6] {
        let bytes = written(Sensor::Emerald, (192, 144), orientation, [1.0; 3], patch);
        assert!(matches!(Raw::open(bytes.clone()), Err(ImageError::RawUnread { .. })));
        let path = saved(&folder, "a.dng", &bytes);
        let header = read_header(&path).expect("LibRaw, of Debian's libraw-bin, reads it");
        let upright = if orientation == 1 { (192, 144) } else { (144, 192) };
        assert_eq!((header.width, header.height), upright);
        let focal = header.focal_px.expect("a focal length");
        assert!((focal - 28.0 / 43.266_615 * 240.0).abs() < 0.01, "{focal}");
        let colours = header.colours().expect("named");
        assert!(colours.starts_with("raw, Fled Test, read by LibRaw 0."), "{colours}");
        let own = header.raw.expect("raw").white_balance;
        assert!(own.iter().zip(balance()).all(|(a, b)| (a - b).abs() < 1e-3), "{own:?}");
        for long_side in [192, 96, 64] {
            let image = Image::<Linear>::load_light(&path, long_side).expect("light");
            let short = long_side * 3 / 4;
            let (width, height) = (image.width(), image.height());
            assert_eq!((width.max(height), width.min(height)), (long_side, short));
            for (index, wanted) in PATCHES.iter().enumerate() {
                let along = (2 * index + 1) * long_side / 8;
                let found = match orientation {
                    1 => image.get(along, short / 3),
                    _ => image.get(short / 3, along),
                };
                let off = levels(found, wanted.map(|v| v as f32));
                assert!(off < 2.0, "patch {index} at {long_side} px: {off} levels, {found:?}");
            }
        }
    }
}

/// Mosaics only: in other files, LibRaw 0.20.2 subtracts black from the samples but not from white.
#[test]
fn libraw_agrees_with_what_is_computed_here() {
    let folder = tempfile::tempdir().expect("a folder");
    let patch = |x: usize, y: usize| PATCHES[(x / 48 + y / 48) % 4];
    let other = [1.25, 1.0, 0.8];
    for sensor in [Sensor::Bayer, Sensor::XTrans] {
        let bytes = written(sensor, (192, 144), 1, other, patch);
        let path = saved(&folder, "a.dng", &bytes);
        let ours = Raw::open(bytes).expect("a DNG");
        let theirs = Developed::open(INSTALLED, &path, 0).ok().expect("of libraw-bin");
        assert_eq!(theirs.header().camera, ours.header().camera);
        for white_balance in [None, Some(balance())] {
            let ours = ours.light(96, white_balance).expect("light");
            let theirs = theirs.light(96, white_balance).expect("light");
            for (x, y) in [(12, 12), (36, 12), (60, 12), (84, 12), (12, 36), (84, 60)] {
                let off = levels(theirs.get(x, y), ours.get(x, y));
                assert!(off < 0.1, "{off} levels at {x}, {y}");
            }
        }
    }
}

/// A program that runs a shell script.
fn stand_in(folder: &tempfile::TempDir, name: &str, script: &str) -> &'static str {
    let path = saved(folder, name, format!("#!/bin/sh\n{script}\n").as_bytes());
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("set");
    String::leak(path.to_str().expect("UTF-8").to_owned())
}

#[test]
fn without_libraw_the_error_says_that_it_may_help() {
    let refusal = Developed::open(
        Programs { identify: "/nowhere/raw-identify", develop: "/nowhere/dcraw_emu" },
        Path::new("a.dng"),
        0,
    );
    let error = refusal.err().expect("none").after("four colours").to_string();
    assert!(error.contains("four colours; LibRaw may read it"), "{error}");
    assert!(error.contains("apt-get install libraw-bin"), "{error}");
}

#[test]
fn what_libraw_refuses_or_cuts_short_is_an_error_with_its_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = saved(&folder, "a.dng", b"no raw file");
    let error = Developed::open(INSTALLED, &path, 0).err().expect("refused").after("one");
    assert!(error.to_string().contains("LibRaw says: Cannot"), "{error}");

    // The file's own text comes first.
    let told = "echo 'Camera: A B ID: 0x0'
        echo 'UniqueCameraModel: =A'; echo 'Full size: 1 x 1'; echo 'Output size: 1 x 1='
        echo 'Full size: 70 x 50'; echo 'Output size: 64 x 48'; echo '  As shot 2 1 1.5 0'";
    let identify = stand_in(&folder, "identify", told);
    for (script, reason) in [
        ("printf 'P6\\n64 48\\n65535\\nabc'", "incomplete"),
        ("printf 'P6\\n2 1\\n65535\\n123456789012'", "2 x 1 px for 64 x 48"),
        ("echo no memory >&2", "no memory"),
        ("head -c 100000 /dev/zero", "incomplete"),
    ] {
        let programs = Programs { identify, develop: stand_in(&folder, "develop", script) };
        let developed = Developed::open(programs, &path, 0).ok().expect("known");
        assert_eq!((&*developed.header().camera, developed.upright()), ("A B", (64, 48)));
        let error = developed.light(64, None).expect_err(script).to_string();
        assert!(error.contains(reason), "{script}: {error}");
    }
}

#[test]
fn a_sensor_beyond_the_limit_is_refused_and_mirrors_are_known() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = saved(&folder, "a.dng", b"no raw file");
    let open = |name: &str, told: &str| {
        let lines: String = told.lines().map(|line| format!("echo '{line}'\n")).collect();
        let identify = stand_in(&folder, name, &lines);
        Developed::open(Programs { identify, develop: identify }, &path, 0)
    };
    let large = open("large", "\nFull size: 60000 x 60000\nOutput size: 64 x 48\nAs shot 2 1 1 0");
    let error = large.err().expect("refused").after("one").to_string();
    assert!(error.contains("60000 x 60000 px are too many"), "{error}");
    for (flip, exif, upright) in [(0, 1, (64, 48)), (1, 2, (64, 48)), (2, 4, (64, 48))]
        .into_iter()
        .chain([(4, 5, (64, 48)), (5, 8, (64, 48)), (7, 7, (64, 48))])
    {
        let told = format!(
            "\nFull size: 70 x 50\nOutput size: 64 x 48\nImage flip: {flip}\nAs shot 2 1 1 0"
        );
        let developed = open(&format!("flip{flip}"), &told).ok().expect("known");
        assert_eq!((developed.orientation().to_exif(), developed.upright()), (exif, upright));
    }
}

#[test]
fn the_words_of_raw_identify_are_read_or_refused() {
    assert_eq!(size("1680 x 1119"), Some((1680, 1119)));
    assert_eq!((size("0 x 5"), size("70000 x 5"), size("wide")), (None, None, None));
    assert_eq!(multipliers("4 2 3 0    1.00 0.00"), Some([2.0, 1.0, 1.5, 1.0]));
    assert_eq!(multipliers("4 2 3 5"), Some([2.0, 1.0, 1.5, 2.5]));
    assert_eq!(
        (multipliers("4 0 3 0"), multipliers("4 2"), multipliers("nan 1 1")),
        (None, None, None)
    );
    let exposure = |shutter: &str| {
        shot(&format!("ISO speed: 1600\nShutter: {shutter}\nAperture: f/2.0\n"))
            .map(|shot| (shot.seconds, shot.iso, shot.f_number))
    };
    assert_eq!(exposure("1/20.0"), Some((0.05, 1600.0, Some(2.0))));
    assert_eq!(exposure("2.5 sec"), Some((2.5, 1600.0, Some(2.0))));
    assert_eq!((exposure("1/0.0"), exposure("")), (None, None));
    assert!(own_exif(b"FUJIFILMCCD-RAW").is_none());
}
