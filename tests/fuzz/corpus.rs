//! What fuzzers have kept, read again: inputs that reach far into the readers, and those that were
//! too much for one once.

mod readers;

use std::fs;
use std::path::Path;

/// Takes whatever bytes there are.
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
fn every_reader_stands_what_fuzzers_have_kept() {
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
