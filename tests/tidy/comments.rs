//! Comments must cite only documents of the repository.

use std::path::Path;

use crate::sources::{Source, expect_none, files, top};

/// The folders whose comments are checked, and their languages.
const READ: [(&str, &[&str]); 5] = [
    ("src", &["rs"]),
    ("shaders", &["wgsl"]),
    ("tests", &["rs", "py"]),
    ("tools", &["py", "sh"]),
    ("training", &["py"]),
];

/// Number, from 1, and text of every line with a comment. Python's docstrings are comments too.
fn comments(source: &Source) -> Vec<(usize, &str)> {
    let slashes = source.path.ends_with(".rs") || source.path.ends_with(".wgsl");
    let sign = if slashes { "//" } else { "#" };
    let (mut found, mut in_docstring) = (Vec::new(), false);
    for (number, line) in (1..).zip(source.text.lines()) {
        let quotes = line.matches("\"\"\"").count();
        if !slashes && (in_docstring || quotes > 0) {
            in_docstring ^= quotes % 2 == 1;
            found.push((number, line));
        } else if let Some(start) = start_of_comment(line, sign) {
            found.push((number, &line[start..]));
        }
    }
    found
}

/// Start of a comment, except at the `//` of an address.
fn start_of_comment(line: &str, sign: &str) -> Option<usize> {
    let mut starts = line.match_indices(sign).map(|(at, _)| at);
    starts.find(|at| !line[..*at].ends_with(':'))
}

/// The documents cited in a comment.
fn cited(comment: &str) -> impl Iterator<Item = &str> {
    let words = comment.split_whitespace().filter(|word| !word.contains("://"));
    let part = |c: char| c.is_ascii_alphanumeric() || "_-./*<>".contains(c);
    let paths = words.flat_map(move |word| word.split(move |c: char| !part(c)));
    let paths = paths.map(|path| path.trim_end_matches('.'));
    paths.filter(|path| {
        let pattern = path.contains(['*', '<', '>']);
        let document = path.ends_with(".md") && *path != ".md";
        !pattern && (document || path.starts_with("docs/"))
    })
}

/// Cited documents that exist neither at this path of the repository nor beside the file.
fn faults(source: &Source, exists: impl Fn(&Path) -> bool) -> Vec<String> {
    let folder = Path::new(&source.path).parent().unwrap_or(Path::new(""));
    let mut faults = Vec::new();
    for (number, comment) in comments(source) {
        let missing =
            cited(comment).filter(|path| !exists(Path::new(path)) && !exists(&folder.join(path)));
        faults.extend(missing.map(|path| {
            format!("{}:{number}: there is no {path} in this repository", source.path)
        }));
    }
    faults
}

#[test]
fn comments_cite_only_documents_of_the_repository() {
    let (top, mut faults_found, mut read) = (top(), Vec::new(), 0);
    for (folder, extensions) in READ {
        for source in extensions.iter().flat_map(|extension| files(folder, extension)) {
            // The tests of this file contain comments in strings.
            if source.path == "tests/tidy/comments.rs" {
                continue;
            }
            read += comments(&source).len();
            faults_found.extend(faults(&source, |path| top.join(path).exists()));
        }
    }
    assert!(read > 1000, "only {read} lines of comments were read");
    expect_none(&faults_found);
}

#[test]
fn a_missing_document_is_detected() {
    let exists = |path: &Path| path == Path::new("README.md") || path == Path::new("src/a/own.md");
    for (path, text) in [
        ("src/a/b.rs", "//! Differs from service.md: a path.\n"),
        ("src/a/b.rs", "let a = 1; // measured in docs/benchmarks.\n"),
        ("shaders/a.wgsl", "// method.md, 5.\n"),
        ("tools/a.py", "\"\"\"What plan.md\nasks for.\"\"\"\n"),
        ("tools/a.py", "\"\"\"First.\n\nSee plan.md.\"\"\"\n"),
        ("tools/a.sh", "true # (notes.md)\n"),
    ] {
        let source = Source::made_up(path, text);
        assert_eq!(faults(&source, exists).len(), 1, "{path}: {text}");
    }
    let good =
        "//! README.md, own.md, https://example.org/other.md, `*.md`\nlet a = \"other.md\";\n";
    expect_none(&faults(&Source::made_up("src/a/b.rs", good), exists));
    let python = "\"\"\"One line.\"\"\"\nopen(\"other.md\")\n";
    expect_none(&faults(&Source::made_up("tools/a.py", python), exists));
}
