//! Key points and matches supplied from outside COLMAP.

use glam::{DMat4, DQuat, DVec3};

use super::*;
use crate::poses::PoseStatus;
use crate::poses::align::Similarity;
use crate::poses::matching::{Correspondences, Keeping, Matching, PairMatches, Pairs};

/// A script whose mapper places every photograph, but none by COLMAP's own features.
const PLACES_ALL: &str = r#"
case "$out" in *sparse-[A-E]) exit 0;; esac
if [ "$command" = mapper ]; then model "$out/0" 10 10; fi; exit 0"#;

/// A script whose mapper places every photograph, whatever its input.
const PLACES_ALWAYS: &str = r#"
if [ "$command" = mapper ]; then model "$out/0" 10 10; fi; exit 0"#;

/// Forty matches between each pair of neighbours; the stub's cameras are side by side, so matches
/// on one row fit them.
struct Neighbours {
    /// Photographs whose matches are on other rows.
    contradicting: Vec<usize>,
    /// A photograph without matches to the next one.
    last_of_a_place: Option<usize>,
}

impl Matching for Neighbours {
    fn matches(
        &self,
        pictures: &[PathBuf],
        pairs: Pairs,
        _: Option<Keeping<'_>>,
        advance: &mut dyn FnMut(u64, u64),
        cancel: &CancelToken,
    ) -> Result<Correspondences, PosesError> {
        cancel.check()?;
        assert_eq!(pairs, Pairs::Within);
        assert!(pictures.iter().all(|picture| picture.is_file()));
        let row = |view: usize, point: usize| {
            let shift = if self.contradicting.contains(&view) { 13 } else { 0 };
            ((point * 7 + point * shift) % 32) as f32
        };
        let points = |view| (0..40).map(|point| [point as f32, row(view, point)]).collect();
        let count = pictures.len();
        advance(count as u64, count as u64);
        let pair = |first| PairMatches {
            first,
            second: first + 1,
            matches: (0..40).map(|point| [point, point]).collect(),
        };
        Ok(Correspondences {
            key_points: (0..count).map(points).collect(),
            pairs: (0..count - 1)
                .filter(|first| Some(*first) != self.last_of_a_place)
                .map(pair)
                .collect(),
            kept: 0,
        })
    }

    fn describe(&self) -> String {
        "a stand-in".to_owned()
    }
}

/// Networks that fail.
struct Broken;

impl Matching for Broken {
    fn matches(
        &self,
        _: &[PathBuf],
        _: Pairs,
        _: Option<Keeping<'_>>,
        _: &mut dyn FnMut(u64, u64),
        _: &CancelToken,
    ) -> Result<Correspondences, PosesError> {
        Err(PosesError::Matching { detail: "no such node".to_owned() })
    }

    fn describe(&self) -> String {
        "broken".to_owned()
    }
}

fn statuses(poses: &Poses) -> Vec<PoseStatus> {
    poses.verdicts.iter().map(|verdict| verdict.status).collect()
}

#[test]
fn learned_matches_come_first_and_their_model_is_trusted() {
    let scene = Scene::new(10, PLACES_ALL);
    let matching = Neighbours { contradicting: Vec::new(), last_of_a_place: None };
    let tool = scene.tool().with_matching(Arc::new(matching));
    assert!(tool.describe().ends_with(", a stand-in"));
    let poses = scene.run(&tool, &mut Silent, &CancelToken::new()).unwrap();
    assert_eq!((poses.registered, poses.strategy), (10, Some('L')));
    assert!(!poses.low_confidence);
    assert_eq!(statuses(&poses), [PoseStatus::Registered; 10]);
    let middle = &poses.verdicts[4];
    assert_eq!((middle.matches, middle.fitting), (80, 80));
    let log = scene.log();
    let at = |command: &str| log.find(command).expect(command);
    assert!(at("feature_importer") < at("matches_importer"));
    assert!(at("matches_importer") < at("feature_extractor"));
    assert!(!log.contains("sparse-C"), "the first strategy alone might do better");
    let folder = scene.work_dir().join("learned");
    let features = std::fs::read_to_string(folder.join("view3.png.txt")).unwrap();
    assert_eq!(features.lines().next(), Some("40 128"));
    let second = features.lines().nth(2).unwrap();
    assert!(second.starts_with("1 7 1 0 0"), "{second}");
    assert_eq!(second.split(' ').count(), 4 + 128);
    let matches = std::fs::read_to_string(folder.join("matches.txt")).unwrap();
    assert!(matches.starts_with("view0.png view1.png\n0 0\n1 1\n"));
    assert_eq!(matches.matches("\n\n").count(), 9);
}

