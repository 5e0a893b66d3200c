use std::path::{Path, PathBuf};

use super::*;
use crate::deblur::manifest::Manifest;
use crate::deblur::open::{larger, load};
use crate::deblur::{NetworkChoice, OpenOptions, open};
use crate::inference::runtime;

fn file(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/onnx")
        .join(name);
    path.display().to_string()
}

fn named(name: &str) -> NetworkChoice {
    NetworkChoice::Named(file(name))
}

fn network(choice: &str) -> Result<Onnx, DeblurError> {
    let model = Manifest::embedded().resolve(choice, &[]).expect("present");
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
    a.data()
        .iter()
        .zip(b.data())
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
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
fn the_view_comes_before_the_guide_and_is_its_own_guide_without_one() {
    let mut network = network(&file("mix6.onnx")).expect("loads");
    let (view, guide) = (waves(48, 32, 0.0), waves(48, 32, 2.0));
    let guided = network.restore(&view, Some(&guide)).expect("runs");
    let values = view
        .data()
        .iter()
        .zip(guide.data())
        .map(|(v, g)| 0.75 * v + 0.25 * g)
        .collect();
    let expected = Image::from_planar(48, 32, values);
    assert!(worst(&guided, &expected) < 1e-6);
    assert!(
        worst(
            &guided,
            &network.restore(&guide, Some(&view)).expect("runs")
        ) > 0.1,
        "order matters"
    );
    assert!(worst(&network.restore(&view, None).expect("runs"), &view) < 1e-6);
}

#[test]
fn sides_are_padded_to_a_multiple_and_cropped_back() {
    let mut network = network(&file("blocks16.onnx")).expect("loads");
    let view = waves(50, 37, 0.0);
    assert!(worst(&network.restore(&view, None).expect("padded"), &view) < 1e-6);
    network.model.multiple = 1;
    let refused = network
        .restore(&view, None)
        .expect_err("the network needs multiples of 16");
    assert!(
        matches!(
            refused,
            DeblurError::Inference {
                width: 50,
                height: 37,
                ..
            }
        ),
        "{refused}"
    );
}

#[test]
fn a_view_in_tiles_shows_no_seams() {
    let mut network = network(&file("box3.onnx")).expect("loads");
    let view = waves(1696, 896, 0.0);
    assert!(tiling::plan(1696, 896, network.model.tile).len() > 1);
    let tiled = network.restore(&view, None).expect("runs");
    let whole = Tile {
        x: 0,
        y: 0,
        width: 1696,
        height: 896,
    };
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
fn networks_that_are_not_ours_are_refused_with_the_reason() {
    for (name, reason) in [
        ("fixed_size.onnx", "48x32"),
        ("four_channels.onnx", "4 channels"),
        ("half_precision.onnx", "32-bit floats"),
        ("unknown_channels.onnx", "how many channels"),
    ] {
        let refused = network(&file(name)).err().expect("refused").to_string();
        assert!(
            refused.contains(name) && refused.contains(reason),
            "{refused}"
        );
    }
    let text = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let refused = network(text).err().expect("no network");
    assert!(
        matches!(refused, DeblurError::ModelUnusable { .. }),
        "{refused}"
    );
}

#[test]
fn the_manifest_says_which_of_several_outputs_is_the_view() {
    let known = Manifest::embedded()
        .resolve(&file("two_outputs3.onnx"), &[])
        .expect("present");
    let named = |input: &str, output: &str| {
        let model = Model {
            input: Some(input.to_owned()),
            output: Some(output.to_owned()),
            ..known.clone()
        };
        Onnx::load_on(&runtime::for_tests(), &model, Provider::Cpu, 1)
    };
    let view = waves(32, 32, 0.0);
    let mut network_of_restored = named("view", "restored").expect("loads");
    let restored = network_of_restored.restore(&view, None).expect("runs");
    assert!(worst(&restored, &view) < 1e-6);
    let coarse = named("view", "coarse").expect("loads").describe().feeding;
    assert_ne!(
        coarse,
        network_of_restored.describe().feeding,
        "results of one are not taken for the other's"
    );
    let refused = network(&file("two_outputs3.onnx"))
        .err()
        .expect("either may be meant")
        .to_string();
    assert!(
        refused.contains("`coarse`, `restored`") && refused.contains("--output"),
        "{refused}"
    );
    for (input, output, reason) in [
        (
            "view",
            "sharp",
            "outputs are `coarse`, `restored`; `sharp` is asked for",
        ),
        ("image", "restored", "input is `view`; `image` is asked for"),
    ] {
        let refused = named(input, output)
            .err()
            .expect("another file")
            .to_string();
        assert!(refused.contains(reason), "{refused}");
    }
}

#[test]
fn the_self_test_finds_sides_that_do_not_fit() {
    let known = Manifest::embedded()
        .resolve(&file("blocks16.onnx"), &[])
        .expect("present");
    let of = |multiple: usize| {
        Onnx::load_on(
            &runtime::for_tests(),
            &Model {
                multiple,
                ..known.clone()
            },
            Provider::Cpu,
            1,
        )
        .err()
    };
    assert!(of(16).is_none() && of(32).is_none());
    // The golden image's 64 px fit both; 72 do not.
    let refused = of(8).expect("72 is no multiple of 16");
    assert!(matches!(refused, DeblurError::SelfTest { .. }), "{refused}");
    assert!(
        refused.to_string().contains("72x80 px do not fit it"),
        "{refused}"
    );
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
fn the_default_network_is_deterministic_and_stays_near_a_clean_view() {
    let mut first = network("default").expect("loads");
    let mut second = network("default").expect("loads");
    let view = waves(90, 70, 0.0);
    let restored = first.restore(&view, None).expect("runs");
    assert_eq!(restored, second.restore(&view, None).expect("runs"));
    assert!(
        restored
            .data()
            .iter()
            .all(|value| (0.0..=1.0).contains(value))
    );
    let mean = restored
        .data()
        .iter()
        .zip(view.data())
        .map(|(a, b)| (a - b).abs())
        .sum::<f32>()
        / view.data().len() as f32;
    assert!(
        mean < 0.05,
        "a sharp, clean view came back {mean} away in the mean"
    );
}

#[test]
fn a_network_without_channels_for_a_guide_does_without_and_says_so() {
    let search = [PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../.onnxruntime"
    ))];
    let options = OpenOptions {
        search: &search,
        threads: 1,
        ..OpenOptions::default()
    };
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
fn the_built_in_networks_return_here_what_they_returned_where_they_were_trained() {
    let runtime = runtime::for_tests();
    for id in ["small-u2w16", "medium-u2w32"] {
        let model = Manifest::embedded().resolve(id, &[]).expect("built in");
        let known = model.golden.clone().expect("a golden output");
        let mut network =
            Onnx::load_on(&runtime, &model, Provider::Cpu, 1).expect("passes its self-test");
        // PyTorch and ONNX Runtime on another kind of processor: far inside what the self-test
        // allows.
        assert!(
            known.difference(network.golden().expect("runs").values()) < 1e-4,
            "{id}"
        );
    }
    let model = Manifest::embedded()
        .resolve("default", &[])
        .expect("built in");
    let swapped = Golden::new(golden::view().data().to_vec()).expect("of the right size");
    let wrong = Model {
        golden: Some(swapped),
        ..model
    };
    let refused = Onnx::load_on(&runtime, &wrong, Provider::Cpu, 1)
        .err()
        .expect("another output is known");
    assert!(
        refused.to_string().contains("on cpu it is off by"),
        "{refused}"
    );
}

#[test]
fn the_larger_network_is_for_who_asks_for_the_default_and_has_cuda() {
    let known = Manifest::embedded();
    let tried = |choice, cuda| larger(&known, &choice, cuda).map(|entry| entry.id.as_str());
    let small = NetworkChoice::Named("small-u2w16".to_owned());
    assert_eq!(tried(NetworkChoice::Default, true), Some("medium-u2w32"));
    assert_eq!(tried(NetworkChoice::Default, false), None);
    assert_eq!(tried(small, true), None);
}

#[test]
fn cuda_that_is_there_and_does_not_work_is_said_and_the_processor_used() {
    let folder = tempfile::tempdir().expect("temporary directory");
    let runtime = runtime::as_if_in(folder.path());
    let model = Manifest::embedded()
        .resolve(&file("identity3.onnx"), &[])
        .expect("present");
    let (network, said) = Onnx::load(&runtime, &model, 1).expect("loads");
    assert_eq!(
        (network.describe().provider.as_str(), said),
        ("cpu", None),
        "without CUDA there is nothing to say"
    );
    std::fs::write(folder.path().join(runtime::CUDA_LIBRARY), "not a library").expect("write");
    let (network, said) = Onnx::load(&runtime, &model, 1).expect("loads");
    assert_eq!(network.describe().provider, "cpu");
    assert!(
        said.as_deref()
            .is_some_and(|text| text.contains("CUDA cannot be used")),
        "{said:?}"
    );
    let larger = Manifest::embedded()
        .resolve("medium-u2w32", &[])
        .expect("built in");
    let (network, said) = load(&runtime, Some(Ok(larger)), &model, 1).expect("loads");
    let info = network.describe();
    assert_eq!(
        (info.id.as_str(), info.provider.as_str()),
        ("identity3.onnx", "cpu")
    );
    assert!(
        said[0].contains("network medium-u2w32, the default on CUDA, cannot be used"),
        "{said:?}"
    );
    assert!(
        said[1].contains("CUDA cannot be used, the CPU is"),
        "{said:?}"
    );
    let damaged = DeblurError::UnknownModel {
        choice: "larger".to_owned(),
        known: String::new(),
    };
    let damaged = Err(("larger".to_owned(), damaged));
    let (_, said) = load(&runtime, Some(damaged), &model, 1).expect("no fault of this one");
    assert_eq!(said.len(), 2, "{said:?}");
}
