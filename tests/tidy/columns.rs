//! The limit of line lengths.

use std::collections::BTreeSet;

use proc_macro2::{TokenStream, TokenTree};

use crate::sources::{Source, expect_none, files};

/// Most characters per line.
const COLUMNS: usize = 100;

/// Overlong lines of Rust. Lines with strings are exempt, because rustfmt does not break strings.
fn in_rust(source: &Source) -> Vec<String> {
    let tokens: TokenStream =
        source.text.parse().unwrap_or_else(|error| panic!("{}: {error}", source.path));
    let mut with_string = BTreeSet::new();
    lines_with_strings(tokens, &mut with_string);
    too_long(source, |number, line| {
        // The parser treats the doc comment of an item as a string.
        let comment = line.trim_start().starts_with("//");
        with_string.contains(&number) && !comment
    })
}

fn lines_with_strings(tokens: TokenStream, lines: &mut BTreeSet<usize>) {
    for token in tokens {
        match token {
            TokenTree::Group(group) => lines_with_strings(group.stream(), lines),
            TokenTree::Literal(literal) if literal.to_string().contains('"') => {
                lines.extend(literal.span().start().line..=literal.span().end().line);
            }
            _ => {}
        }
    }
}

/// Overlong lines of WGSL.
fn in_wgsl(source: &Source) -> Vec<String> {
    too_long(source, |_, _| false)
}

/// Overlong lines of Markdown, except in tables, code and HTML.
fn in_markdown(source: &Source) -> Vec<String> {
    let mut in_code = false;
    too_long(source, |_, line| {
        let line = line.trim_start();
        let fence = line.starts_with("```");
        in_code ^= fence;
        in_code || fence || line.starts_with(['|', '<'])
    })
}

/// Lines that are too long even without their addresses, and not exempt.
fn too_long(source: &Source, mut free: impl FnMut(usize, &str) -> bool) -> Vec<String> {
    let fault = |(number, line): (usize, &str)| {
        let columns = without_addresses(line).chars().count();
        let free = free(number, line);
        (columns > COLUMNS && !free)
            .then(|| format!("{}:{number}: {columns} columns, at most {COLUMNS}", source.path))
    };
    (1..).zip(source.text.lines()).filter_map(fault).collect()
}

/// A line without its unbreakable parts: the targets of links, and words with `://`.
fn without_addresses(line: &str) -> String {
    let mut parts = line.split("](");
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let behind = part.split_once(')').map_or("", |(_, behind)| behind);
        text += "]";
        text += behind;
    }
    let words = text.split(' ').filter(|word| !word.contains("://"));
    words.collect::<Vec<_>>().join(" ")
}

#[test]
fn lines_are_not_too_long() {
    let mut rust = files("src", "rs");
    rust.extend(files("tests", "rs"));
    let (wgsl, markdown) = (files("shaders", "wgsl"), files("", "md"));
    for (language, count) in [("Rust", rust.len()), ("WGSL", wgsl.len())] {
        assert!(count > 50, "only {count} files of {language} were found");
    }
    assert!(markdown.iter().any(|source| source.path == "README.md"));
    let rust = rust.iter().flat_map(in_rust);
    let wgsl = wgsl.iter().flat_map(in_wgsl);
    let faults = rust.chain(wgsl).chain(markdown.iter().flat_map(in_markdown));
    expect_none(&faults.collect::<Vec<_>>());
}

#[test]
fn a_long_line_is_detected() {
    let words = |count: usize| "word ".repeat(count);
    let rust = format!("/// {0}\nconst A: &str = \"{0}\";\n// {0}\n", words(20));
    assert_eq!(
        in_rust(&Source::made_up("src/a.rs", &rust)),
        ["src/a.rs:1: 104 columns, at most 100", "src/a.rs:3: 103 columns, at most 100"]
    );
    let wgsl = format!("let a = {}1;\n", "1 + ".repeat(23));
    assert_eq!(in_wgsl(&Source::made_up("shaders/a.wgsl", &wgsl)).len(), 1);
    let markdown = format!("{0}\n{1}\n# {0}\n", words(21), words(20));
    assert_eq!(
        in_markdown(&Source::made_up("README.md", &markdown)),
        ["README.md:1: 105 columns, at most 100", "README.md:3: 107 columns, at most 100"]
    );
}

#[test]
fn strings_tables_code_and_addresses_may_be_longer() {
    let long = "x".repeat(100);
    let rust = format!("// See https://{long}\nconst A: &str = r\"\n  {long}\n\";\n");
    expect_none(&in_rust(&Source::made_up("src/a.rs", &rust)));
    let markdown = format!(
        "| {long} |\n```\n{long}x\n```\n[a]({long}) https://{long}\n<img src=\"{long}\">\n"
    );
    expect_none(&in_markdown(&Source::made_up("README.md", &markdown)));
}
