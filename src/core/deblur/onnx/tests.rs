use std::path::{Path, PathBuf};

use super::*;
use crate::deblur::{NetworkChoice, OpenOptions, open};
use crate::inference::runtime;

fn file(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/onnx").join(name);
    path.display().to_string()
}

fn named(name: &str) -> NetworkChoice {
    NetworkChoice::Named(file(name))
}

fn network(choice: &str) -> Result<Onnx, DeblurError> {
    let model = Model::find(choice, &[]).expect("present");
    Onnx::load_on(&runtime::for_tests(), &model, Provider::Cpu, 1)
}

/// Waves, different in every channel, between 0.1 and 0.9.
fn waves(width: usize, height: usize, phase: f32) -> Image {
    let mut image = Image::new(width, height);
    for y in 0..height {
        for x in 0..width {
            let wave =
                |k: f32| 0.5 + 0.4 * (0.11 * x as f32 + k * 0.07 * y as f32 + k + phase).sin();
            image.set(x, y, [wave(1.0), wave(2.0), wave(3.0)]);
        }
    }
    image
}

fn worst(a: &Image, b: &Image) -> f32 {
    a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn the_identity_network_returns_the_view_at_any_size() {
    let mut network = network(&file("identity3.onnx")).expect("loads");
    assert_eq!(network.describe().channels, 3);
    for (width, height) in [(64, 64), (37, 50), (1, 3)] {
        let view = waves(width, height, 0.0);
        assert!(
            worst(&network.restore(&view, None).expect("runs"), &view) < 1e-6,
            "{width}x{height}"
        );
    }
}

#[test]
fn without_a_guide_the_view_is_its_own_guide() {
    let mut network = network(&file("mix6.onnx")).expect("loads");
    let (view, guide) = (waves(48, 32, 0.0), waves(48, 32, 2.0));
    let guided = network.restore(&view, Some(&guide)).expect("runs");
    let values = view.data().iter().zip(guide.data()).map(|(v, g)| 0.75 * v + 0.25 * g).collect();
    let expected = Image::from_planar(48, 32, values);
    assert!(worst(&guided, &expected) < 1e-6);
    assert!(
        worst(&guided, &network.restore(&guide, Some(&view)).expect("runs")) > 0.1,
        "order matters"
    );
    assert!(worst(&network.restore(&view, None).expect("runs"), &view) < 1e-6);
}

#[test]
fn sides_are_padded_to_a_multiple_and_cropped_back() {
    let mut network = network(&file("blocks16.onnx")).expect("loads");
    let view = waves(50, 37, 0.0);
    assert!(worst(&network.restore(&view, None).expect("padded"), &view) < 1e-6);
}

#[test]
fn a_view_in_tiles_shows_no_seams() {
    let mut network = network(&file("box3.onnx")).expect("loads");
    let view = waves(1696, 896, 0.0);
    assert!(tiling::plan(1696, 896).len() > 1);
    let tiled = network.restore(&view, None).expect("runs");
    let whole = Tile { x: 0, y: 0, width: 1696, height: 896 };
    let output = network.run(&view, None, whole).expect("runs");
    let mut seamless = Join::new(1696, 896);
    seamless.add(whole, &output.values, output.width, output.height);
    // A hard seam would differ by a third of the value, some 0.3.
    assert!(worst(&tiled, &seamless.finish()) < 0.003);
}

#[test]
fn a_tile_that_leaves_the_range_keeps_its_input_and_warns() {
    let mut network =
        network(&file("loud3.onnx")).expect("the self-test's pattern is not that bright");
    let mut view = waves(1696, 896, 0.0);
    assert!(worst(&network.restore(&view, None).expect("runs"), &view) < 1e-6);
    assert!(network.take_warnings().is_empty());
    view.set(3, 3, [1.0, 0.5, 0.5]);
    assert!(worst(&network.restore(&view, None).expect("runs"), &view) < 1e-6);
    let warnings = network.take_warnings();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains("at (0, 0)"), "{warnings:?}");
}

#[test]
fn unfit_networks_are_refused_with_the_reason() {
    for (name, reason) in [
        ("fixed_size.onnx", "48x32 px: export it with dynamic height and width"),
        ("fixed_width.onnx", "48xany px: export it with dynamic height and width"),
        ("channels_last.onnx", "channels last (NHWC): export it with the channels first"),
        ("four_channels.onnx", "4 channels"),
        ("four_images.onnx", "4 images at a time"),
        ("half_precision.onnx", "32-bit floats: export it in float32"),
        ("bytes3.onnx", "32-bit floats: export it in float32"),
        ("unknown_channels.onnx", "how many channels"),
        ("two_outputs3.onnx", "`coarse`, `restored` could be"),
    ] {
        let refused = network(&file(name)).err().expect("refused").to_string();
        assert!(refused.contains(name) && refused.contains(reason), "{refused}");
    }
    let text = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let refused = Model::find(text, &[]).expect_err("no network");
    assert!(matches!(refused, DeblurError::ModelUnusable { .. }), "{refused}");
}

