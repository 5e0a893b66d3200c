//! Tests of the networks on two small pictures against the published code (`reference.json`, made
//! by matcher_reference.py in training/), and on whole captures.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::self_test::plane;
use super::*;
use crate::cancel::CancelToken;
use crate::image::{EncodeFormat, Image, Srgb};
use crate::inference::runtime;
use crate::poses::PosesError;
use crate::poses::matching::{Correspondences, Keeping, Matching, Pairs};

#[derive(Deserialize)]
struct Reference {
    pictures: [Picture; 2],
    /// Row, column, score.
    matches: Vec<(u32, u32, f32)>,
}

#[derive(Deserialize)]
struct Picture {
    size: (usize, usize),
    corner: (u32, u32),
    checksum: u64,
    /// x, y, score.
    points: Vec<(f32, f32, f32)>,
    descriptors: Vec<Vec<f32>>,
}

fn reference() -> Reference {
    serde_json::from_str(include_str!("reference.json")).expect("a test's own file")
}

fn picture(of: &Picture) -> Image<Srgb> {
    let (width, height) = of.size;
    let values: Vec<u32> = (0..width * height)
        .map(|i| plane(of.corner.0 + (i % width) as u32, of.corner.1 + (i / width) as u32))
        .collect();
    assert_eq!(values.iter().map(|&v| u64::from(v)).sum::<u64>(), of.checksum);
    let one: Vec<f32> = values.iter().map(|&v| v as f32 / 255.0).collect();
    Image::from_planar(width, height, [&*one, &one, &one].concat())
}

fn weights_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.matcher")
}

fn matching() -> LearnedMatching {
    let options = SearchOptions { threads: 2, ..SearchOptions::default() };
    LearnedMatching::open(&runtime::for_tests(), &[weights_folder()], options)
        .unwrap_or_else(|error| panic!("{error}: `make matcher` gets them"))
}

#[test]
fn key_points_match_the_published_code_before_refinement() {
    let mut extractor = matching().extractor().expect("usable");
    for known in &reference().pictures {
        let found = extractor.key_points(&picture(known), 64).expect("runs");
        assert_eq!(found.len(), known.points.len());
        for (index, &(x, y, score)) in known.points.iter().enumerate() {
            let [at_x, at_y] = found.positions[index];
            // Refined by half a pixel at most, relative to the middle of the pixel.
            let scale = (known.size.0 as f32 / 160.0, known.size.1 as f32 / 128.0);
            let away = ((at_x - x) / scale.0 - 0.5, (at_y - y) / scale.1 - 0.5);
            assert!(away.0.abs() < 0.501 && away.1.abs() < 0.501, "{index}: {away:?}");
            assert!((found.scores[index] - score).abs() < 1e-4, "{index}");
            let worst = known.descriptors[index]
                .iter()
                .zip(found.descriptor(index))
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            assert!(worst < 1e-4, "{index}: a descriptor is off by {worst}");
        }
    }
}

#[test]
fn matches_are_those_of_the_published_code() {
    let matching = matching();
    let (mut extractor, mut matcher) =
        (matching.extractor().expect("usable"), matching.matcher().expect("usable"));
    let reference = reference();
    let [a, b] = reference
        .pictures
        .each_ref()
        .map(|known| extractor.key_points(&picture(known), 64).expect("runs"));
    let found = matcher.matches(&a, &b).expect("runs");
    let known: Vec<(u32, u32)> = reference.matches.iter().map(|m| (m.0, m.1)).collect();
    let ours: Vec<(u32, u32)> = found.iter().map(|m| (m.first, m.second)).collect();
    // Refined positions may move a match above or below the threshold.
    let shared = ours.iter().filter(|pair| known.contains(pair)).count();
    assert!(shared + 2 >= known.len() && shared + 2 >= ours.len(), "{ours:?} {known:?}");
}

