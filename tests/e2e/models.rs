//! Tests of `fled models`, and of a user's own networks.

use std::path::{Path, PathBuf};
use std::process::Output;

use crate::support::{self, code, network, said};

/// Runs `fled models` with the networks in `folder`.
fn models(folder: &Path) -> Output {
    support::fled().args(["models", "--models"]).arg(folder).output().expect("the binary starts")
}

/// A folder with the network `identity3` under the name `mine.onnx`.
fn with_mine(home: &Path) -> PathBuf {
    let folder = home.join("models");
    std::fs::create_dir(&folder).expect("made");
    std::fs::copy(network("identity3"), folder.join("mine.onnx")).expect("copied");
    folder
}

#[test]
fn all_networks_are_listed_and_checked() {
    let home = tempfile::tempdir().expect("temporary folder");
    let folder = with_mine(home.path());
    let listed = models(&folder);
    let text = said(&listed);
    assert_eq!(code(&listed), 0, "{text}");
    let line = |id: &str, text: &str| {
        let line = text.lines().find(|line| line.starts_with(id));
        line.unwrap_or_else(|| panic!("{id} in\n{text}")).to_owned()
    };
    for (id, words) in [
        ("small-u2w16", ["ok", "guided", "built in, the default"]),
        ("mine.onnx", ["ok", "single", "sha256"]),
    ] {
        let line = line(id, &text);
        assert!(words.iter().all(|word| line.contains(word)), "{text}");
    }
    let unusable = [
        ("four_channels", "4 channels"),
        ("infinite3", "not finite"),
        ("fixed_size", "48x32"),
        ("external3", "`weights/external3.data`, which is not beside it"),
    ];
    for (name, _) in unusable {
        let file = folder.join(format!("{name}.onnx"));
        std::fs::copy(network(name), file).expect("copied");
    }
    let broken = models(&folder);
    let text = said(&broken);
    assert_eq!(code(&broken), 4, "{text}");
    assert!(text.contains("4 networks cannot be used"), "{text}");
    assert!(line("mine.onnx", &text).contains("ok"), "{text}");
    for (name, word) in unusable {
        let line = line(name, &text);
        assert!(line.contains("BROKEN") && line.contains(word), "{text}");
    }
}

#[test]
fn a_network_in_the_folder_can_be_chosen() {
    let home = tempfile::tempdir().expect("temporary folder");
    let folder = with_mine(home.path());
    let capture = support::small_capture(home.path());
    let run = |out: &Path, choice: &str| {
        let mut run = support::small_run(&capture, out, 1);
        run.arg("--models").arg(&folder);
        run.args(["--set", &format!("deblur={choice}")]);
        run
    };
    let out = home.path().join("out");
    support::succeed(&mut run(&out, "mine.onnx"));
    let report = support::json(&out.join("metrics.json"));
    assert!(
        report["models"]["deblur"]
            .as_str()
            .is_some_and(|model| model.starts_with("mine.onnx sha256:")),
        "{report}"
    );
    std::fs::write(folder.join("mine.onnx"), "damaged").expect("written");
    let refused = run(&home.path().join("other"), "mine.onnx").output();
    let refused = refused.expect("the binary starts");
    let text = said(&refused);
    assert_eq!(code(&refused), 4, "before anything is done: {text}");
    assert!(text.contains("network mine.onnx cannot be used"), "{text}");
}
