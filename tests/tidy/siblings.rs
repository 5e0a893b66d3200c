//! The modules of the core: who may import whom.

use crate::sources::{Source, expect_none, files};

/// Words that every module shares. `agreement` compares a kernel with its reference, in tests;
/// the kind of an error decides exit code, HTTP status and retry for all of them alike.
const SHARED: [&str; 8] = [
    "agreement",
    "camera",
    "cancel",
    "event",
    "gaussians",
    "image",
    "pipeline::error",
    "random",
];

/// Every other import that is allowed, with its reason beside it.
const ALLOWED: [(&str, &[&str]); 8] = [
    // The pipeline drives all others.
    ("pipeline", &["*"]),
    // The bench measures what the others do.
    ("bench", &["*"]),
    // Training is made of rasterisation, noise field, shake and registration, and reports what the
    // field learnt.
    (
        "reconstruct",
        &["splat", "noise", "shake", "register", "metrics"],
    ),
    // Rendering is the forward half of rasterisation.
    ("render", &["splat"]),
    // The row of a round is an event.
    ("event", &["metrics"]),
    // COLMAP is one source of poses; the shape of poses is everybody's.
    ("colmap", &["poses"]),
    ("dataset", &["poses"]),
    ("synthetic", &["poses"]),
];

/// Imports between siblings that no row allows.
fn faults(sources: &[Source]) -> Vec<String> {
    let mut faults = Vec::new();
    for source in sources
        .iter()
        .filter(|source| !source.path.ends_with("tests.rs"))
    {
        let Some(module) = source
            .path
            .strip_prefix("src/core/")
            .and_then(|rest| rest.split(['/', '.']).next())
        else {
            continue;
        };
        for (number, line) in source.code() {
            for imported in imports(line) {
                if imported != module && module != "lib" && !allowed(module, imported) {
                    faults.push(format!(
                        "{}:{number}: {module} imports its sibling {imported}",
                        source.path
                    ));
                }
            }
        }
    }
    faults
}

/// The modules named after `crate::` in a line; of the pipeline's, with the one below it.
fn imports(line: &str) -> impl Iterator<Item = &str> {
    line.split("crate::").skip(1).filter_map(|rest| {
        let inside = if rest.starts_with("pipeline::error") {
            "pipeline::error".len()
        } else {
            0
        };
        let word = |c: char| !c.is_ascii_lowercase() && c != '_';
        let end = inside + rest[inside..].find(word).unwrap_or(rest.len() - inside);
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
    assert!(
        sources.len() > 20,
        "the walk found only {} files",
        sources.len()
    );
    expect_none(&faults(&sources));
}

#[test]
fn an_import_of_a_sibling_is_found() {
    let bad = Source::made_up(
        "src/core/deblur/onnx.rs",
        "use crate::image::Image;\nuse crate::enhance::curve;\n",
    );
    assert_eq!(
        faults(&[bad]),
        ["src/core/deblur/onnx.rs:2: deblur imports its sibling enhance"]
    );
    let good = Source::made_up("src/core/pipeline.rs", "use crate::enhance::curve;\n");
    assert!(faults(&[good]).is_empty());
}

#[test]
fn a_shared_module_that_imports_the_pipeline_is_found() {
    let bad = Source::made_up("src/core/image/load.rs", "    crate::pipeline::run();\n");
    let kind = Source::made_up(
        "src/core/image/load.rs",
        "use crate::pipeline::error::ErrorKind;\n",
    );
    assert_eq!((faults(&[bad]).len(), faults(&[kind]).len()), (1, 0));
}
