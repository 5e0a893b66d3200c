//! The real COLMAP on real photographs, where both are there.

use super::*;
use crate::poses::align;
use crate::poses::model::SparseModel;

fn register(name: &str) {
    let capture = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/captures")
        .join(name);
    if !capture.is_dir() {
        return;
    }
    let mut files: Vec<PathBuf> = std::fs::read_dir(capture.join("images"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let stem = |file: &Path| file.file_stem().unwrap().to_str().unwrap().to_owned();
    let views: Vec<PoseView> = files
        .iter()
        .map(|file| PoseView {
            name: stem(file),
            file: file.clone(),
            focal_px: None,
        })
        .collect();
    let work = tempfile::tempdir().unwrap();
    let request = PoseRequest {
        views: &views,
        work_dir: work.path(),
        seed: 0,
    };
    let poses = ColmapCli::default()
        .poses(&request, &mut Silent, &CancelToken::new())
        .unwrap();
    let truth = SparseModel::read(&capture.join("sparse_gt")).unwrap();
    let (mut estimated, mut expected) = (Vec::new(), Vec::new());
    for view in &poses.views {
        let image = truth
            .images
            .iter()
            .find(|image| stem(Path::new(&image.name)) == view.name)
            .unwrap();
        estimated.push(view.camera);
        expected.push(crate::camera::Camera {
            intrinsics: truth.camera_of(image).lens().intrinsics,
            world_to_camera: image.world_to_camera(),
        });
    }
    let errors = align::compare(&estimated, &expected).unwrap();
    let focal = poses.views[0].lens.intrinsics.fx / expected[0].intrinsics.fx - 1.0;
    eprintln!(
        "{name}: {} of {}, rung {:?}, {:.1} s, {errors:?}, focal {:+.2} %, points {}, track {:?}",
        poses.registered,
        poses.total,
        poses.rung,
        poses.seconds,
        100.0 * focal,
        poses.points.len(),
        poses.mean_track
    );
    assert_eq!(poses.registered, views.len());
    assert!(matches!(poses.rung, Some('A' | 'B')));
    assert!(errors.position_rms < 0.01, "{errors:?}");
}

#[test]
fn fox_registers_every_photograph_where_the_sharp_set_has_it() {
    register("fox");
}

#[test]
fn sceaux_registers_every_photograph_where_the_sharp_set_has_it() {
    register("sceaux");
}
