//! The modules of the core: who may import whom.

use crate::sources::{Source, expect_none, files};

/// Words that every module shares.
const SHARED: [&str; 5] = ["camera", "cancel", "event", "gaussians", "image"];

/// Every other import that is allowed, with its reason beside it.
const ALLOWED: [(&str, &[&str]); 5] = [
    // The pipeline drives all others.
    ("pipeline", &["*"]),
    // Training is made of rasterisation and the noise field.
    ("reconstruct", &["splat", "noise"]),
    // Rendering is the forward half of rasterisation.
    ("render", &["splat"]),
    // The row of a round is an event.
    ("event", &["metrics"]),
    // COLMAP is one source of poses; the shape of poses is everybody's.
    ("colmap", &["poses"]),
];

/// Imports between siblings that no row allows.
fn faults(sources: &[Source]) -> Vec<String> {
    let mut faults = Vec::new();
    for source in sources {
        let Some(module) =
            source.path.strip_prefix("src/core/").and_then(|rest| rest.split(['/', '.']).next())
        else {
            continue;
        };
        for (number, line) in source.code() {
            for imported in imports(line) {
                if imported != module && module != "lib" && !allowed(module, imported) {
                    faults.push(format!("{}:{number}: {module} imports its sibling {imported}", source.path));
                }
            }
        }
    }
    faults
}

/// The modules named after `crate::` in a line.
fn imports(line: &str) -> impl Iterator<Item = &str> {
    line.split("crate::").skip(1).filter_map(|rest| {
        let end = rest.find(|c: char| !c.is_ascii_lowercase() && c != '_').unwrap_or(rest.len());
        (end > 0).then_some(&rest[..end])
    })
}

fn allowed(module: &str, imported: &str) -> bool {
    SHARED.contains(&imported)
        || ALLOWED
            .iter()
            .any(|(who, whom)| *who == module && (whom.contains(&imported) || whom.contains(&"*")))
}

#[test]
fn siblings_do_not_import_each_other() {
    let sources = files("src/core", "rs");
    assert!(sources.len() > 20, "the walk found only {} files", sources.len());
    expect_none(&faults(&sources));
}

#[test]
fn an_import_of_a_sibling_is_found() {
    let bad =
        Source::made_up("src/core/deblur/onnx.rs", "use crate::image::Image;\nuse crate::enhance::curve;\n");
    assert_eq!(faults(&[bad]), ["src/core/deblur/onnx.rs:2: deblur imports its sibling enhance"]);
    let good = Source::made_up("src/core/pipeline.rs", "use crate::enhance::curve;\n");
    assert!(faults(&[good]).is_empty());
}

#[test]
fn a_shared_module_that_imports_the_pipeline_is_found() {
    let bad = Source::made_up("src/core/image/load.rs", "    crate::pipeline::run();\n");
    assert_eq!(faults(&[bad]).len(), 1);
}
