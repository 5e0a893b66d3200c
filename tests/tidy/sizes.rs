//! Files that one can read in one sitting.

use crate::sources::{Source, expect_none, files};

/// Lines of a Rust file, its tests included.
const RUST: usize = 500;

/// Lines of a shader.
const SHADER: usize = 200;

fn faults(sources: &[Source], limit: usize) -> Vec<String> {
    let long = sources.iter().map(|source| (source, source.text.lines().count()));
    long.filter(|(_, lines)| *lines > limit)
        .map(|(source, lines)| format!("{}: {lines} lines, at most {limit}", source.path))
        .collect()
}

#[test]
fn files_are_not_too_long() {
    expect_none(&faults(&files("src", "rs"), RUST));
    expect_none(&faults(&files("tests", "rs"), RUST));
    expect_none(&faults(&files("shaders", "wgsl"), SHADER));
}

#[test]
fn a_long_file_is_found() {
    let long = Source::made_up("src/core/long.rs", &"\n".repeat(501));
    assert_eq!(faults(&[long], RUST), ["src/core/long.rs: 501 lines, at most 500"]);
}
