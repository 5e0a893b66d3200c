//! Zips, good and hostile.

use super::*;

#[test]
fn a_zip_is_the_same_capture_as_its_folder() {
    let names = [
        "fox/images/1.jpg",
        "fox/images/2.jpg",
        "fox/images/3.jpg",
        "fox/gt/1.png",
        "fox/transforms.json",
    ];
    let files: Vec<(&str, Vec<u8>)> =
        names.iter().enumerate().map(|(i, name)| (*name, jpeg(i))).collect();
    let bytes = zipped(&|writer| {
        files.iter().for_each(|(name, bytes)| add(writer, name, bytes));
    });
    let (outcome, left) = open_zip(&bytes);
    let (from_zip, from_folder) =
        (outcome.expect("a capture"), open_folder(&files).expect("a capture"));
    assert_eq!(from_zip.fingerprint, from_folder.fingerprint);
    assert_eq!(from_zip.assessments, from_folder.assessments);
    assert!(from_zip.views[0].gt.is_some() && from_zip.poses.is_some());
    assert_eq!(left.len(), 1 + names.len());
    let mut other = files.clone();
    other[0].1 = jpeg(77);
    assert_ne!(open_folder(&other).expect("a capture").fingerprint, from_folder.fingerprint);
}

#[test]
fn a_zip_made_inside_its_own_folder_is_read() {
    let names = ["./images/1.jpg", "./images/2.jpg", "./images/3.jpg", "./.DS_Store"];
    let bytes = zipped(&|writer| {
        (1..).zip(names).for_each(|(i, name)| add(writer, name, &jpeg(i)));
    });
    let capture = open_zip(&bytes).0.expect("a capture");
    assert_eq!(capture.photographs.len(), 3);
}

#[test]
fn hostile_zips_are_refused_by_name_and_leave_nothing_behind() {
    let good = |writer: &mut ZipWriter<Cursor<Vec<u8>>>| {
        (0..3).for_each(|i| add(writer, &format!("{i}.jpg"), &jpeg(i)));
    };
    // The writer rejects some of these names itself, so they are inserted afterwards.
    let renamed = |placeholder: &str, name: &str| {
        let bytes = zipped(&|writer| {
            good(writer);
            add(writer, placeholder, &jpeg(9));
        });
        replace(&bytes, placeholder.as_bytes(), name.as_bytes())
    };
    let linked = zipped(&|writer| {
        good(writer);
        writer
            .add_symlink("link.jpg", "/etc/passwd", SimpleFileOptions::default())
            .expect("packed");
    });
    let zeros = zipped(&|writer| {
        good(writer);
        add(writer, "zeros.jpg", &vec![0; 64 << 20]);
    });
    let nested = zipped(&|writer| {
        good(writer);
        add(writer, "inner.zip", b"PK");
    });
    let cases: [(&str, Vec<u8>, &str); 8] = [
        ("../evil.jpg", renamed("aa/evil.jpg", "../evil.jpg"), "leads out"),
        ("/ab/evil.jpg", renamed("aab/evil.jpg", "/ab/evil.jpg"), "absolute"),
        ("C:/evil.jpg", renamed("aa/evil.jpg", "C:/evil.jpg"), "absolute"),
        ("link.jpg", linked, "link"),
        ("zeros.jpg", zeros, "shrunk"),
        ("inner.zip", nested, "archive inside"),
        ("", renamed("a.jpg", "1.jpg"), "same name"),
        ("", zipped(&good)[..300].to_vec(), "cut short"),
    ];
    for (entry, bytes, reason) in cases {
        let (outcome, left) = open_zip(&bytes);
        let error = outcome.expect_err(entry);
        assert!(
            error.to_string().contains(entry) && error.to_string().contains(reason),
            "{entry}: {error}"
        );
        assert!(!error.is_of_the_machine());
        assert_eq!(left, [PathBuf::from("capture.zip")], "{entry} left something");
    }
}

/// Replaces the method of every entry, in its own header and in the directory.
fn with_method(bytes: &[u8], method: u8) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for at in 0..bytes.len() - 12 {
        match &bytes[at..at + 4] {
            b"PK\x03\x04" => bytes[at + 8] = method,
            b"PK\x01\x02" => bytes[at + 10] = method,
            _ => {}
        }
    }
    bytes
}

#[test]
fn deflate64_is_read_and_other_methods_are_named() {
    // Noise is stored uncompressed, in blocks common to both kinds of Deflate.
    let bytes = zipped(&|writer| (0..3).for_each(|i| add(writer, &format!("{i}.jpg"), &jpeg(i))));
    let plain = open_zip(&bytes).0.expect("a capture");
    let capture = open_zip(&with_method(&bytes, 9)).0.expect("Deflate64");
    assert_eq!(capture.fingerprint, plain.fingerprint);
    for (method, name) in [(12, "bzip2"), (14, "LZMA"), (93, "Zstandard"), (77, "an unknown")] {
        let error = open_zip(&with_method(&bytes, method)).0.expect_err(name);
        assert!(error.to_string().contains(name), "{error}");
    }
}

#[test]
fn many_highly_compressed_small_files_are_a_bomb_too() {
    let zeros = vec![0; 1 << 20];
    let bytes = zipped(&|writer| {
        (0..3).for_each(|i| add(writer, &format!("{i}.jpg"), &jpeg(i)));
        (0..80).for_each(|i| add(writer, &format!("zeros-{i}.jpg"), &zeros));
    });
    let (outcome, left) = open_zip(&bytes);
    let error = outcome.expect_err("80 MiB in some 80 kB");
    assert!(error.to_string().contains("together"), "{error}");
    assert_eq!(left, [PathBuf::from("capture.zip")]);
}

