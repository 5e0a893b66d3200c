use super::*;
use proptest::prelude::*;

fn paths(written: &[&str]) -> Vec<PhotoPath> {
    written.iter().map(|path| PhotoPath::new(path)).collect()
}

/// The matches of `names` to `photographs`: the index of each photograph's name, or the error.
fn found(names: &[&str], photographs: &[&str]) -> Result<Vec<Option<usize>>, String> {
    find_each(&paths(names), &paths(photographs)).map_err(|tie| tie.to_string())
}

#[test]
fn a_path_is_the_same_however_systems_write_it() {
    for (written, path) in [
        ("cam0\\0000.jpg", "cam0/0000.jpg"),
        ("./images//a.jpg", "images/a.jpg"),
        ("../../images/a.jpg", "images/a.jpg"),
        ("/data/x/../a.jpg", "data/a.jpg"),
        ("cafe\u{301}.jpg", "caf\u{e9}.jpg"),
    ] {
        assert_eq!(PhotoPath::new(written).as_str(), path, "{written}");
    }
    let path = PhotoPath::new("a.b/c.d.jpg");
    assert_eq!((path.folder(), path.name(), path.stem()), ("a.b", "c.d.jpg", "a.b/c.d"));
    assert_eq!(PhotoPath::new("a.b/c").stem(), "a.b/c");
}

#[test]
fn the_whole_path_takes_precedence_and_the_rest_gets_nothing() {
    let photographs = ["cam0/0.jpg", "cam1/0.jpg", "DSC 0.jpg", "DSC_0.jpg", "a.jpg", "a.png"];
    let names = ["DSC_0.jpg", "cam1/0.jpg", "a.png"];
    let expected = vec![None, Some(1), None, Some(0), None, Some(2)];
    assert_eq!(found(&names, &photographs), Ok(expected));
    // Consecutive numbers do not match each other.
    assert_eq!(found(&["00002.jpg"], &["00001.jpg", "00003.jpg"]), Ok(vec![None, None]));
}

#[test]
fn folders_extensions_and_case_may_differ_if_one_photograph_is_left() {
    for (name, photograph) in [
        ("/home/me/set/images/cam0/0.jpg", "cam0/0.jpg"),
        ("C:\\set\\images\\0.jpg", "0.jpg"),
        ("./train/r_0", "r_0.png"),
        ("r_0.5", "r_0.5.png"),
        ("0.jpg", "cam0/0.jpg"),
        ("left/0.jpg", "cam0/0.jpg"),
        ("IMG_1.CR2", "IMG_1.tif"),
        ("IMG_1.JPG", "img_1.jpg"),
        ("\u{c9}.jpg", "e\u{301}.jpg"),
    ] {
        let photographs = [photograph, "another/photograph.jpg"];
        assert_eq!(found(&[name], &photographs), Ok(vec![Some(0), None]), "{name}");
    }
    // If folders agree elsewhere, a different folder belongs to another photograph.
    let names = ["cam0/0.jpg", "cam0/1.jpg"];
    assert_eq!(found(&names, &["cam0/0.jpg", "cam1/1.jpg"]), Ok(vec![Some(0), None]));
    // A number after a dot is not an extension.
    assert_eq!(found(&["r_0.5"], &["r_0.25.png"]), Ok(vec![None]));
}

#[test]
fn a_folder_is_ignored_as_elsewhere_or_if_a_name_is_unique() {
    for (names, photographs, right) in [
        // The second camera's photographs are missing; the one with the same name is another.
        (["cam0/3.jpg", "cam1/3.jpg"], ["cam0/3.jpg", "3.jpg"], [Some(0), None]),
        (["cam0/3.jpg", "3.jpg"], ["cam0/3.jpg", "cam1/3.jpg"], [Some(0), None]),
        (["images/a/0.jpg", "images/0.jpg"], ["a/0.jpg", "0.jpg"], [Some(0), Some(1)]),
        (["0.jpg", "cam0/6.jpg"], ["0.jpg", "6.jpg"], [Some(0), Some(1)]),
        // Case differs more often than the format.
        (["IMG_1.jpg", "IMG_2.png"], ["IMG_1.JPG", "IMG_1.PNG"], [Some(0), None]),
    ] {
        assert_eq!(found(&names, &photographs), Ok(right.to_vec()), "{names:?}");
    }
}

