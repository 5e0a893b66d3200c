//! Replays inputs kept by fuzzers: those that reach deep into the readers, and those that made one
//! fail.

mod readers;

use std::fs;
use std::path::Path;

/// Accepts any bytes.
type Reader = fn(&[u8]);

fn read_all(name: &str, least: usize, read: Reader) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(name);
    let files = fs::read_dir(&folder).expect(name).map(|file| file.expect("a file").path());
    let mut count = 0;
    for path in files {
        let bytes = fs::read(&path).expect("read");
        let outcome = std::panic::catch_unwind(|| read(&bytes));
        assert!(outcome.is_ok(), "{}", path.display());
        count += 1;
    }
    assert!(count >= least, "{count} of {name} are there");
}

#[test]
fn every_reader_withstands_the_inputs_kept_by_fuzzers() {
    let readers: [(&str, Reader); 7] = [
        ("zip", readers::zip),
        ("exif", readers::exif),
        ("ply", readers::ply),
        ("npy", readers::npy),
        ("colmap", readers::colmap),
        ("tus", readers::tus),
        ("transforms", readers::transforms),
    ];
    for (name, read) in readers {
        read_all(name, 10, read);
    }
}