/// The network halves the view by a weight in `weights/`, as `make_onnx.py` writes it.
#[test]
fn weights_are_read_beside_the_network_wherever_the_program_runs() {
    let mut network = network(&file("external3.onnx")).expect("loads");
    let view = waves(20, 20, 0.0);
    let half = Image::from_planar(20, 20, view.data().iter().map(|v| 0.5 * v).collect());
    assert!(worst(&network.restore(&view, None).expect("runs"), &half) < 1e-6);
}

#[test]
fn the_self_test_finds_sizes_that_do_not_fit() {
    // The 64 px of the golden image fit; 80 do not.
    let refused = network(&file("blocks32.onnx")).err().expect("refused");
    assert!(matches!(refused, DeblurError::SelfTest { .. }), "{refused}");
    assert!(refused.to_string().contains("80x96 px do not fit it"), "{refused}");
}

#[test]
fn the_self_test_catches_infinite_and_random_values() {
    for (name, reason) in [("infinite3.onnx", "not finite"), ("random3.onnx", "differ")] {
        let refused = network(&file(name)).err().expect("refused");
        assert!(matches!(refused, DeblurError::SelfTest { .. }), "{refused}");
        assert!(refused.to_string().contains(reason), "{refused}");
    }
}

#[test]
fn the_default_network_is_deterministic_and_keeps_clean_views() {
    let mut first = network("default").expect("loads");
    let mut second = network("default").expect("loads");
    let view = waves(90, 70, 0.0);
    let restored = first.restore(&view, None).expect("runs");
    assert_eq!(restored, second.restore(&view, None).expect("runs"));
    assert!(restored.data().iter().all(|value| (0.0..=1.0).contains(value)));
    let mean = restored.data().iter().zip(view.data()).map(|(a, b)| (a - b).abs()).sum::<f32>()
        / view.data().len() as f32;
    assert!(mean < 0.05, "a sharp, clean view came back {mean} away in the mean");
}

#[test]
fn a_network_without_guide_channels_reports_it() {
    let search = [PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../.onnxruntime"))];
    let options = OpenOptions { search: &search, threads: 1, ..OpenOptions::default() };
    let mut opened = open(&named("identity3.onnx"), &options).expect("opens");
    assert_eq!(opened.fallbacks.len(), 1, "{:?}", opened.fallbacks);
    let (view, guide) = (waves(20, 20, 0.0), waves(20, 20, 1.0));
    let restored = opened.deblurrer.restore(&view, Some(&guide)).expect("runs");
    assert!(worst(&restored, &view) < 1e-6);

    let guided = open(&named("mix6.onnx"), &options).expect("opens");
    assert!(guided.fallbacks.is_empty());
    let identity =
        open(&NetworkChoice::Identity, &OpenOptions::default()).expect("needs no library");
    assert_eq!(identity.deblurrer.describe().id, "identity");
}

#[test]
fn the_built_in_network_reproduces_its_golden_output() {
    let runtime = runtime::for_tests();
    let model = Model::find("default", &[]).expect("built in");
    let known = model.golden.clone().expect("a golden output");
    let mut network =
        Onnx::load_on(&runtime, &model, Provider::Cpu, 1).expect("passes its self-test");
    assert_eq!(network.describe().channels, 6);
    // PyTorch and ONNX Runtime on another processor agree far better than the self-test requires.
    assert!(known.difference(network.golden().expect("runs").values()) < 1e-4);
    let swapped = Golden::new(golden::view().data().to_vec()).expect("of the right size");
    let wrong = Model { golden: Some(swapped), ..model };
    let refused =
        Onnx::load_on(&runtime, &wrong, Provider::Cpu, 1).err().expect("another output is known");
    assert!(refused.to_string().contains("on cpu its output is off by"), "{refused}");
}

#[test]
fn broken_cuda_is_reported_and_the_cpu_is_used() {
    let folder = tempfile::tempdir().expect("temporary directory");
    let runtime = runtime::as_if_in(folder.path());
    let model = Model::find(&file("identity3.onnx"), &[]).expect("present");
    let (network, warning) = Onnx::load(&runtime, &model, 1).expect("loads");
    assert_eq!(
        (network.describe().provider.as_str(), warning),
        ("cpu", None),
        "without CUDA there is nothing to say"
    );
    std::fs::write(folder.path().join(runtime::CUDA_LIBRARY), "not a library").expect("write");
    let (network, warning) = Onnx::load(&runtime, &model, 1).expect("loads");
    assert_eq!(network.describe().provider, "cpu");
    assert!(
        warning.as_deref().is_some_and(|text| text.contains("CUDA cannot be used")),
        "{warning:?}"
    );
}
