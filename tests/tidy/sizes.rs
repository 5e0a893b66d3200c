//! Files that one can read in one sitting.

use crate::sources::{Source, expect_none, files};

/// Lines of a Rust file, its tests included.
const RUST: usize = 450;

/// Lines of a shader.
const SHADER: usize = 200;

/// Longer ones, each with its own limit and reason.
const LONGER: [(&str, usize, &str); 1] = [(
    "shaders/train/project_backward_adam.wgsl",
    270,
    "projection backward and Adam in one kernel, so that gradients never reach memory",
)];

fn faults(sources: &[Source], limit: usize) -> Vec<String> {
    let fault = |source: &Source| {
        let own = LONGER
            .iter()
            .find(|(path, _, _)| *path == source.path)
            .map(|(_, own, _)| *own);
        let (lines, limit) = (source.text.lines().count(), own.unwrap_or(limit));
        (lines > limit).then(|| format!("{}: {lines} lines, at most {limit}", source.path))
    };
    sources.iter().filter_map(fault).collect()
}

#[test]
fn files_are_not_too_long() {
    expect_none(&faults(&files("src", "rs"), RUST));
    expect_none(&faults(&files("tests", "rs"), RUST));
    expect_none(&faults(&files("shaders", "wgsl"), SHADER));
}

#[test]
fn a_long_file_is_found() {
    let of = |lines: usize| Source::made_up("src/core/long.rs", &"\n".repeat(lines));
    assert_eq!(
        faults(&[of(450), of(451)], RUST),
        ["src/core/long.rs: 451 lines, at most 450"]
    );
}