#[test]
fn encrypted_and_corrupt_entries_are_refused_and_removed() {
    let mut bytes =
        zipped(&|writer| (0..3).for_each(|i| add(writer, &format!("{i}.jpg"), &jpeg(i))));
    let whole = bytes.clone();
    // Bit 0 of the flags, at offset 8 in each central header.
    let at = find(&bytes, b"PK\x01\x02").expect("a central header");
    bytes[at + 8] |= 1;
    let (outcome, left) = open_zip(&bytes);
    assert!(outcome.expect_err("encrypted").to_string().contains("0.jpg"));
    assert_eq!(left.len(), 1);
    let mut bytes = whole;
    bytes[60] ^= 0x55;
    let (outcome, left) = open_zip(&bytes);
    assert!(outcome.expect_err("corrupt").to_string().contains("0.jpg"));
    assert_eq!(left.len(), 1);
}

fn find(bytes: &[u8], pattern: &[u8]) -> Option<usize> {
    bytes.windows(pattern.len()).position(|window| window == pattern)
}

/// Replaces a name of equal length everywhere.
fn replace(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len(), "names of equal length");
    let mut bytes = bytes.to_vec();
    while let Some(at) = find(&bytes, from) {
        bytes[at..at + from.len()].copy_from_slice(to);
    }
    bytes
}

#[test]
fn other_files_in_a_zip_are_listed_and_not_unpacked() {
    let bytes = zipped(&|writer| {
        (0..3).for_each(|i| add(writer, &format!("images/{i}.jpg"), &jpeg(i)));
        add(writer, "images/walk.mov", b"a video");
        add(writer, "images/more.rar", b"an archive");
        add(writer, "images/notes.pdf", b"notes");
    });
    let (outcome, left) = open_zip(&bytes);
    let capture = outcome.expect("a capture");
    let unused: Vec<&str> = { capture.assessments.iter() }
        .filter(|assessment| !assessment.accepted)
        .map(|assessment| assessment.name.as_str())
        .collect();
    assert_eq!(unused, ["more.rar", "walk.mov"]);
    assert_eq!(left.len(), 1 + 3);
}

#[test]
fn the_second_byte_of_a_character_is_not_a_separator() {
    let bytes = zipped(&|writer| {
        (0..3).for_each(|i| add(writer, &format!("images/xx{i}.jpg"), &jpeg(i)));
    });
    // A katakana in code page 932.
    let bytes = replace(&bytes, b"images/xx", b"images/\x83\x5c");
    let capture = open_zip(&bytes).0.expect("a capture");
    for view in &capture.views {
        assert_eq!(view.path.folder(), "", "{}", view.path);
    }
    let bytes = replace(&bytes, b"images/", b"images\\");
    assert_eq!(open_zip(&bytes).0.expect("a capture").views.len(), 3);
}

/// Sets the unpacked size of the entry with this name in the archive's directory.
fn with_size(bytes: &[u8], name: &str, size: u32) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let at = (0..bytes.len()).rfind(|&at| bytes[at..].starts_with(name.as_bytes()));
    let head = at.expect("the entry") - 46;
    assert!(bytes[head..].starts_with(b"PK\x01\x02"), "in the directory");
    bytes[head + 24..head + 28].copy_from_slice(&size.to_le_bytes());
    bytes
}

#[test]
fn limits_apply_to_unpacked_files_and_the_rest_is_listed_or_skipped() {
    for (name, expected) in [
        ("images/walk.mov", Some("a video")),
        ("images/walk.mkv", Some("Matroska")),
        ("images/layers.psd", Some("Photoshop")),
        ("library.db", None),
        ("images/points.csv", None),
        ("model.json", None),
    ] {
        let bytes = zipped(&|writer| {
            (0..3).for_each(|i| add(writer, &format!("images/{i}.jpg"), &jpeg(i)));
            add(writer, name, b"0123456789");
        });
        // Nine of them also exceed the limit of an archive.
        let (outcome, left) = open_zip(&with_size(&bytes, name, 900 << 20));
        let capture = outcome.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(capture.views.len(), 3, "{name}");
        let reasons = capture.assessments.iter().filter_map(|one| one.reason.as_deref());
        let reasons: Vec<&str> = reasons.collect();
        assert_eq!(reasons.len(), usize::from(expected.is_some()), "{name}: {reasons:?}");
        assert!(
            expected.is_none_or(|expected| reasons[0].contains(expected)),
            "{name}: {reasons:?}"
        );
        assert_eq!(left.len(), 1 + 3, "{name}: {left:?}");
        let (outcome, _) = open_zip(&with_size(&bytes, "images/2.jpg", 900 << 20));
        assert!(outcome.expect_err("a bomb").to_string().contains("shrunk"));
    }
}

#[test]
fn a_video_that_is_not_unpacked_hides_no_bomb() {
    let zeros = vec![0; 1 << 20];
    let noise: Vec<u8> =
        (0..4_u64 << 20).map(|i| (i.wrapping_mul(i * 2_654_435_761) >> 13) as u8).collect();
    let bytes = zipped(&|writer| {
        (0..3).for_each(|i| add(writer, &format!("{i}.jpg"), &jpeg(i)));
        add(writer, "walk.mov", &noise);
        (0..80).for_each(|i| add(writer, &format!("zeros-{i}.jpg"), &zeros));
    });
    let error = open_zip(&bytes).0.expect_err("80 MiB in some 80 kB");
    assert!(error.to_string().contains("together"), "{error}");
}
