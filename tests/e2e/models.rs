//! `fled models`: adding, checking and fetching networks, from a server of the test's own.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::{Arc, Mutex};

use fled_core::deblur::manifest::digest;
use fled_core::image::Image;

use crate::support;

fn network(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/onnx")
        .join(format!("{name}.onnx"))
}

fn models(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = support::fled();
    command
        .arg("models")
        .args(arguments)
        .arg("--models")
        .arg(folder);
    command.output().expect("the binary starts")
}

fn code(output: &Output) -> i32 {
    output.status.code().expect("not killed")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn an_added_network_is_listed_checked_and_may_be_chosen() {
    let home = tempfile::tempdir().expect("temporary folder");
    let folder = home.path().join("models");
    let file = network("identity3").display().to_string();
    let added = models(
        &folder,
        &["add", &file, "--id", "mine", "--licence", "CC0-1.0"],
    );
    assert_eq!(code(&added), 0, "{}", said(&added));
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

    // Another file under the name of one's own, and how it is fed.
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

    let file = folder.join(manifest["models"][0]["file"].as_str().expect("its file"));
    assert!(!folder.join("mine.onnx").exists(), "the first one is gone");
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

#[test]
fn an_enhancer_and_a_restorer_of_the_users_make_the_baseline_of_the_papers() {
    let home = tempfile::tempdir().expect("temporary folder");
    let capture = support::small_capture(home.path());
    let out = home.path().join("out");
    let path = |name: &str| network(name).display().to_string();
    let mut run = support::small_run(&capture, &out, 1);
    for set in [
        &format!("enhance={}", path("root3")),
        &format!("deblur={}", path("box3")),
        "noise=off",
        "shake=off",
        "refine_poses=false",
    ] {
        run.args(["--set", set]);
    }
    support::succeed(&mut run);
    let report = support::json(&out.join("metrics.json"));
    assert!(
        report["models"]["enhance"]
            .as_str()
            .is_some_and(|model| model.starts_with("root3.onnx ")),
        "{report:#}"
    );
    assert!(
        report["models"]["deblur"]
            .as_str()
            .is_some_and(|model| model.starts_with("box3.onnx ")),
        "{report:#}"
    );
    assert_eq!(
        report["fallbacks"],
        serde_json::json!([]),
        "one round gives no guide: {report:#}"
    );
    let mean = |folder: &str| {
        let image = Image::load(&out.join(folder).join("001.jpg")).expect("a preview");
        image.data().iter().sum::<f32>() / image.data().len() as f32
    };
    let (dark, bright) = (mean("inputs"), mean("rounds/1/enhanced"));
    // The mean of the roots is at most the root of the mean.
    assert!(
        bright > 1.5 * dark && bright < dark.sqrt() + 0.01,
        "{dark} to {bright}"
    );

    let wrong = support::small_run(&capture, &home.path().join("wrong"), 1)
        .args(["--set", "enhance=small-u2w16"])
        .output()
        .expect("the binary starts");
    assert_eq!(code(&wrong), 4, "{}", said(&wrong));
    assert!(said(&wrong).contains("wants a guide"), "{}", said(&wrong));
}

#[test]
fn a_resumed_run_takes_what_the_enhancer_had_made() {
    let home = tempfile::tempdir().expect("temporary folder");
    let capture = support::small_capture(home.path());
    let enhance = format!("enhance={}", network("root3").display());
    let run = |out: &str| {
        let mut run = support::small_run(&capture, &home.path().join(out), 1);
        run.args(["--set", &enhance, "--set", "deblur=identity"]);
        run
    };
    support::succeed(&mut run("whole"));
    support::kill_at(
        &mut run("killed"),
        r#""stage_started","stage":"reconstruct","round":1"#,
    );
    support::succeed(&mut run("killed"));
    let log = std::fs::read_to_string(home.path().join("killed/log.txt")).expect("log.txt");
    assert!(log.contains("enhance already done"), "{log}");
    let scene =
        |out: &str| std::fs::read(home.path().join(out).join("scene.ply")).expect("scene.ply");
    assert!(
        scene("killed") == scene("whole"),
        "a resumed run must deliver what an undisturbed one does"
    );
}

#[test]
fn another_network_may_restore_what_has_no_guide_yet() {
    let home = tempfile::tempdir().expect("temporary folder");
    let capture = support::small_capture(home.path());
    let out = home.path().join("out");
    let unguided = format!("deblur_unguided={}", network("identity3").display());
    support::succeed(support::small_run(&capture, &out, 2).args([
        "--set",
        "deblur=small-u2w16",
        "--set",
        &unguided,
    ]));
    let report = support::json(&out.join("metrics.json"));
    let model = |use_of: &str| {
        report["models"][use_of]
            .as_str()
            .map(|model| model.split(' ').next().map(str::to_owned))
    };
    assert_eq!(
        model("deblur"),
        Some(Some("small-u2w16".to_owned())),
        "{report:#}"
    );
    assert_eq!(
        model("deblur_unguided"),
        Some(Some("identity3.onnx".to_owned())),
        "{report:#}"
    );
    let view = |round: u32, kind: &str| {
        let path = out.join(format!("rounds/{round}/{kind}/001.jpg"));
        Image::load(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    assert_eq!(
        view(1, "deblurred"),
        view(1, "enhanced"),
        "round 1 went through the identity"
    );
    assert_ne!(
        view(2, "deblurred"),
        view(2, "enhanced"),
        "round 2 went through ours"
    );
}

/// A server of one file, which breaks its first answer off after `cut` bytes; the requests' `range`
/// headers.
fn serve(content: Vec<u8>, cut: usize) -> (String, Arc<Mutex<Vec<Option<String>>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!(
        "http://{}/network.onnx",
        listener.local_addr().expect("bound")
    );
    let ranges = Arc::new(Mutex::new(Vec::new()));
    let seen = ranges.clone();
    std::thread::spawn(move || {
        for (count, stream) in listener.incoming().enumerate() {
            let Ok(stream) = stream else { continue };
            let range = answer(stream, &content, (count == 0).then_some(cut));
            seen.lock().expect("not poisoned").push(range);
        }
    });
    (url, ranges)
}

fn answer(mut stream: TcpStream, content: &[u8], cut: Option<usize>) -> Option<String> {
    let lines = BufReader::new(stream.try_clone().expect("a second handle")).lines();
    let head: Vec<String> = lines
        .map_while(Result::ok)
        .take_while(|line| !line.is_empty())
        .collect();
    let range = head.iter().find_map(|line| {
        line.to_lowercase()
            .strip_prefix("range: ")
            .map(str::to_owned)
    });
    let from = range.as_deref().and_then(|range| {
        range
            .strip_prefix("bytes=")?
            .strip_suffix('-')?
            .parse()
            .ok()
    });
    let from: usize = from.unwrap_or(0);
    if from >= content.len() {
        let head =
            "HTTP/1.1 416 Range Not Satisfiable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        let _ = stream.write_all(head.as_bytes());
        return range;
    }
    let status = if from > 0 {
        format!(
            "206 Partial Content\r\nContent-Range: bytes {from}-{}/{}",
            content.len() - 1,
            content.len()
        )
    } else {
        "200 OK".to_owned()
    };
    let length = content.len() - from;
    let head =
        format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
    let sent = &content[from..cut.unwrap_or(content.len())];
    let _ = stream
        .write_all(head.as_bytes())
        .and_then(|()| stream.write_all(sent));
    range
}

/// A list that names the network at `url`.
fn overlay(folder: &Path, url: &str, sha256: &str, bytes: usize) {
    let entry = serde_json::json!({
        "id": "far", "role": "single", "file": "far.onnx", "url": url, "sha256": sha256, "bytes": bytes, "licence": "MIT",
        "channels": 3, "order": ["blurry"], "multiple": 16, "minimum_side": 16, "tile": 1024, "range": [-1.0, 2.0],
        "input": null, "output": null, "default": false, "verified": false,
    });
    let text = serde_json::json!({ "models": [entry] }).to_string();
    std::fs::write(folder.join("manifest.json"), text).expect("write");
}

#[test]
fn a_broken_download_goes_on_where_it_stopped() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), 100);
    overlay(home.path(), &url, &digest(&content), content.len());
    let broken = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&broken), 4, "{}", said(&broken));
    assert!(
        said(&broken).contains("stopped after 100"),
        "{}",
        said(&broken)
    );
    assert!(
        !home.path().join("far.onnx").exists(),
        "only a whole file may be found"
    );
    let whole = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&whole), 0, "{}", said(&whole));
    assert_eq!(
        std::fs::read(home.path().join("far.onnx")).expect("fetched"),
        content
    );
    assert_eq!(
        *ranges.lock().expect("not poisoned"),
        [None, Some("bytes=100-".to_owned())]
    );
    assert!(!home.path().join("far.part").exists());
    assert_eq!(code(&models(home.path(), &["verify", "far"])), 0);
    let again = models(home.path(), &["fetch", "far"]);
    assert!(said(&again).contains("is here"), "{}", said(&again));
    assert_eq!(
        ranges.lock().expect("not poisoned").len(),
        2,
        "nothing is fetched twice"
    );
    std::fs::write(home.path().join("far.onnx"), "damaged").expect("write");
    assert_eq!(
        code(&models(home.path(), &["fetch", "far"])),
        0,
        "a damaged file is fetched anew"
    );
    assert_eq!(
        std::fs::read(home.path().join("far.onnx")).expect("fetched"),
        content
    );
}

