//! No file uses an item of a file that, itself or through others, uses an item of the first.
//!
//! `mod child;` and `pub use child::Item;` use nothing. Methods are not followed: a file that
//! calls one has the value from somewhere, and that it names.

use std::collections::{BTreeMap, BTreeSet};

use crate::modules::{Edge, Modules};
use crate::sources::{Source, expect_none, files};

/// Sets of files that all lead to each other.
fn circles(edges: &[Edge]) -> BTreeSet<BTreeSet<&str>> {
    let mut next: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for edge in edges {
        next.entry(&edge.from).or_default().insert(&edge.to);
    }
    let reached: BTreeMap<&str, BTreeSet<&str>> = next
        .keys()
        .map(|start| (*start, reached(start, &next)))
        .collect();
    let circle = |start: &str| -> BTreeSet<&str> {
        let leads_back = |file: &&str| reached.get(file).is_some_and(|back| back.contains(start));
        reached[start].iter().copied().filter(leads_back).collect()
    };
    let circles = next.keys().map(|start| circle(start));
    circles.filter(|circle| circle.len() > 1).collect()
}

/// The files that one or more edges lead to from a file.
fn reached<'a>(start: &'a str, next: &BTreeMap<&'a str, BTreeSet<&'a str>>) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut waiting: Vec<&str> = vec![start];
    while let Some(file) = waiting.pop() {
        let unseen = next.get(file).into_iter().flatten();
        waiting.extend(unseen.filter(|file| reached.insert(**file)));
    }
    reached
}

/// One fault a circle, with the edges inside it.
fn faults(sources: &[Source]) -> Vec<String> {
    let edges = Modules::of(sources).edges();
    let fault = |circle: &BTreeSet<&str>| {
        let within = edges.iter().filter(|edge| {
            circle.contains(edge.from.as_str()) && circle.contains(edge.to.as_str())
        });
        let lines = within.map(|edge| {
            format!(
                "\n  {}:{} uses {} of {}",
                edge.from, edge.line, edge.name, edge.to
            )
        });
        format!(
            "{} files in a circle:{}",
            circle.len(),
            lines.collect::<String>()
        )
    };
    circles(&edges).iter().map(fault).collect()
}

/// Files below `src/a/`, each with its text.
fn made_up(texts: &[(&str, &str)]) -> Vec<Source> {
    let source = |(name, text): &(&str, &str)| Source::made_up(&format!("src/a/{name}"), text);
    texts.iter().map(source).collect()
}

#[test]
fn no_files_use_each_other_in_a_circle() {
    let sources = files("src", "rs");
    let modules = Modules::of(&sources);
    assert!(
        modules.len() > 100,
        "only {} files were found",
        modules.len()
    );
    let edges = modules.edges().len();
    assert!(edges > 300, "only {edges} uses were found");
    expect_none(&faults(&sources));
}

#[test]
fn a_circle_is_found_with_its_lines() {
    let sources = made_up(&[
        ("lib.rs", "mod b;\nmod c;\nmod d;\n"),
        ("b.rs", "pub struct B;\n\nuse crate::c::C;\n"),
        ("c.rs", "pub struct C(crate::d::D);\n"),
        ("d.rs", "use super::b::{self};\n\npub struct D(b::B);\n"),
    ]);
    assert_eq!(
        faults(&sources),
        ["3 files in a circle:\
          \n  src/a/b.rs:3 uses C of src/a/c.rs\
          \n  src/a/c.rs:1 uses D of src/a/d.rs\
          \n  src/a/d.rs:3 uses B of src/a/b.rs"]
    );
}

#[test]
fn a_parent_that_calls_its_child_which_uses_the_parent_is_a_circle() {
    let child = ("b/c.rs", "use super::B;\n\npub fn c(_: B) {}\n");
    let calls = (
        "b.rs",
        "mod c;\n\npub struct B;\n\nfn b() {\n    c::c(B);\n}\n",
    );
    let root = ("lib.rs", "mod b;\n");
    let found = faults(&made_up(&[root, calls, child]));
    assert_eq!(found.len(), 1);
    assert!(
        found[0].contains("src/a/b.rs:6 uses c of src/a/b/c.rs"),
        "{found:?}"
    );

    let declares = ("b.rs", "mod c;\n\npub use c::c;\n\npub struct B;\n");
    expect_none(&faults(&made_up(&[root, declares, child])));

    let shows_and_calls = (
        "b.rs",
        "mod c;\n\npub use c::c;\n\npub struct B;\n\nfn b() { c(B) }\n",
    );
    assert_eq!(faults(&made_up(&[root, shows_and_calls, child])).len(), 1);
}

#[test]
fn a_re_export_is_followed_to_the_file_that_defines_the_item() {
    let sources = made_up(&[
        ("lib.rs", "mod b;\nmod e;\npub use b::Deep;\n"),
        (
            "b.rs",
            "mod c;\nmod d;\npub use c::inner as renamed;\npub use d::Deep;\n",
        ),
        ("b/c.rs", "pub fn inner(_: crate::Deep) {}\n"),
        (
            "b/d.rs",
            "pub struct Deep;\n\nfn d() { super::renamed(Deep) }\n",
        ),
        ("e.rs", "use crate::b::Deep;\n"),
    ]);
    let edges = Modules::of(&sources).edges();
    let e = edges.iter().find(|edge| edge.from == "src/a/e.rs");
    assert_eq!(e.map(|edge| edge.to.as_str()), Some("src/a/b/d.rs"));
    assert_eq!(
        faults(&sources),
        ["2 files in a circle:\
          \n  src/a/b/c.rs:1 uses Deep of src/a/b/d.rs\
          \n  src/a/b/d.rs:3 uses inner of src/a/b/c.rs"]
    );
}

#[test]
fn one_way_imports_tests_and_other_crates_make_no_circle() {
    let sources = made_up(&[
        ("lib.rs", "mod b;\nmod c;\n#[cfg(test)]\nmod tests;\n"),
        (
            "b.rs",
            "use std::fmt;\nuse c::{self, C};\npub struct B(c::Other);\n",
        ),
        (
            "c.rs",
            "pub struct C;\n#[cfg(test)]\nmod tests {\n    use crate::b::B;\n}\n",
        ),
        ("tests.rs", "use crate::b::B;\n"),
    ]);
    expect_none(&faults(&sources));
}