#[test]
fn a_place_that_stronger_matches_contradict_is_left_out_by_name() {
    let scene = Scene::new(10, PLACES_ALL);
    let matching = Neighbours { contradicting: vec![9], last_of_a_place: None };
    let tool = scene.tool().with_matching(Arc::new(matching));
    let poses = scene.run(&tool, &mut Silent, &CancelToken::new()).unwrap();
    assert_eq!((poses.registered, poses.total), (9, 10));
    assert!(poses.views.iter().all(|view| view.name != "view9"));
    assert_eq!(statuses(&poses)[8..], [PoseStatus::Registered, PoseStatus::Doubtful]);
    // All photographs see the stub's points.
    assert!(poses.points.iter().all(|point| point.track == 9));
    assert!(!poses.low_confidence, "nine of ten are enough");
}

#[test]
fn a_model_with_mostly_contradicted_places_is_not_trusted() {
    let scene = Scene::new(10, PLACES_ALL);
    let matching =
        Neighbours { contradicting: (3..10).step_by(2).collect(), last_of_a_place: None };
    let tool = scene.tool().with_matching(Arc::new(matching));
    let error = scene.run(&tool, &mut Silent, &CancelToken::new()).unwrap_err();
    assert!(matches!(error, PosesError::TooFew { registered: 3, total: 10, .. }), "{error}");
}

#[test]
fn of_two_equally_complete_models_the_more_precise_one_is_used() {
    // Equal precision: COLMAP's own points are finer.
    let scene = Scene::new(10, PLACES_ALWAYS);
    let matching = || Neighbours { contradicting: Vec::new(), last_of_a_place: None };
    let strategy = |scene: &Scene| {
        let tool = scene.tool().with_matching(Arc::new(matching()));
        let poses = scene.run(&tool, &mut Silent, &CancelToken::new()).unwrap();
        (poses.registered, poses.strategy)
    };
    assert_eq!(strategy(&scene), (10, Some('A')));
    let fewer_observations = r#"
if [ "$command" = mapper ]; then
  case "$out" in *sparse-A) model "$out/0" 10 7;; *) model "$out/0" 10 10;; esac
fi; exit 0"#;
    assert_eq!(strategy(&Scene::new(10, fewer_observations)), (10, Some('L')));
}

#[test]
fn failing_networks_are_reported_and_colmaps_own_features_used() {
    let scene = Scene::new(10, PLACES_ALWAYS);
    let tool = scene.tool().with_matching(Arc::new(Broken));
    let mut codes = Vec::new();
    let mut sink = |event: &Event| {
        if let Event::Warning { code, message } = event {
            codes.push((code.clone(), message.clone()));
        }
    };
    let poses = scene.run(&tool, &mut sink, &CancelToken::new()).unwrap();
    assert_eq!((poses.registered, poses.strategy), (10, Some('A')));
    assert_eq!(codes.len(), 1);
    assert!(codes[0].0 == "matcher_failed" && codes[0].1.contains("no such node"), "{codes:?}");
}

#[test]
fn a_capture_of_two_places_names_the_connected_photographs() {
    let scene = Scene::new(10, PLACES_ALL);
    let two = |last_of_a_place| {
        let matching =
            Neighbours { contradicting: Vec::new(), last_of_a_place: Some(last_of_a_place) };
        let tool = scene.tool().with_matching(Arc::new(matching));
        scene.run(&tool, &mut Silent, &CancelToken::new())
    };
    let poses = two(5).unwrap();
    assert!((poses.registered, poses.low_confidence) == (6, true));
    let names = |of: std::ops::Range<usize>| -> Vec<String> {
        of.map(|index| format!("view{index}")).collect()
    };
    assert_eq!(poses.parts, [names(0..6), names(6..10)]);
    // One photograph that matches no other is not a second place.
    assert!(two(8).unwrap().parts.is_empty());
}

