//! Every shader must be embedded, be valid, and have a header that lists what it reads and writes.

use std::collections::BTreeSet;

use crate::sources::{Source, expect_none, files};

/// Words that the header of a kernel must contain.
const HEADER: [&str; 3] = ["reads", "writes", "dispatch"];

/// The comment at the top of a shader, in lower case.
fn header(shader: &Source) -> String {
    let lines = shader.text.lines().take_while(|line| line.starts_with("//"));
    let lines = lines.map(|line| line.trim_start_matches('/').trim());
    lines.collect::<Vec<_>>().join(" ").to_lowercase()
}

/// The faults of a shader. The header of a kernel that says `see shared/x.wgsl` includes that
/// file's header.
fn faults(shader: &Source, all: &[Source]) -> Vec<String> {
    let mut text = header(shader);
    let mut faults = Vec::new();
    if text.is_empty() {
        faults.push(format!("{}: no comment at the top", shader.path));
    }
    for other in all {
        if text.contains(&format!("see {}", other.path.trim_start_matches("shaders/"))) {
            text += &header(other);
        }
    }
    let entries = shader.text.matches("@compute").count();
    if entries > 0 {
        let missing = HEADER.iter().filter(|word| !text.contains(*word));
        faults.extend(
            missing.map(|word| format!("{}: the header does not say `{word}`", shader.path)),
        );
    }
    if entries > 1 {
        faults.push(format!("{}: more than one entry point", shader.path));
    }
    for (number, line) in (1..).zip(shader.text.lines()) {
        if line.contains("storage") && line.contains("vec3") {
            faults
                .push(format!("{}:{number}: a vec3 in storage has a hole behind it", shader.path));
        }
        if line.starts_with('#') && !line.starts_with("#import ") {
            faults.push(format!("{}:{number}: `#import` is all there is", shader.path));
        }
    }
    faults
}

#[test]
fn shaders_document_reads_writes_and_dispatch() {
    let shaders = files("shaders", "wgsl");
    assert!(shaders.len() > 5, "the walk found only {} shaders", shaders.len());
    expect_none(&shaders.iter().flat_map(|shader| faults(shader, &shaders)).collect::<Vec<_>>());
}

#[test]
fn a_shader_without_a_header_is_detected() {
    let bare = Source::made_up("shaders/a.wgsl", "@compute @workgroup_size(1)\nfn main() {}\n");
    assert_eq!(faults(&bare, &[]).len(), 4);
    let hole = "// A list.\n@group(0) @binding(0) var<storage> a: array<vec3<f32>>;\n#define X\n";
    assert_eq!(faults(&Source::made_up("shaders/b.wgsl", hole), &[]).len(), 2);
    let seen = Source::made_up(
        "shaders/c.wgsl",
        "// See\n// shared/d.wgsl. Dispatch: one.\n@compute @workgroup_size(1)\n",
    );
    let half = Source::made_up("shaders/shared/d.wgsl", "// Reads a.\n");
    assert_eq!(faults(&seen, &[half]), ["shaders/c.wgsl: the header does not say `writes`"]);
}

#[test]
fn every_shader_is_embedded_and_every_kernel_is_valid() {
    let embedded: BTreeSet<String> = fled_gpu::shader::names().map(str::to_owned).collect();
    let name =
        |path: &str| path.trim_start_matches("shaders/").trim_end_matches(".wgsl").to_owned();
    let shaders = files("shaders", "wgsl");
    assert_eq!(embedded, shaders.iter().map(|shader| name(&shader.path)).collect());
    // A file without an entry point is a fragment, valid only where it is imported.
    for kernel in shaders.iter().filter(|shader| shader.text.contains("@compute")) {
        let name = name(&kernel.path);
        let text = fled_gpu::shader::expand(&name, &[]).unwrap_or_else(|error| panic!("{error}"));
        fled_gpu::reflect::validate(&name, &text).unwrap_or_else(|error| panic!("{error}"));
    }
}

#[test]
fn an_invalid_shader_is_detected() {
    let text = "fn f() -> f32 { return undeclared; }";
    assert!(fled_gpu::reflect::validate("bad", text).is_err());
}