#[test]
fn names_in_other_encodings_stay_distinct_and_complete() {
    assert_eq!(decoded("Küche".as_bytes()), "Küche");
    assert_eq!(decoded(b"K\x81che \x80\xff"), "Küche Ç\u{a0}");
    // In Japan's code page the second byte of some characters is a backslash.
    assert_eq!(PhotoPath::new(&decoded(b"\x95\x5c.jpg")).folder(), "");
    assert_eq!(PhotoPath::new(&decoded(b"\x95\x5c\\a.jpg")).name(), "a.jpg");
    let of = |first: u8| PhotoPath::new(&decoded(&[first, 0xba, b'.', b'j']));
    let all: std::collections::HashSet<_> = (128..=254).map(of).collect();
    assert_eq!(all.len(), 127);
}

#[test]
fn a_tie_names_both() {
    for (names, photographs, words) in [
        (&["0.jpg"][..], &["cam0/0.jpg", "cam1/0.jpg"][..], "`cam0/0.jpg` and `cam1/0.jpg`"),
        (&["cam0/0.jpg", "cam1/0.jpg"], &["0.jpg"], "`cam0/0.jpg` and `cam1/0.jpg` may all be `0"),
        (&["a"], &["a.jpg", "a.png"], "`a.jpg` and `a.png`"),
        (&["A.JPG"], &["a.jpg", "a.JPG"], "`a.jpg` and `a.JPG`"),
        (&["a.jpg"], &["a.jpg", "a.jpg"], "any of 2 photographs of this name"),
        (&["a.jpg", "a.jpg"], &["a.jpg"], "`a.jpg` has 2 different poses"),
    ] {
        let error = found(names, photographs).expect_err("a tie");
        assert!(error.contains(words), "{error}");
    }
}

proptest! {
    /// However a program writes the paths of photographs, none gets another's name.
    #[test]
    fn every_photograph_has_its_own_name_or_none(
        photographs in prop::collection::hash_set(
            "((cam[01]|A|a|e\u{301}|b c)/){0,2}(DSC[ _])?[0-3aA](\\.(jpg|JPG|png))", 1..9),
        written in 0..8usize,
        left_out in 0..256usize,
    ) {
        let photographs: Vec<String> = photographs.into_iter().collect();
        let write = |path: &String| match written {
            0 => path.clone(),
            1 => path.replace('/', "\\"),
            2 => format!("./images/{path}"),
            3 => format!("/home/me/scene/images/{path}"),
            4 => path.rsplit_once('.').expect("an extension").0.to_owned(),
            5 => path.to_uppercase(),
            6 => path.rsplit('/').next().expect("a name").to_owned(),
            _ => path.replace("e\u{301}", "\u{e9}"),
        };
        // If the written paths are lossy, all photographs have a name.
        let lossy = (4..7).contains(&written);
        let kept = |at: usize| lossy || left_out >> at & 1 == 0;
        let known: Vec<usize> = (0..photographs.len()).filter(|&at| kept(at)).collect();
        let names: Vec<String> = known.iter().map(|&at| write(&photographs[at])).collect();
        let of = |all: &[String]| all.iter().map(|path| PhotoPath::new(path)).collect::<Vec<_>>();
        match find_each(&of(&names), &of(&photographs)) {
            Ok(found) => {
                for (at, found) in found.into_iter().enumerate() {
                    prop_assert!(found.is_none_or(|name| known[name] == at), "{}", photographs[at]);
                    prop_assert!(lossy || found.is_some() == kept(at), "{}", photographs[at]);
                }
            }
            Err(tie) => prop_assert!(lossy, "{tie}"),
        }
    }
}
