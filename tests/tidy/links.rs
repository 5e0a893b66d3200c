//! The links between documents.

use std::path::{Component, Path, PathBuf};

use crate::sources::{Source, expect_none, files, top};

/// Links of a document to files or sections that do not exist. `exists` tells whether there is a
/// file of the repository, `documents` are those with sections.
fn broken(source: &Source, documents: &[Source], exists: impl Fn(&Path) -> bool) -> Vec<String> {
    let folder = Path::new(&source.path).parent().expect("a file has a folder");
    let fault = |link: &str| {
        let (file, section) = link.split_once('#').unwrap_or((link, ""));
        let path = match file {
            "" => PathBuf::from(&source.path),
            file => simplified(&folder.join(file)),
        };
        let document = documents.iter().find(|document| Path::new(&document.path) == path);
        let has_section = document.is_some_and(|document| {
            document.text.lines().filter_map(heading).any(|heading| heading == section)
        });
        let is_found = exists(&path) && (section.is_empty() || has_section);
        (!is_found).then(|| format!("{}: `{link}` leads nowhere", source.path))
    };
    let links = source.text.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    links
        .map(|(link, _)| link)
        .filter(|link| !link.contains("://") && !link.contains(char::is_whitespace))
        .filter_map(fault)
        .collect()
}

/// A path without `..`.
fn simplified(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut path, part| {
        if part == Component::ParentDir {
            path.pop();
        } else {
            path.push(part);
        }
        path
    })
}

/// The address of a heading within its document.
fn heading(line: &str) -> Option<String> {
    let title = line.trim_start_matches('#').strip_prefix(' ').filter(|_| line.starts_with('#'))?;
    let kept = |letter: &char| letter.is_alphanumeric() || [' ', '-', '_'].contains(letter);
    Some(title.trim().to_lowercase().chars().filter(kept).collect::<String>().replace(' ', "-"))
}

#[test]
fn links_of_documents_lead_somewhere() {
    let documents = files("", "md");
    assert!(documents.len() > 20, "{} documents", documents.len());
    let top = top();
    let exists = |path: &Path| top.join(path).exists();
    let faults = documents.iter().flat_map(|source| broken(source, &documents, exists));
    expect_none(&faults.collect::<Vec<_>>());
}

#[test]
fn broken_links_are_found() {
    let documents = [
        Source::made_up("docs/a.md", "# A `b`, c\n[1](b.md) [2](../b.md#one) [3](#a-b-c)\n"),
        Source::made_up("b.md", "## One\n[1](https://x.org/y#z) [2](docs/a.md#two)\n"),
    ];
    let exists = |path: &Path| documents.iter().any(|source| Path::new(&source.path) == path);
    let faults = |source| broken(source, &documents, exists);
    assert_eq!(faults(&documents[0]), ["docs/a.md: `b.md` leads nowhere"]);
    assert_eq!(faults(&documents[1]), ["b.md: `docs/a.md#two` leads nowhere"]);
}