#[test]
fn refined_matches_follow_the_offset_of_the_pictures() {
    let matching = matching();
    let (mut extractor, mut matcher) =
        (matching.extractor().expect("usable"), matching.matcher().expect("usable"));
    let reference = reference();
    let corners = reference.pictures.each_ref().map(|known| known.corner);
    let [a, b] = reference
        .pictures
        .each_ref()
        .map(|known| extractor.key_points(&picture(known), 256).expect("runs"));
    let found = matcher.matches(&a, &b).expect("runs");
    let shift =
        [corners[1].0 as f32 - corners[0].0 as f32, corners[1].1 as f32 - corners[0].1 as f32];
    let median = |place: &dyn Fn(&KeyPoints, u32) -> [f32; 2]| {
        let away = |of: &Match| {
            let ([ax, ay], [bx, by]) = (place(&a, of.first), place(&b, of.second));
            (ax - bx - shift[0]).hypot(ay - by - shift[1])
        };
        let mut away: Vec<f32> = found.iter().map(away).collect();
        away.sort_by(f32::total_cmp);
        away[away.len() / 2]
    };
    let refined = median(&|of, index| of.positions[index as usize]);
    // The network shrinks the second picture by a tenth.
    let whole = median(&|of, index| {
        let scale = [of.width as f32 / 160.0, of.height as f32 / 128.0];
        let [x, y] = of.positions[index as usize];
        [
            ((x / scale[0] - 0.5).round() + 0.5) * scale[0],
            ((y / scale[1] - 0.5).round() + 0.5) * scale[1],
        ]
    });
    assert!(found.len() > 30, "{} matches", found.len());
    assert!(refined < 1.2, "median {refined} px; in whole pixels {whole} px");
    assert!(refined < whole, "median {refined} px; in whole pixels {whole} px");
}

/// Three overlapping pictures and an unrelated one, as files.
fn capture(folder: &Path) -> Vec<PathBuf> {
    let part = |index: usize, corner: (u32, u32)| {
        let known = Picture {
            size: (192, 160),
            corner,
            checksum: 0,
            points: Vec::new(),
            descriptors: Vec::new(),
        };
        let values: Vec<f32> = (0..192 * 160_usize)
            .map(|i| plane(corner.0 + (i % 192) as u32, corner.1 + (i / 192) as u32) as f32 / 255.0)
            .collect();
        let image = Image::<Srgb>::from_planar(
            known.size.0,
            known.size.1,
            [&*values, &values, &values].concat(),
        );
        let path = folder.join(format!("{index}.png"));
        image.save_as(&path, EncodeFormat::Png).expect("written");
        path
    };
    [(0, 0), (20, 10), (45, 20), (2000, 2000)]
        .into_iter()
        .enumerate()
        .map(|(index, corner)| part(index, corner))
        .collect()
}

#[test]
fn overlapping_pictures_match_and_progress_is_reported() {
    let folder = tempfile::tempdir().expect("temporary directory");
    let pictures = capture(folder.path());
    let mut progress = Vec::new();
    let found = matching()
        .matches(
            &pictures,
            Pairs::Within,
            None,
            &mut |done, total| progress.push((done, total)),
            &CancelToken::new(),
        )
        .expect("runs");
    assert_eq!(found.key_points.len(), 4);
    let matches = |first, second| {
        let pair = found.pairs.iter().find(|pair| (pair.first, pair.second) == (first, second));
        pair.map_or(0, |pair| pair.matches.len())
    };
    assert!(matches(0, 1) > 40 && matches(1, 2) > 40, "{} {}", matches(0, 1), matches(1, 2));
    assert!(matches(0, 3) < 20 && matches(2, 3) < 20);
    assert_eq!(progress.first(), Some(&(1, 4 + 6)), "of pictures and pairs together");
    assert_eq!(progress.last(), Some(&(4 + 6, 4 + 6)));
    assert!(progress.windows(2).all(|pair| pair[0].0 <= pair[1].0), "{progress:?}");
}

/// A search of `pictures` that keeps its matches in `file` and is cancelled after `most` pictures
/// and pairs, with the progress that it reported.
fn search(
    pictures: &[PathBuf],
    file: &Path,
    most: u64,
) -> (Result<Correspondences, PosesError>, Vec<(u64, u64)>) {
    let (cancel, mut progress) = (CancelToken::new(), Vec::new());
    let mut advance = |done, total| {
        progress.push((done, total));
        if done >= most {
            cancel.cancel();
        }
    };
    let keeping = Some(Keeping { file, stamp: "build", earlier: &[] });
    let found = matching().matches(pictures, Pairs::Within, keeping, &mut advance, &cancel);
    (found, progress)
}