#[test]
fn what_an_earlier_download_left_is_used_when_it_is_whole_and_doubted_when_not() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    std::fs::write(
        home.path().join("far.part"),
        [b"of another file", &content[..40]].concat(),
    )
    .expect("write");
    let mended = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&mended), 0, "{}", said(&mended));
    assert_eq!(
        ranges.lock().expect("not poisoned").len(),
        2,
        "the rest, then the whole"
    );
    std::fs::remove_file(home.path().join("far.onnx")).expect("there");
    std::fs::write(home.path().join("far.part"), &content).expect("write");
    assert_eq!(code(&models(home.path(), &["fetch", "far"])), 0);
    assert_eq!(
        ranges.lock().expect("not poisoned").len(),
        2,
        "what is whole is not fetched again"
    );
}

#[test]
fn a_file_whose_checksum_nobody_knows_is_not_called_whole() {
    let home = tempfile::tempdir().expect("temporary folder");
    overlay(home.path(), "http://127.0.0.1:9/far.onnx", "", 0);
    let list = std::fs::read_to_string(home.path().join("manifest.json")).expect("written");
    let list = list.replace("\"sha256\":\"\"", "\"sha256\":null");
    std::fs::write(home.path().join("manifest.json"), list).expect("write");
    std::fs::copy(network("box3"), home.path().join("far.onnx")).expect("copy");
    let here = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&here), 0, "{}", said(&here));
    assert!(
        said(&here).contains("is not known") && !said(&here).contains("whole"),
        "{}",
        said(&here)
    );
    std::fs::write(home.path().join("far.onnx"), "cut short").expect("write");
    assert_eq!(code(&models(home.path(), &["fetch", "far"])), 4);
}

