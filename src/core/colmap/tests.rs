//! COLMAP when it is missing, broken, slow, wrong or newer, replaced by shell scripts. The real one
//! is measured on captures, if available.

mod captures;
mod hangs;
mod learned;

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::*;
use crate::capture::PreparedImage;
use crate::event::{Event, Silent};
use crate::image::{Image, Linear, Srgb};
use crate::photo_path::PhotoPath;
use crate::poses::PoseView;

/// A stub for COLMAP: `help` and `-h` are answered; everything else is up to `body`, a shell
/// fragment with the command as `$1` and the value of `--output_path` as `$out`.
const PRELUDE: &str = r#"#!/bin/sh
case "$1" in help) echo "COLMAP 3.8 -- Structure-from-Motion"; exit 0;; esac
if [ "$2" = "-h" ]; then
  printf '  -h [ --help ]\n  --database_path arg\n  --image_path arg\n  --output_path arg\n  --random_seed arg (=0)\n'
  [ "$1" = feature_extractor ] && printf '  --SiftExtraction.use_gpu arg (=1)\n  --ImageReader.mask_path arg\n'
  [ "$1" = point_triangulator ] && printf "  --input_path arg\n"
  [ "$1" = exhaustive_matcher ] && printf '  --SiftMatching.use_gpu arg (=1)\n'
  exit 0
