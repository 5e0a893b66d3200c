use super::*;
use crate::cancel::CancelToken;
use crate::capture::Capture;
use crate::event::Silent;
use crate::given_poses::GivenSfm;
use crate::metrics::psnr;
use crate::pipeline::poses::pose_view;
use crate::poses::bounds::read_poses_bounds;
use crate::poses::{PoseRequest, PoseView, Sfm};

fn small(seed: u64) -> SynthOptions {
    SynthOptions { views: 3, width: 64, height: 36, seed, ..SynthOptions::default() }
}

fn load(dir: &Path, file: &str) -> Image<Srgb> {
    Image::load(&dir.join(file)).unwrap()
}

#[test]
fn equal_seeds_give_equal_bytes_and_other_seeds_do_not() {
    let dirs: Vec<_> = (0..3).map(|_| tempfile::tempdir().unwrap()).collect();
    for (dir, seed) in dirs.iter().zip([1, 1, 2]) {
        generate(&small(seed), dir.path()).unwrap();
    }
    for file in ["images/001.png", "HL/001.png", "poses_bounds.npy"] {
        let bytes: Vec<_> =
            dirs.iter().map(|dir| std::fs::read(dir.path().join(file)).unwrap()).collect();
        assert!(bytes[0] == bytes[1], "{file}");
        assert!(bytes[0] != bytes[2], "{file}");
    }
}

#[test]
fn the_layout_is_lush_nerfs_and_the_poses_are_exact() {
    let dir = tempfile::tempdir().unwrap();
    let summary = generate(&small(4), dir.path()).unwrap();
    let rows = read_poses_bounds(&dir.path().join("poses_bounds.npy")).unwrap();
    assert_eq!(rows.len(), 3);
    for ((name, camera), row) in summary.cameras.iter().zip(rows) {
        let row = row.unwrap();
        assert!(dir.path().join(format!("images/{name}.png")).is_file());
        assert!(row.camera.world_to_camera.abs_diff_eq(camera.world_to_camera, 1e-9));
        assert!(row.near > 0.1 && row.far < 20.0 && row.near < row.far);
    }
}

#[test]
fn every_layout_round_trips_with_truth_and_cameras() {
    for layout in Layout::ALL {
        let dir = tempfile::tempdir().unwrap();
        // Photographs of a capture need at least 64 px.
        let options = SynthOptions { layout, height: 64, ..small(5) };
        let summary = generate(&options, dir.path()).unwrap();
        let capture = Capture::open(dir.path(), dir.path()).unwrap();
        assert!(capture.views.iter().all(|view| view.gt.is_some()), "{layout:?}");
        let given = GivenSfm::new(capture.poses.as_ref().unwrap()).unwrap();
        let views: Vec<PoseView> = capture.views.iter().map(pose_view).collect();
        let request =
            PoseRequest { views: &views, work_dir: dir.path(), seed: 0, stamp: "", earlier: &[] };
        let poses = given.poses(&request, &mut Silent, &CancelToken::default());
        let poses = poses.unwrap();
        assert_eq!(poses.views.len(), 3, "{layout:?}");
        for (posed, (name, camera)) in poses.views.iter().zip(&summary.cameras) {
            assert_eq!(posed.name, *name);
            let (found, made) = (posed.camera.world_to_camera, camera.world_to_camera);
            assert!(found.abs_diff_eq(made, 1e-9), "{layout:?} {name}");
            assert!((posed.camera.intrinsics.fx - camera.intrinsics.fx).abs() < 1e-9);
        }
    }
}

#[test]
fn every_view_has_near_neighbours_on_both_sides() {
    let options = SynthOptions::default();
    let cameras = path::cameras(options.views, options.intrinsics(), 7);
    let gap = |i: usize| cameras[i].centre().distance(cameras[(i + 1) % cameras.len()].centre());
    let gaps: Vec<f64> = (0..cameras.len()).map(gap).collect();
    let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
    assert!(gaps.iter().all(|&gap| gap < 2.0 * mean), "the loop is open: {gaps:?}");
}

#[test]
fn without_blur_and_noise_the_dark_image_is_the_scaled_truth() {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions { blur: 0.0, noise: 0.0, exposure: 0.25, ..small(5) };
    generate(&options, dir.path()).unwrap();
    let truth = load(dir.path(), "HL/001.png");
    let cut = truth.to_linear().map(|v| 0.25 * v).to_srgb();
    let dark = load(dir.path(), "images/001.png");
    // Only the sampling and the dark image's 8 bits remain.
    let unexposed = psnr(&dark, &truth);
    assert!(psnr(&dark, &cut) > unexposed + 8.0, "{} {unexposed}", psnr(&dark, &cut));
}