#[test]
fn parts_too_small_for_a_scene_are_named_in_the_error() {
    let scene = Scene::new(
        10,
        r#"
if [ "$command" = mapper ]; then model "$out/0" 4 4; fi; exit 0"#,
    );
    let matching = Neighbours { contradicting: Vec::new(), last_of_a_place: Some(4) };
    let tool = scene.tool().with_matching(Arc::new(matching));
    let error = scene.run(&tool, &mut Silent, &CancelToken::new()).unwrap_err();
    let PosesError::TooFew { registered: 4, total: 10, advice } = error else {
        panic!("{error}");
    };
    assert!(advice.contains("2 places"), "{advice}");
    assert!(advice.contains("5 (photographs/0.jpg, photographs/1.jpg"), "{advice}");
}

#[test]
fn no_strategy_is_tried_where_matches_connect_too_few_photographs_for_a_scene() {
    let apart = |count: usize| {
        let scene = Scene::new(count, PLACES_ALWAYS);
        let (mut tried, mut overlap) = (Vec::new(), None);
        let mut sink = |event: &Event| match event {
            Event::StrategyStarted { strategy, .. } => tried.push(*strategy),
            Event::OverlapFound(found) => overlap = Some(found.clone()),
            _ => {}
        };
        let matching = Neighbours { contradicting: Vec::new(), last_of_a_place: Some(1) };
        let tool = scene.tool().with_matching(Arc::new(matching));
        let found = scene.run(&tool, &mut sink, &CancelToken::new());
        (found, overlap, tried, scene.log())
    };
    let (found, overlap, tried, log) = apart(4);
    let names = |views: [usize; 2]| views.map(|view| format!("view{view}")).to_vec();
    assert_eq!(overlap.expect("two groups").groups, [names([0, 1]), names([2, 3])]);
    let Err(PosesError::TooFew { registered: 0, total: 4, advice }) = found else {
        panic!("{found:?}");
    };
    assert!(advice.contains("groups of 2 and 2"), "{advice}");
    assert_eq!(tried, ['L']);
    assert!(!log.contains("mapper"), "no model can have three photographs: {log}");
    // One more makes a scene of three of five, which other strategies can only make more exact.
    let (found, overlap, tried, _) = apart(5);
    let poses = found.unwrap();
    assert_eq!(overlap, None, "nothing failed");
    assert_eq!((poses.registered, poses.low_confidence), (3, true));
    assert_eq!(tried, ['L', 'A']);
}

/// Neighbours of whom every second pair has ten times the matches, like two of another place.
struct Rooms(Neighbours);

impl Matching for Rooms {
    fn matches(
        &self,
        pictures: &[PathBuf],
        pairs: Pairs,
        keeping: Option<Keeping<'_>>,
        advance: &mut dyn FnMut(u64, u64),
        cancel: &CancelToken,
    ) -> Result<Correspondences, PosesError> {
        let mut found = self.0.matches(pictures, pairs, keeping, advance, cancel)?;
        for pair in found.pairs.iter_mut().step_by(2) {
            pair.matches = pair.matches.repeat(10);
        }
        Ok(found)
    }

    fn describe(&self) -> String {
        self.0.describe()
    }
}

#[test]
fn a_broken_tool_is_not_taken_for_photographs_of_different_places() {
    let found = |script: &str| {
        let scene = Scene::new(10, script);
        let tool = scene.tool().with_matching(Arc::new(Rooms(in_order())));
        scene.run(&tool, &mut Silent, &CancelToken::new()).unwrap_err()
    };
    let error = found("[ $command = mapper ] && kill -SEGV $$; exit 0");
    assert!(matches!(&error, PosesError::Tool { .. }), "{error}");
    let error = found("exit 0");
    let PosesError::TooFew { advice, .. } = error else { panic!("{error}") };
    assert!(advice.contains("groups of 2, 2, 2, 2 and 2"), "{advice}");
}