fi
command="$1"; all="$*"; out=
while [ $# -gt 0 ]; do [ "$1" = --output_path ] && out="$2"; shift; done
"#;

/// Shell: writes to `$1` a model of `$2` images and three points, each seen by `$3` of them.
const MODEL: &str = r#"
model() {
  mkdir -p "$1"
  echo '1 SIMPLE_RADIAL 48 32 50 24 16 0.01' > "$1/cameras.txt"; : > "$1/images.txt"; : > "$1/points3D.txt"
  i=0; while [ $i -lt $2 ]; do
    printf '%d 1 0 0 0 %d 0 0 1 view%d.png\n\n' $((i+1)) $i $i >> "$1/images.txt"; i=$((i+1)); done
  p=0; while [ $p -lt 100 ]; do
    track=; j=0; while [ $j -lt $3 ]; do track="$track $((j+1)) $p"; j=$((j+1)); done
    echo "$p 0 0 $((p+1)) 9 9 9 0.5$track" >> "$1/points3D.txt"; p=$((p+1)); done
}
"#;

struct Scene {
    dir: tempfile::TempDir,
    views: Vec<PoseView>,
}

impl Scene {
    fn new(count: usize, body: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut image: Image<Srgb> = Image::new(48, 32);
        image.data_mut().fill(0.1);
        let file = dir.path().join("photograph.png");
        image.save(&file).unwrap();
        let prepared = PreparedImage::write(&image.to_linear(), &file.with_extension("half"));
        let prepared = prepared.unwrap();
        let view = |i| PoseView {
            name: format!("view{i}"),
            path: PhotoPath::new(&format!("photographs/{i}.jpg")),
            prepared: prepared.clone(),
            original: (48, 32),
            focal_px: None,
            mask: None,
        };
        let script = dir.path().join("colmap");
        std::fs::write(&script, format!("{PRELUDE}{MODEL}{body}")).unwrap();
        std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
        Self { views: (0..count).map(view).collect(), dir }
    }

    fn tool(&self) -> ColmapCli {
        ColmapCli::new(self.dir.path().join("colmap"))
    }

    fn work_dir(&self) -> PathBuf {
        self.dir.path().join("work")
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.work_dir().join("colmap.log")).unwrap()
    }

    fn run(
        &self,
        tool: &ColmapCli,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError> {
        tool.poses(
            &PoseRequest {
                views: &self.views,
                work_dir: &self.work_dir(),
                seed: 1,
                stamp: "",
                earlier: &[],
            },
            sink,
            cancel,
        )
    }

    fn poses(&self) -> Result<Poses, PosesError> {
        self.run(&self.tool(), &mut Silent, &CancelToken::new())
    }
}

#[test]
fn a_good_model_of_strategy_a_is_used_at_the_originals_size() {
    let scene = Scene::new(10, r#"[ $command = mapper ] && model "$out/0" 10 10; exit 0"#);
    let mut stages = Vec::new();
    let mut sink = |event: &Event| {
        if let Event::StageAdvanced { done, total, .. } = event {
            stages.push((*done, *total));
        }
    };
    let poses = scene.run(&scene.tool(), &mut sink, &CancelToken::new()).unwrap();
    assert_eq!((poses.registered, poses.total, poses.strategy), (10, 10, Some('A')));
    assert_eq!(stages, [(0, 3), (1, 3), (2, 3), (3, 3)]);
    assert!(!poses.low_confidence);
    assert_eq!(poses.source, "colmap 3.8");
    let view = &poses.views[3];
    assert_eq!((view.name.as_str(), view.camera.translation().x), ("view3", 3.0));
    assert_eq!((view.lens.intrinsics.width, view.lens.intrinsics.fx), (48, 50.0));
    let json = serde_json::to_string(&poses).unwrap();
    assert_eq!(serde_json::from_str::<Poses>(&json).unwrap(), poses);
}

#[test]
fn known_poses_are_triangulated_at_the_copies_size() {
    let body = r#"[ $command = point_triangulator ] && model "$out" 10 10; exit 0"#;
    let scene = Scene::new(10, body);
    let request = PoseRequest {
        views: &scene.views,
        work_dir: &scene.work_dir(),
        seed: 1,
        stamp: "",
        earlier: &[],
    };
    let k =
        crate::camera::Intrinsics { width: 48, height: 32, fx: 50.0, fy: 51.0, cx: 24.0, cy: 16.0 };
    let posed: Vec<PosedView> = (0..9)
        .map(|n| {
            let at = glam::DVec3::new(f64::from(n), 0.0, 0.0);
            let camera = crate::camera::Camera::look_at(k, at, at + glam::DVec3::Z, glam::DVec3::Y);
            let lens =
                crate::poses::Lens { intrinsics: k, distortion: crate::poses::Distortion::None };
            PosedView { name: format!("view{n}"), camera, lens }
        })
        .collect();
    let points =
        scene.tool().triangulate(&request, &posed, &mut Silent, &CancelToken::new()).unwrap();
    assert_eq!((points.len(), points[0].track), (100, 10));
    let known = crate::poses::model::SparseModel::read(&scene.work_dir().join("known")).unwrap();
    assert_eq!((known.images.len(), known.images[3].name.as_str()), (9, "view3.png"));
    assert_eq!(known.images[3].world_to_camera(), posed[3].camera.world_to_camera);
    assert_eq!(known.cameras[3].params, [50.0, 51.0, 24.0, 16.0]);
    let failing = Scene::new(10, "exit 1");
    let request = PoseRequest {
        views: &failing.views,
        work_dir: &failing.work_dir(),
        seed: 1,
        stamp: "",
        earlier: &[],
    };
    assert!(
        failing.tool().triangulate(&request, &posed, &mut Silent, &CancelToken::new()).is_err()
    );
}

#[test]
fn the_gpu_is_never_requested() {
    let scene = Scene::new(10, r#"[ $command = mapper ] && model "$out/0" 10 10; exit 0"#);
    scene.poses().unwrap();
    let log = scene.log();
    assert!(
        log.contains("--SiftExtraction.use_gpu 0") && log.contains("--SiftMatching.use_gpu 0"),
        "{log}"
    );
}

#[test]
fn newer_option_names_are_used_if_the_help_lists_them() {
    let body = r#"[ $command = mapper ] && model "$out/0" 10 10; exit 0"#;
    let scene = Scene::new(10, body);
    let newer = PRELUDE
        .replace("SiftExtraction", "FeatureExtraction")
        .replace("SiftMatching", "FeatureMatching")
        .replace("--random_seed", "--default_random_seed");
    std::fs::write(scene.dir.path().join("colmap"), format!("{newer}{MODEL}{body}")).unwrap();
    scene.poses().unwrap();
    let log = scene.log();
    assert!(log.contains("--FeatureExtraction.use_gpu 0"), "{log}");
    assert!(
        log.contains("--default_random_seed") && !log.contains("--SiftExtraction.use_gpu"),
        "{log}"
    );
    assert!(log.contains("has no option ImageReader.single_camera"), "what is not sent is noted");
}

#[test]
fn the_largest_model_is_used_even_if_it_is_not_the_first() {
    let body = r#"[ $command = mapper ] && { model "$out/0" 4 4; model "$out/1" 10 10; }; exit 0"#;
    assert_eq!(Scene::new(10, body).poses().unwrap().registered, 10);
}

#[test]
fn a_poor_first_strategy_leads_to_the_next() {
    let body = r#"
if [ $command = mapper ]; then
  case "$all" in *init_min_tri_angle*) model "$out/0" 10 10;; *) model "$out/0" 4 4;; esac
fi; exit 0"#;
    // An option is sent only if the help lists it.
    let scene = Scene::new(10, body);
    let script = PRELUDE.replace(
        "--random_seed arg (=0)\\n",
        "--random_seed arg (=0)\\n  --Mapper.init_min_tri_angle arg\\n",
    );
    std::fs::write(scene.dir.path().join("colmap"), format!("{script}{MODEL}{body}")).unwrap();
    let poses = scene.poses().unwrap();
    assert_eq!((poses.strategy, poses.registered), (Some('B'), 10));
}

#[test]
fn few_registered_photographs_are_named_with_advice() {
    let scene = Scene::new(10, r#"[ $command = mapper ] && model "$out/0" 4 4; exit 0"#);
    match scene.poses() {
        Err(PosesError::TooFew { registered: 4, total: 10, advice }) => {
            assert!(advice.contains("overlap"));
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_doubtful_model_is_returned_and_marked() {
    let scene = Scene::new(10, r#"[ $command = mapper ] && model "$out/0" 7 2; exit 0"#);
    let poses = scene.poses().unwrap();
    assert!(poses.low_confidence && poses.registered == 7);
}

#[test]
fn a_mapper_without_an_initial_pair_is_not_a_fault() {
    let scene = Scene::new(
        5,
        "[ $command = mapper ] && { echo 'ERROR: failed to create sparse model' >&2; exit 1; }; exit 0",
    );
    assert!(matches!(scene.poses(), Err(PosesError::TooFew { registered: 0, total: 5, .. })));
}

#[test]
fn a_crash_is_reported_with_its_signal_and_last_output() {
    let scene = Scene::new(
        5,
        "[ $command = exhaustive_matcher ] && { echo last words; kill -SEGV $$; }; exit 0",
    );
    match scene.poses() {
        Err(PosesError::Tool { command, status, tail }) => {
            assert_eq!(command, "exhaustive_matcher");
            assert!(
                status.contains("signal: 11") && tail.contains("last words"),
                "{status} {tail}"
            );
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_absent_program_is_missing() {
    let scene = Scene::new(5, "");
    let tool = ColmapCli::new("/nowhere/colmap");
    let outcome = scene.run(&tool, &mut Silent, &CancelToken::new());
    assert!(matches!(outcome, Err(PosesError::Missing { .. })), "{outcome:?}");
    assert!(matches!(tool.version(), Err(PosesError::Missing { .. })));
}

#[test]
fn two_photographs_are_rejected_before_anything_runs() {
    let scene = Scene::new(2, "");
    let tool = ColmapCli::new("/nowhere/colmap");
    let outcome = scene.run(&tool, &mut Silent, &CancelToken::new());
    assert!(matches!(outcome, Err(PosesError::TooFew { registered: 0, total: 2, .. })));
}

#[test]
fn colmap_gets_the_masks_of_the_photographs() {
    let mut scene = Scene::new(10, r#"[ $command = mapper ] && model "$out/0" 10 10; exit 0"#);
    let mut picture: Image<Linear> = Image::new(24, 16);
    (0..24 * 16).filter(|i| i % 24 >= 12).for_each(|i| picture.set(i % 24, i / 24, [1.0; 3]));
    let mask = PreparedImage::write(&picture, &scene.dir.path().join("mask.half")).unwrap();
    assert!(scene.poses().is_ok() && !scene.log().contains("mask_path /"));
    scene.views[3].mask = Some(mask);
    scene.poses().unwrap();
    let folder = scene.work_dir().join("small.masks");
    assert!(scene.log().contains(&format!("--ImageReader.mask_path {}", folder.display())));
    let mask = |copy: &str| Image::load(&folder.join(copy)).unwrap();
    let own = mask("view3.png.png");
    assert_eq!((own.width(), own.height()), (48, 32));
    assert_eq!((own.get(23, 9)[0], own.get(24, 9)[0]), (0.0, 1.0));
    assert!(mask("view4.png.png").data().iter().all(|v| *v == 1.0), "nothing of it is masked");
}

#[test]
fn copies_of_an_earlier_search_are_removed() {
    let scene = Scene::new(10, r#"[ $command = mapper ] && model "$out/0" 10 10; exit 0"#);
    let small = scene.work_dir().join("small");
    std::fs::create_dir_all(&small).unwrap();
    std::fs::write(small.join("v00003.png"), "of another build").unwrap();
    scene.poses().unwrap();
    let files = std::fs::read_dir(&small).unwrap().map(|file| file.unwrap().path());
    let mut files: Vec<_> = files.collect();
    files.sort();
    assert_eq!(files, (0..10).map(|i| small.join(format!("view{i}.png"))).collect::<Vec<_>>());
}

#[test]
fn neighbours_of_a_large_capture_follow_its_order_and_not_the_names_of_files() {
    let scene = Scene::new(151, r#"[ $command = mapper ] && model "$out/0" 151 10; exit 0"#);
    assert_eq!(scene.poses().unwrap().registered, 151);
    let pairs = std::fs::read_to_string(scene.work_dir().join("A.pairs")).unwrap();
    let pairs: std::collections::BTreeSet<&str> = pairs.lines().collect();
    for pair in ["view9.png view10.png", "view90.png view100.png", "view22.png view150.png"] {
        assert!(pairs.contains(pair), "{pair}");
    }
    assert!(!pairs.contains("view90.png view101.png"));
    assert_eq!(pairs.len(), (1..=10).chain([16, 32, 64, 128]).map(|k| 151 - k).sum::<usize>());
}

#[test]
fn the_unprocessed_photographs_come_last() {
    let body =
        r#"[ $command = mapper ] && case "$out" in *-G) model "$out/0" 10 10;; esac; exit 0"#;
    let scene = Scene::new(10, body);
    let mut tried = Vec::new();
    let mut sink = |event: &Event| {
        if let Event::StrategyStarted { strategy, name } = event {
            tried.push((*strategy, name.clone()));
        }
    };
    let poses = scene.run(&scene.tool(), &mut sink, &CancelToken::new()).unwrap();
    assert_eq!(poses.strategy, Some('G'));
    // The copies are no smaller than the photographs: there is no C.
    let letters: Vec<char> = tried.iter().map(|(strategy, _)| *strategy).collect();
    assert_eq!(letters, ['A', 'B', 'D', 'E', 'G']);
    let names: std::collections::BTreeSet<_> = tried.iter().map(|(_, name)| name).collect();
    assert_eq!(names.len(), tried.len(), "each has a name of its own: {names:?}");
    let level = |folder: &str| {
        let copy = scene.work_dir().join(folder).join("view0.png");
        Image::load(&copy).unwrap().get(9, 9)[0]
    };
    assert!((level("plain") - 0.1).abs() < 0.01 && level("small") > 0.3);
}