#[test]
fn blur_and_noise_each_degrade_the_image() {
    let dir = tempfile::tempdir().unwrap();
    let distance = |blur, noise| {
        generate(&SynthOptions { blur, noise, exposure: 1.0, ..small(6) }, dir.path()).unwrap();
        psnr(&load(dir.path(), "images/001.png"), &load(dir.path(), "HL/001.png"))
    };
    let (plain, blurred, noisy) = (distance(0.0, 0.0), distance(6.0, 0.0), distance(0.0, 0.2));
    assert!(blurred < plain - 1.0 && noisy < plain - 1.0, "{plain} {blurred} {noisy}");
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let error = generate(&SynthOptions { exposure: 0.0, ..small(0) }, dir.path()).unwrap_err();
    assert!(error.to_string().contains("exposure"));
}

#[test]
fn numbered_rooms_differ_and_are_reproducible() {
    let dirs: Vec<_> = (0..4).map(|_| tempfile::tempdir().unwrap()).collect();
    for (dir, number) in dirs.iter().zip([0, 5, 5, 6]) {
        let room = RoomChoice::Numbered(number);
        generate(&SynthOptions { room, ..small(1) }, dir.path()).unwrap();
    }
    let bytes: Vec<_> =
        dirs.iter().map(|dir| std::fs::read(dir.path().join("HL/001.png")).unwrap()).collect();
    assert!(bytes[1] == bytes[2] && bytes[0] != bytes[1] && bytes[1] != bytes[3]);
    let mean = |dir: &tempfile::TempDir| {
        let image = load(dir.path(), "HL/001.png");
        image.data().iter().sum::<f32>() / image.data().len() as f32
    };
    for dir in &dirs {
        assert!((0.15..0.7).contains(&mean(dir)), "as bright as a room: {}", mean(dir));
    }
}

#[test]
fn a_papered_room_shows_its_photographs() {
    let (wallpapers, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let wallpapered = || SynthOptions { wallpapers: Some(wallpapers.path().into()), ..small(1) };
    let error = generate(&wallpapered(), dir.path()).unwrap_err();
    assert!(error.to_string().contains("no photograph"), "{error}");
    let mut red = Image::<Srgb>::new(8, 8);
    red.plane_mut(0).fill(0.9);
    red.save(&wallpapers.path().join("red.png")).unwrap();
    generate(&wallpapered(), dir.path()).unwrap();
    let shown = load(dir.path(), "HL/001.png");
    let mean = |channel: usize| shown.plane(channel).iter().sum::<f32>() / shown.pixels() as f32;
    assert!(mean(0) > 0.3 && mean(1) < 1e-3, "{} {}", mean(0), mean(1));
    std::fs::write(wallpapers.path().join("notes.txt"), "no photograph").unwrap();
    let error = generate(&wallpapered(), dir.path()).unwrap_err();
    assert!(error.to_string().contains("notes.txt"), "{error}");
}

#[test]
fn the_study_is_chosen_by_name_lit_and_full_of_detail() {
    let dir = tempfile::tempdir().unwrap();
    let room: RoomChoice = "study".parse().unwrap();
    assert_eq!(room, RoomChoice::Study);
    assert_eq!("12".parse(), Ok(RoomChoice::Numbered(12)));
    assert!("cellar".parse::<RoomChoice>().unwrap_err().contains("study"));
    let options = SynthOptions { room, width: 160, height: 90, ..small(1) };
    generate(&options, dir.path()).unwrap();
    let image = load(dir.path(), "HL/001.png");
    let values = image.data();
    let share = |of: fn(f32) -> bool| {
        values.iter().filter(|v| of(**v)).count() as f64 / values.len() as f64
    };
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    assert!((0.25..0.6).contains(&mean), "{mean}");
    assert!(share(|v| v >= 0.999) < 0.05 && share(|v| v < 0.02) < 0.05);
    // Edges everywhere: without them no camera can be located.
    let [w, h] = [image.width(), image.height()];
    let green = image.plane(1);
    let blocks = (0..h / 10).flat_map(|y| (0..w / 10).map(move |x| (10 * x, 10 * y)));
    let is_plain = |(x, y): &(usize, usize)| {
        let block = (0..100).map(|i| green[(y + i / 10) * w + x + i % 10]);
        let (low, high) = block.fold((1.0_f32, 0.0_f32), |(l, h), v| (l.min(v), h.max(v)));
        high - low < 0.06
    };
    let plain = blocks.clone().filter(is_plain).count();
    assert!(plain * 10 < blocks.count(), "{plain} blocks show nothing");
}
