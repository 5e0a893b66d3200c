//! The modules of the core: who may import whom.

use crate::imports::{Outline, Path};
use crate::sources::{Source, expect_none, files};

/// Who may import whom. A module is named as `pipeline`, or as `pipeline::error` where one below it
/// has rights of its own.
struct Rules<'a> {
    /// What every module may import.
    shared: &'a [&'a str],
    /// What some may import besides; `*` is everything.
    allowed: &'a [(&'a str, &'a [&'a str])],
}

/// Words that every module shares. `agreement` compares a kernel with its reference, in tests;
/// the kind of an error decides exit code, HTTP status and retry for all of them alike.
const SHARED: [&str; 9] = [
    "agreement",
    "camera",
    "cancel",
    "event",
    "gaussians",
    "image",
    "linear",
    "pipeline::error",
    "random",
];

/// Every other import that is allowed, with its reason beside it.
const ALLOWED: [(&str, &[&str]); 15] = [
    // The pipeline drives all others.
    ("pipeline", &["*"]),
    // The bench measures what the others do.
    ("bench", &["*"]),
    // The evaluation judges what a run left with whatever judges.
    ("evaluation", &["*"]),
    // ffmpeg reads the videos of captures, and writes those of results, whose run says from where
    // one may look.
    ("capture", &["ffmpeg"]),
    ("video", &["ffmpeg", "run_folder"]),
    // What is handed on is read from a run's folder; a COLMAP model is one of its forms.
    ("export", &["poses", "run_folder"]),
    // Training is made of rasterisation, noise field, shake and registration, keeps Gaussians off
    // what stereo finds free, and reports what the field learnt.
    (
        "reconstruct",
        &["splat", "noise", "shake", "register", "stereo", "metrics"],
    ),
    // Rendering is the forward half of rasterisation.
    ("render", &["splat"]),
    // The row of a round says how bright it was.
    ("metrics", &["enhance"]),
    // The row of a round is an event.
    ("event", &["metrics"]),
    // COLMAP is one source of poses; the shape of poses is everybody's.
    ("colmap", &["poses"]),
    ("dataset", &["poses"]),
    // Networks run in ONNX Runtime; some of them find matches for who finds poses.
    ("deblur", &["inference"]),
    ("features", &["inference", "poses"]),
    ("synthetic", &["poses"]),
];

/// Imports between siblings that no row allows.
fn faults(sources: &[Source], rules: &Rules<'_>) -> Vec<String> {
    let mut faults = Vec::new();
    for source in sources {
        let path = source.path.strip_prefix("src/core/").unwrap_or("lib.rs");
        let modules: Vec<&str> = path.trim_end_matches(".rs").split('/').collect();
        let module = modules[0];
        if module == "lib" || path.ends_with("tests.rs") {
            continue;
        }
        let outline = Outline::of(source);
        let imported = outline.imports.iter().map(|import| &import.path);
        for path in imported.chain(&outline.paths) {
            let Some(below_crate) = below_crate(path, modules.len()) else {
                continue;
            };
            let sibling = &below_crate[0];
            if sibling != module && !rules.allow(module, below_crate) {
                faults.push(format!(
                    "{}:{}: {module} imports its sibling {sibling}",
                    source.path, path.line
                ));
            }
        }
    }
    faults
}

/// What a path names below the crate, from a module of it on, in a file so many modules deep.
fn below_crate(path: &Path, depth: usize) -> Option<&[String]> {
    let is_super = |segment: &&String| segment.as_str() == "super";
    let ups = path.segments.iter().take_while(is_super).count();
    let below = match path.segments[0].as_str() {
        "crate" => &path.segments[1..],
        "super" if ups == depth + path.inside.len() => &path.segments[ups..],
        _ => return None,
    };
    // Types of the crate itself are no modules.
    let is_module = |segment: &String| segment.starts_with(|c: char| c.is_ascii_lowercase());
    below.first().is_some_and(is_module).then_some(below)
}

impl Rules<'_> {
    /// Whether a module may import what lies there below the crate.
    fn allow(&self, module: &str, below_crate: &[String]) -> bool {
        let sibling = &below_crate[0];
        let one_below = below_crate[..below_crate.len().min(2)].join("::");
        let holds = |names: &[&str]| {
            names
                .iter()
                .any(|name| name == sibling || *name == one_below)
        };
        let mut rows = self.allowed.iter().filter(|(who, _)| *who == module);
        holds(self.shared) || rows.any(|(_, whom)| holds(whom) || whom.contains(&"*"))
    }
}

/// The rules of this house.
const HOUSE: Rules<'_> = Rules {
    shared: &SHARED,
    allowed: &ALLOWED,
};

#[test]
fn siblings_do_not_import_each_other() {
    let sources = files("src/core", "rs");
    assert!(
        sources.len() > 20,
        "the walk found only {} files",
        sources.len()
    );
    expect_none(&faults(&sources, &HOUSE));
}

/// The faults of one line in a file of the core, with rules that share `image` and
/// `pipeline::error`, and let `colmap` import `event::stage`.
fn faults_of(path: &str, line: &str) -> Vec<String> {
    let rules = Rules {
        shared: &["image", "pipeline::error"],
        allowed: &[("colmap", &["event::stage"]), ("pipeline", &["*"])],
    };
    faults(
        &[Source::made_up(&format!("src/core/{path}"), line)],
        &rules,
    )
}

#[test]
fn an_import_of_a_sibling_is_found() {
    let two = "use crate::image::Image;\nuse crate::enhance::curve;\n";
    assert_eq!(
        faults_of("deblur/onnx.rs", two),
        ["src/core/deblur/onnx.rs:2: deblur imports its sibling enhance"]
    );
    for line in [
        "use crate::{image::Image, enhance::curve};\n",
        "use super::super::enhance;\n",
        "fn f() { crate::enhance::curve::fit() }\n",
        "mod inner { use super::super::super::enhance; }\n",
    ] {
        assert_eq!(faults_of("deblur/onnx.rs", line).len(), 1, "{line}");
    }
    expect_none(&faults_of("pipeline.rs", "use crate::enhance::curve;\n"));
    expect_none(&faults_of("deblur/onnx.rs", "use super::manifest::Role;\n"));
    let in_test = "#[cfg(test)]\nmod tests { use crate::enhance::curve; }\n";
    expect_none(&faults_of("deblur/onnx.rs", in_test));
}

#[test]
fn a_module_below_another_has_rights_of_its_own() {
    let kind = "use crate::pipeline::error::ErrorKind;\n";
    expect_none(&faults_of("image/load.rs", kind));
    assert_eq!(
        faults_of("image/load.rs", "use crate::pipeline::run;\n").len(),
        1
    );
    let stage = "use crate::event::stage::Stage;\n";
    expect_none(&faults_of("colmap/ladder.rs", stage));
    assert_eq!(
        faults_of("capture.rs", stage),
        ["src/core/capture.rs:1: capture imports its sibling event"]
    );
}