#[test]
fn an_interrupted_search_matches_only_the_pairs_that_it_lacks() {
    let folder = tempfile::tempdir().expect("temporary directory");
    let pictures = capture(folder.path());
    let file = |name| folder.path().join(name);
    let (whole, _) = search(&pictures, &file("whole"), u64::MAX);
    let whole = whole.expect("runs");
    let (interrupted, _) = search(&pictures, &file("kept"), 4 + 2);
    assert!(matches!(interrupted, Err(PosesError::Cancelled(_))), "{interrupted:?}");
    let (resumed, progress) = search(&pictures, &file("kept"), u64::MAX);
    let resumed = resumed.expect("runs");
    assert!((2..6).contains(&resumed.kept), "{}", resumed.kept);
    assert_eq!((&resumed.key_points, &resumed.pairs), (&whole.key_points, &whole.pairs));
    let kept = resumed.kept as u64;
    let expected: Vec<_> = (1..4).chain(4 + kept..=4 + 6).map(|done| (done, 4 + 6)).collect();
    assert_eq!(progress, expected, "kept pairs count at once, and the others one by one");
    // Each pair that is matched adds a record.
    let bytes = |name| std::fs::metadata(file(name)).expect("kept").len();
    assert_eq!(bytes("kept"), bytes("whole"));

    let (again, _) = search(&pictures, &file("kept"), u64::MAX);
    assert_eq!(again.expect("runs").kept, 6);
    // Another photograph is matched with each of the others, and they are not matched again.
    let (most, _) = search(&pictures[..3], &file("few"), u64::MAX);
    assert_eq!(most.expect("runs").kept, 0);
    let (one_more, _) = search(&pictures, &file("few"), u64::MAX);
    let one_more = one_more.expect("runs");
    assert_eq!((one_more.kept, one_more.pairs), (3, whole.pairs));
}

#[test]
fn many_photographs_have_half_the_key_points_or_more() {
    let options = SearchOptions::default();
    let of = |photographs| options.key_points_of(pairs::count(photographs, Pairs::Within));
    assert_eq!([of(3), of(16)], [2048, 2048]);
    assert!((1200..1400).contains(&of(25)), "{}", of(25));
    assert_eq!([of(60), of(300)], [1024, 1024]);
}

#[test]
fn a_cancelled_search_ends_and_errors_name_broken_pictures() {
    let folder = tempfile::tempdir().expect("temporary directory");
    let mut pictures = capture(folder.path());
    let cancel = CancelToken::new();
    cancel.cancel();
    let cancelled = matching().matches(&pictures, Pairs::Within, None, &mut |_, _| {}, &cancel);
    assert!(matches!(cancelled, Err(PosesError::Cancelled(_))));
    std::fs::write(folder.path().join("broken.png"), "no picture").expect("written");
    pictures.push(folder.path().join("broken.png"));
    let broken =
        matching().matches(&pictures, Pairs::Within, None, &mut |_, _| {}, &CancelToken::new());
    let text = broken.expect_err("no picture").to_string();
    assert!(text.contains("broken.png"), "{text}");
}

#[test]
fn a_grey_picture_has_no_key_points_and_no_matches() {
    let matching = matching();
    let mut extractor = matching.extractor().expect("usable");
    let mut grey = Image::<Srgb>::new(64, 40);
    grey.data_mut().fill(0.4);
    let found = extractor.key_points(&grey, 64).expect("runs");
    let none = KeyPoints { width: 64, height: 40, ..KeyPoints::default() };
    let mut matcher = matching.matcher().expect("usable");
    assert_eq!(matcher.matches(&found, &none).expect("nothing to do"), []);
}

#[test]
fn wrong_networks_fail_the_self_test() {
    let matching = matching();
    let mut extractor = matching.extractor().expect("usable");
    let mut matcher = matching.matcher().expect("usable");
    assert_eq!(self_test::run(&mut extractor, &mut matcher), Ok(()));
    // Weights of the right size and sum without meaning.
    let shuffled = matching.with_weights_shuffled();
    let mut matcher = shuffled.matcher().expect("loads all the same");
    let fault = self_test::run(&mut extractor, &mut matcher).expect_err("nonsense");
    assert!(fault.contains("are right"), "{fault}");
}