#[test]
fn what_a_network_is_known_to_return_is_compared_and_kept() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, _) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    let list = std::fs::read_to_string(home.path().join("manifest.json")).expect("written");
    let list = list.replace("\"id\":\"far\"", "\"id\":\"far\",\"golden\":\"far.golden\"");
    std::fs::write(home.path().join("manifest.json"), list).expect("write");
    let golden = home.path().join("far.golden");
    let grey = 0.5_f32.to_le_bytes().repeat(3 * 64 * 64);
    std::fs::write(&golden, &grey).expect("write");
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4, "{}", said(&refused));
    assert!(said(&refused).contains("off by"), "{}", said(&refused));
    assert_eq!(
        std::fs::read(&golden).expect("kept"),
        grey,
        "not written over by what this machine computes"
    );
    assert!(!home.path().join("far.onnx").exists());
}

#[test]
fn more_than_the_whole_is_begun_again() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    std::fs::write(
        home.path().join("far.part"),
        [&content[..], b"and more"].concat(),
    )
    .expect("write");
    let mended = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&mended), 0, "{}", said(&mended));
    assert_eq!(
        std::fs::read(home.path().join("far.onnx")).expect("fetched"),
        content
    );
    let past = format!("bytes={}-", content.len() + 8);
    assert_eq!(
        *ranges.lock().expect("not poisoned"),
        [Some(past), None],
        "refused, then the whole"
    );
}

#[test]
fn nobody_fetches_what_another_is_fetching() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    let part = std::fs::File::create(home.path().join("far.part")).expect("created");
    part.lock().expect("locked");
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4, "{}", said(&refused));
    assert!(
        said(&refused).contains("being fetched already"),
        "{}",
        said(&refused)
    );
    assert!(
        ranges.lock().expect("not poisoned").is_empty(),
        "nothing was asked for"
    );
    drop(part);
    assert_eq!(code(&models(home.path(), &["fetch", "far"])), 0);
}

#[test]
fn another_file_than_the_named_one_is_thrown_away() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, _) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(b"another"), content.len());
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4);
    assert!(
        said(&refused).contains("It was removed") && said(&refused).contains(&digest(&content)),
        "{}",
        said(&refused)
    );
    assert!(!home.path().join("far.onnx").exists() && !home.path().join("far.part").exists());
}

#[test]
fn without_a_network_the_way_by_hand_is_told() {
    let home = tempfile::tempdir().expect("temporary folder");
    let closed = TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port");
    overlay(
        home.path(),
        &format!("http://{closed}/far.onnx"),
        &digest(b"x"),
        1,
    );
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4);
    assert!(
        said(&refused).contains("fled models add FILE --id far"),
        "{}",
        said(&refused)
    );
}
