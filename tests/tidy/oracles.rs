//! Every comparing helper must have a test in which it fails.

use crate::sources::{Source, expect_none, files};

/// Helpers `fn assert_*` in test code that no `#[should_panic]` test of the same file calls.
fn faults(source: &Source) -> Vec<String> {
    let condemned: Vec<&str> = source
        .text
        .split("#[should_panic")
        .skip(1)
        .map(|rest| {
            rest.split("\n    }\n").next().unwrap_or(rest).split("\n}\n").next().unwrap_or(rest)
        })
        .collect();
    let unit_tests = source.text.find("\n#[cfg(test)]\nmod tests {").unwrap_or(source.text.len());
    let only_tests = source.path.starts_with("tests/") || source.path.ends_with("tests.rs");
    let tests = if only_tests { &source.text[..] } else { &source.text[unit_tests..] };
    let helpers = tests.lines().filter_map(|line| {
        let name = line.trim_start().trim_start_matches("pub(crate) ").trim_start_matches("pub ");
        let name = name.strip_prefix("fn ")?;
        name.starts_with("assert_").then(|| name.split(['(', '<']).next().unwrap_or(name))
    });
    helpers
        .filter(|helper| !condemned.iter().any(|body| body.contains(&format!("{helper}("))))
        .map(|helper| format!("{}: no `#[should_panic]` test calls {helper}", source.path))
        .collect()
}

#[test]
fn every_comparison_has_a_failing_test() {
    let mut sources = files("src", "rs");
    sources.extend(files("tests", "rs"));
    sources.retain(|source| source.path != "tests/tidy/oracles.rs");
    expect_none(&sources.iter().flat_map(faults).collect::<Vec<_>>());
}

#[test]
fn a_comparison_without_a_failing_test_is_detected() {
    let helper = "fn assert_close(a: f32, b: f32) {}\n";
    assert_eq!(faults(&Source::made_up("tests/a.rs", helper)).len(), 1);
    let test =
        format!("{helper}#[test]\n#[should_panic]\nfn far() {{\n    assert_close(1.0, 2.0);\n}}\n");
    assert!(faults(&Source::made_up("tests/a.rs", &test)).is_empty());
    let in_unit_tests = format!("\n#[cfg(test)]\nmod tests {{\n    {helper}}}\n");
    assert_eq!(faults(&Source::made_up("src/a.rs", &in_unit_tests)).len(), 1);
    let unrelated = format!(
        "{helper}#[should_panic]\nfn far() {{\n    panic!();\n}}\nassert_close(1.0, 1.0);\n"
    );
    assert_eq!(faults(&Source::made_up("tests/a.rs", &unrelated)).len(), 1);
}
