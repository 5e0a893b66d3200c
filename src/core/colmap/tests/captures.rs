//! The real COLMAP on real photographs, if both are available.

use super::*;
use crate::capture::Capture;
use crate::pipeline::poses::pose_view;
use crate::poses::align;
use crate::poses::model::SparseModel;

/// COLMAP is random: on another machine a good build has lost a photograph of sceaux. A real fault
/// fails every time.
const ATTEMPTS: usize = 3;

fn stem(file: &Path) -> String {
    file.file_stem().unwrap().to_str().unwrap().to_owned()
}

/// Whether an early strategy places every photograph within 1 % of the sharp set's pose, or the
/// reason if not.
fn attempt(capture: &Path, views: &[PoseView]) -> Result<(), String> {
    let work = tempfile::tempdir().unwrap();
    let request = PoseRequest { views, work_dir: work.path(), seed: 0, stamp: "", earlier: &[] };
    let poses = ColmapCli::default()
        .poses(&request, &mut Silent, &CancelToken::new())
        .map_err(|error| error.to_string())?;
    let truth = SparseModel::read(&capture.join("sparse_gt")).unwrap();
    let (mut estimated, mut expected) = (Vec::new(), Vec::new());
    for view in &poses.views {
        let image =
            truth.images.iter().find(|image| stem(Path::new(&image.name)) == view.name).unwrap();
        estimated.push(view.camera);
        expected.push(crate::camera::Camera {
            intrinsics: truth.camera_of(image).lens().intrinsics,
            world_to_camera: image.world_to_camera(),
        });
    }
    let errors = align::compare(&estimated, &expected).unwrap();
    let focal = poses.views[0].lens.intrinsics.fx / expected[0].intrinsics.fx - 1.0;
    let found = format!(
        "{} of {}, strategy {:?}, {:.1} s, {errors:?}, focal {:+.2} %, points {}, track {:?}",
        poses.registered,
        poses.total,
        poses.strategy,
        poses.seconds,
        100.0 * focal,
        poses.points.len(),
        poses.mean_track
    );
    let good = poses.registered == views.len()
        && matches!(poses.strategy, Some('A' | 'B'))
        && errors.position_rms < 0.01;
    eprintln!("{}: {found}", capture.display());
    if good { Ok(()) } else { Err(found) }
}

fn register(name: &str) {
    let capture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/captures").join(name);
    if !capture.is_dir() {
        return;
    }
    let scratch = tempfile::tempdir().unwrap();
    let opened = Capture::open(&capture, scratch.path()).unwrap();
    let views: Vec<PoseView> = opened.views.iter().map(pose_view).collect();
    let mut faults = Vec::new();
    while faults.len() < ATTEMPTS {
        match attempt(&capture, &views) {
            Ok(()) => return,
            Err(found) => faults.push(found),
        }
    }
    panic!("{name}:\n{}", faults.join("\n"));
}

#[test]
fn fox_registers_every_photograph_at_the_sharp_sets_pose() {
    register("fox");
}

#[test]
#[ignore = "make test-nightly"]
fn sceaux_registers_every_photograph_at_the_sharp_sets_pose() {
    register("sceaux");
}
