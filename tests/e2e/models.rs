//! `fled models`: adding, listing and checking networks.

use std::path::{Path, PathBuf};

use crate::support::{self, code, models, network, said};

/// A folder with the network `identity3` under the name `mine`.
fn with_mine(home: &Path) -> PathBuf {
    let folder = home.join("models");
    let file = network("identity3").display().to_string();
    let added = models(
        &folder,
        &["add", &file, "--id", "mine", "--licence", "CC0-1.0"],
    );
    assert_eq!(code(&added), 0, "{}", said(&added));
    folder
}

#[test]
fn an_added_network_is_listed_and_checked() {
    let home = tempfile::tempdir().expect("temporary folder");
    let folder = with_mine(home.path());
    let list = said(&models(&folder, &["list"]));
    let line = |id: &str| {
        list.lines()
            .find(|line| line.starts_with(id))
            .unwrap_or_else(|| panic!("{id} in\n{list}"))
    };
    assert!(
        line("mine").contains("single") && line("mine").contains("CC0-1.0"),
        "{list}"
    );
    assert!(line("small-u2w16").contains("built in (default)"), "{list}");
    assert!(
        line("medium-u2w32").contains("built in (default on CUDA)"),
        "{list}"
    );
    assert!(
        line("nafnet-gopro-w32").contains("fled models fetch nafnet-gopro-w32"),
        "{list}"
    );
    let verified = models(&folder, &["verify"]);
    let text = said(&verified);
    assert_eq!(code(&verified), 0, "{text}");
    assert!(
        text.lines()
            .filter(|line| line.contains("ok") && line.contains("known values"))
            .count()
            == 3,
        "{text}"
    );
}

#[test]
fn an_added_network_may_be_chosen() {
    let home = tempfile::tempdir().expect("temporary folder");
    let folder = with_mine(home.path());
    let capture = support::small_capture(home.path());
    let out = home.path().join("out");
    let mut run = support::small_run(&capture, &out, 1);
    support::succeed(
        run.arg("--models")
            .arg(&folder)
            .args(["--set", "deblur=mine"]),
    );
    let report = support::json(&out.join("metrics.json"));
    assert!(
        report["models"]["deblur"]
            .as_str()
            .is_some_and(|model| model.starts_with("mine sha256:")),
        "{report}"
    );
}

#[test]
fn another_file_under_the_name_of_ones_own_takes_its_place() {
    let home = tempfile::tempdir().expect("temporary folder");
    let folder = with_mine(home.path());
    // And how it is fed.
    let other = network("box3").display().to_string();
    let replaced = models(
        &folder,
        &["add", &other, "--id", "mine", "--multiple", "32"],
    );
    assert_eq!(code(&replaced), 0, "{}", said(&replaced));
    let manifest = support::json(&folder.join("manifest.json"));
    assert_eq!(
        manifest["models"].as_array().map(Vec::len),
        Some(1),
        "{manifest}"
    );
    assert_eq!(
        (
            &manifest["models"][0]["multiple"],
            &manifest["models"][0]["licence"]
        ),
        (&32.into(), &"CC0-1.0".into())
    );
    let file = manifest["models"][0]["file"].as_str().expect("its file");
    assert!(folder.join(file).exists());
    assert!(!folder.join("mine.onnx").exists(), "the first one is gone");
}

#[test]
fn a_damaged_network_is_told_by_doctor_verify_and_run() {
    let home = tempfile::tempdir().expect("temporary folder");
    let folder = with_mine(home.path());
    let file = folder.join("mine.onnx");
    let mut content = std::fs::read(&file).expect("here");
    content[100] ^= 1;
    std::fs::write(&file, content).expect("write");
    let doctor = support::fled()
        .arg("doctor")
        .env("FLED_MODELS", &folder)
        .output();
    let doctor = said(&doctor.expect("the binary starts"));
    assert!(
        doctor.contains("mine DAMAGED"),
        "of the right length, but another file: {doctor}"
    );
    let broken = models(&folder, &["verify", "mine"]);
    assert_eq!(code(&broken), 4);
    assert!(
        said(&broken).contains("damaged or another file"),
        "{}",
        said(&broken)
    );
    let capture = support::small_capture(home.path());
    let refused = support::small_run(&capture, &home.path().join("other"), 1)
        .env("FLED_MODELS", &folder)
        .args(["--set", "deblur=mine"])
        .output()
        .expect("the binary starts");
    assert_eq!(
        code(&refused),
        4,
        "before anything is done: {}",
        said(&refused)
    );
}

#[test]
fn which_of_several_outputs_is_meant_is_said_once() {
    let home = tempfile::tempdir().expect("temporary folder");
    let file = network("two_outputs3").display().to_string();
    let entry = || support::json(&home.path().join("manifest.json"))["models"][0].clone();
    let silent = models(home.path(), &["add", &file, "--id", "two"]);
    assert!(
        said(&silent).contains("--output NAME"),
        "the first may be any map: {}",
        said(&silent)
    );
    let wrong = models(
        home.path(),
        &["add", &file, "--id", "two", "--output", "sharp"],
    );
    assert!(
        said(&wrong).contains("outputs are `coarse`, `restored`"),
        "{}",
        said(&wrong)
    );
    let added = models(
        home.path(),
        &["add", &file, "--id", "two", "--output", "restored"],
    );
    assert_eq!(code(&added), 0, "{}", said(&added));
    assert_eq!(entry()["output"], "restored");
    let verified = models(home.path(), &["verify", "two"]);
    assert_eq!(
        code(&verified),
        0,
        "the manifest's output is checked too: {}",
        said(&verified)
    );
    let replaced = models(
        home.path(),
        &[
            "add",
            &network("identity3").display().to_string(),
            "--id",
            "two",
        ],
    );
    assert_eq!(code(&replaced), 0, "{}", said(&replaced));
    assert_eq!(
        entry()["output"],
        "restored",
        "what is not said again stays"
    );
    let only = models(
        home.path(),
        &[
            "add",
            &network("identity3").display().to_string(),
            "--id",
            "two",
            "--output",
            "",
        ],
    );
    assert_eq!(code(&only), 0, "{}", said(&only));
    assert!(entry()["output"].is_null(), "{}", entry());
}

#[test]
fn what_is_no_usable_network_is_not_added() {
    let home = tempfile::tempdir().expect("temporary folder");
    for (name, word) in [
        ("four_channels", "4 channels"),
        ("infinite3", "not finite"),
        ("fixed_size", "48x32"),
    ] {
        let refused = models(home.path(), &["add", &network(name).display().to_string()]);
        assert_eq!(code(&refused), 4, "{name}");
        assert!(said(&refused).contains(word), "{name}: {}", said(&refused));
    }
    let taken = models(
        home.path(),
        &[
            "add",
            &network("identity3").display().to_string(),
            "--id",
            "identity",
        ],
    );
    assert_eq!(code(&taken), 2, "{}", said(&taken));
    let wrong = models(
        home.path(),
        &[
            "add",
            &network("identity3").display().to_string(),
            "--id",
            "nafnet-gopro-w32",
        ],
    );
    assert!(said(&wrong).contains("sha256"), "{}", said(&wrong));
    assert_eq!(
        std::fs::read_dir(home.path()).expect("readable").count(),
        0,
        "nothing is left behind"
    );
}