/// The stub's cameras in a rotated world of twice the size, with those of `off` misplaced.
fn given(scene: &Scene, off: &[usize]) -> Vec<PosedView> {
    let world = Similarity {
        scale: 2.0,
        rotation: DQuat::from_rotation_z(0.7),
        translation: DVec3::new(1.0, 2.0, 3.0),
    };
    let tool = scene.tool().with_matching(Arc::new(in_order()));
    let found = scene.run(&tool, &mut Silent, &CancelToken::new()).unwrap();
    let place = |(index, view): (usize, &PosedView)| {
        let mut camera = world.camera(&view.camera);
        if off.contains(&index) {
            let turn = DMat4::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 0.2);
            camera.world_to_camera = turn * camera.world_to_camera;
        }
        PosedView { camera, ..view.clone() }
    };
    found.views.iter().enumerate().map(place).collect()
}

fn in_order() -> Neighbours {
    Neighbours { contradicting: Vec::new(), last_of_a_place: None }
}

fn refined(scene: &Scene, given: &[PosedView]) -> Result<Option<Poses>, PosesError> {
    refined_by(scene, given, in_order(), &mut Silent)
}

fn refined_by(
    scene: &Scene,
    given: &[PosedView],
    matching: Neighbours,
    sink: &mut dyn ProgressSink,
) -> Result<Option<Poses>, PosesError> {
    let tool = scene.tool().with_matching(Arc::new(matching));
    let request = PoseRequest {
        views: &scene.views,
        work_dir: &scene.work_dir(),
        seed: 1,
        stamp: "",
        earlier: &[],
    };
    tool.refine(&request, given, sink, &CancelToken::new())
}

#[test]
fn given_poses_that_the_matches_contradict_are_refined_in_their_own_world() {
    let scene = Scene::new(10, PLACES_ALL);
    let mut rough = given(&scene, &[2, 7]);
    let truth = given(&scene, &[]);
    // One had no given pose.
    rough.remove(4);
    let poses = refined(&scene, &rough).unwrap().expect("better ones");
    assert_eq!((poses.registered, &*poses.source), (10, "given, refined by colmap 3.8"));
    for (view, truth) in poses.views.iter().zip(&truth) {
        assert_eq!(view.name, truth.name);
        let away = view.camera.centre().distance(truth.camera.centre());
        let ahead = view.camera.forward().dot(truth.camera.forward());
        assert!(away < 1e-4 && ahead > 1.0 - 1e-6, "{}: {away}, {ahead}", view.name);
    }
    let between = poses.views[0].camera.centre().distance(poses.views[1].camera.centre());
    assert!((between - 2.0).abs() < 1e-4, "the given scale: {between}");
    let depth = poses.views[0].camera.project(poses.points[0].position.into());
    assert!(depth.is_some_and(|(_, depth)| (depth - 2.0).abs() < 1e-4), "{depth:?}");
}

#[test]
fn a_view_without_a_found_pose_keeps_and_reports_its_given_pose() {
    let scene = Scene::new(10, PLACES_ALL);
    let rough = given(&scene, &[2, 7]);
    let lost = Neighbours { contradicting: vec![9], last_of_a_place: None };
    let poses = refined_by(&scene, &rough, lost, &mut Silent).unwrap();
    let poses = poses.expect("better ones");
    assert_eq!(poses.registered, 10);
    assert_eq!(poses.views[9].camera, rough[9].camera);
    assert_eq!(statuses(&poses)[8..], [PoseStatus::Registered, PoseStatus::Given]);
}

#[test]
fn given_poses_are_kept_if_they_fit_as_well_or_cannot_be_checked() {
    let scene = Scene::new(10, PLACES_ALL);
    assert_eq!(refined(&scene, &given(&scene, &[])).unwrap(), None);
    let rough = given(&scene, &[2, 7]);
    let nothing = Scene::new(10, "exit 0");
    let mut codes = Vec::new();
    let mut sink = |event: &Event| {
        if let Event::Warning { code, .. } = event {
            codes.push(code.clone());
        }
    };
    let found = refined_by(&nothing, &rough, in_order(), &mut sink).unwrap();
    assert_eq!((found, &*codes), (None, &["poses_unrefined".to_owned()][..]));
    let request = PoseRequest {
        views: &scene.views,
        work_dir: &scene.work_dir(),
        seed: 1,
        stamp: "",
        earlier: &[],
    };
    let without = scene.tool().refine(&request, &rough, &mut Silent, &CancelToken::new());
    assert_eq!(without.unwrap(), None, "no networks");
}
