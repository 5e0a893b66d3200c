//! The peak memory of a run over large photographs on a machine with many cores.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use fled_core::image::{EncodeFormat, Image};
use fled_core::synthetic::{SynthOptions, generate};

use crate::support::fled;

/// Photographs, and their width and height, px: 24 megapixels.
const VIEWS: usize = 24;
const SIZE: (usize, usize) = (6_000, 4_000);
/// Largest resident memory while the capture is prepared, and of the whole run, MB.
const MAX_PREPARING: u64 = 600;
const MAX_RUN: u64 = 1_500;

/// Peak resident memory of a process so far, MB; `None` once it has exited.
fn peak(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse().ok()?;
    Some(kilobytes / 1_000)
}

/// Replaces the photographs of a small capture by large ones.
fn enlarge(capture: &Path) {
    let photographs = fs::read_dir(capture.join("images")).expect("listed");
    for path in photographs.map(|entry| entry.expect("an entry").path()) {
        let large = Image::load(&path).expect("read").resize_bilinear(SIZE.0, SIZE.1);
        fs::remove_file(&path).expect("removed");
        let file = path.with_extension("jpg");
        large.save_as(&file, EncodeFormat::Jpeg(90)).expect("written");
    }
}

#[test]
#[ignore = "make test-nightly"]
fn large_photographs_and_many_cores_take_no_more_memory() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("capture");
    let options = SynthOptions {
        views: VIEWS,
        width: 300,
        height: 200,
        seed: 3,
        blur: 3.0,
        ..SynthOptions::default()
    };
    generate(&options, &capture).expect("a synthetic capture");
    fs::remove_dir_all(capture.join("HL")).expect("removed");
    enlarge(&capture);
    let prepared = folder.path().join("prepared");
    let mut prepare = fled();
    prepare.arg("prepare").arg(&capture).arg("--out").arg(&prepared);
    let preparing = peak_of(prepare);
    let mut run = fled();
    run.arg("run").arg(&prepared).arg("--out").arg(folder.path().join("out"));
    run.args(["--cache", "none", "--set", "steps=60", "--set", "pose_source=given"]);
    let whole = peak_of(run);
    assert!(preparing <= MAX_PREPARING, "preparing took {preparing} MB");
    assert!(whole <= MAX_RUN, "the run took {whole} MB");
}

/// Peak resident memory, MB, of a command on a machine with many cores.
fn peak_of(mut command: Command) -> u64 {
    command.env("RAYON_NUM_THREADS", "16").stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().expect("the binary starts");
    let mut most = 0;
    loop {
        most = most.max(peak(child.id()).unwrap_or(0));
        if let Some(status) = child.try_wait().expect("waited") {
            assert!(status.success(), "{status}");
            return most;
        }
        thread::sleep(Duration::from_millis(50));
    }
}
