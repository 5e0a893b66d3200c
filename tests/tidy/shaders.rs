//! Every shader: embedded, valid, and introduced by a header that says what it reads and writes.

use std::collections::BTreeSet;

use crate::sources::{Source, expect_none, files};

/// What the header of a kernel must name.
const HEADER: [&str; 3] = ["reads", "writes", "dispatch"];

/// What is wrong with the comment at the top of a shader.
fn faults(shader: &Source) -> Vec<String> {
    let comment: Vec<&str> = shader.text.lines().take_while(|line| line.starts_with("//")).collect();
    let mut faults = Vec::new();
    if comment.is_empty() {
        faults.push(format!("{}: no comment at the top", shader.path));
    }
    if shader.text.contains("@compute") {
        let text = comment.join(" ").to_lowercase();
        let missing = HEADER.iter().filter(|word| !text.contains(*word));
        faults.extend(missing.map(|word| format!("{}: the header does not say `{word}`", shader.path)));
        if shader.text.matches("@compute").count() > 1 {
            faults.push(format!("{}: more than one entry point", shader.path));
        }
    }
    for (number, line) in (1..).zip(shader.text.lines()) {
        if line.contains("storage") && line.contains("vec3") {
            faults.push(format!("{}:{number}: a vec3 in storage has a hole behind it", shader.path));
        }
        if line.starts_with('#') && !line.starts_with("#import ") {
            faults.push(format!("{}:{number}: `#import` is all there is", shader.path));
        }
    }
    faults
}

#[test]
fn shaders_say_what_they_read_write_and_how_they_are_dispatched() {
    let shaders = files("shaders", "wgsl");
    assert!(shaders.len() > 5, "the walk found only {} shaders", shaders.len());
    expect_none(&shaders.iter().flat_map(faults).collect::<Vec<_>>());
}

#[test]
fn a_shader_without_a_header_is_found() {
    let bare = Source::made_up("shaders/a.wgsl", "@compute @workgroup_size(1)\nfn main() {}\n");
    assert_eq!(faults(&bare).len(), 4);
    let hole = "// A list.\n@group(0) @binding(0) var<storage> a: array<vec3<f32>>;\n#define X\n";
    assert_eq!(faults(&Source::made_up("shaders/b.wgsl", hole)).len(), 2);
}

#[test]
fn every_shader_is_embedded_and_valid() {
    let embedded: BTreeSet<String> = fled_gpu::shader::names().map(str::to_owned).collect();
    let name =
        |source: Source| source.path.trim_start_matches("shaders/").trim_end_matches(".wgsl").to_owned();
    let present: BTreeSet<String> = files("shaders", "wgsl").into_iter().map(name).collect();
    assert_eq!(embedded, present);
    for name in &embedded {
        let text = fled_gpu::shader::expand(name, &[]).unwrap_or_else(|error| panic!("{error}"));
        fled_gpu::reflect::validate(name, &text).unwrap_or_else(|error| panic!("{error}"));
    }
}
