//! The text files of the repository.

use std::fs;
use std::path::{Path, PathBuf};

/// A text file.
pub struct Source {
    /// Path relative to the repository root, with `/`.
    pub path: String,
    /// Its content.
    pub text: String,
}

impl Source {
    /// A fictitious file for a test.
    pub fn made_up(path: &str, text: &str) -> Self {
        Self { path: path.to_owned(), text: text.to_owned() }
    }

    /// Number, from 1, and text of every line before the unit tests that is not a comment.
    pub fn code(&self) -> impl Iterator<Item = (usize, &str)> {
        let lines = (1..).zip(self.text.lines());
        lines
            .take_while(|(_, line)| line.trim_end() != "#[cfg(test)]")
            .filter(|(_, line)| !line.trim_start().starts_with("//"))
    }
}

/// Every file below `folder` with a name that ends in `extension`, sorted by path. An empty folder
/// is the repository root. Excludes hidden files and those that git ignores.
pub fn files(folder: &str, extension: &str) -> Vec<Source> {
    let top = top();
    let ignored = ignored(&top);
    let mut found = Vec::new();
    collect(&top.join(folder), extension, &ignored, &mut found);
    found.sort();
    let read = |path: PathBuf| Source {
        path: path
            .strip_prefix(&top)
            .expect("below the top")
            .display()
            .to_string()
            .replace('\\', "/"),
        text: fs::read_to_string(&path)
            .unwrap_or_else(|error| panic!("{}: {error}", path.display())),
    };
    found.into_iter().map(read).collect()
}

/// The root of the repository.
pub fn top() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .expect("tests/tidy is two down")
        .to_path_buf()
}

/// Panics with one line per fault.
pub fn expect_none(faults: &[String]) {
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
}

/// The entries of the root's `.gitignore` that are whole paths.
fn ignored(top: &Path) -> Vec<PathBuf> {
    let text = fs::read_to_string(top.join(".gitignore")).expect("a .gitignore at the top");
    let paths = text.lines().filter_map(|line| line.strip_prefix('/'));
    paths.map(|path| top.join(path)).collect()
}

fn collect(folder: &Path, extension: &str, ignored: &[PathBuf], found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries {
        let entry = entry.expect("a directory entry");
        let (path, name) = (entry.path(), entry.file_name());
        let hidden = name.as_encoded_bytes().starts_with(b".");
        if hidden || ignored.contains(&path) || path.ends_with("node_modules") {
            continue;
        }
        if path.is_dir() {
            collect(&path, extension, ignored, found);
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
}

#[test]
fn sources_are_found_and_code_excludes_comments_and_tests() {
    assert!(files("tests/tidy", "rs").iter().any(|file| file.path == "tests/tidy/sources.rs"));
    let file = Source::made_up("a.rs", "use a;\n// use b;\n#[cfg(test)]\nuse c;\n");
    assert_eq!(file.code().collect::<Vec<_>>(), [(1, "use a;")]);
}

#[test]
#[should_panic(expected = "1 faults")]
fn a_fault_fails_the_test() {
    expect_none(&["something".to_owned()]);
}
