//! Redaction of messages to clients: only the server's log may contain its paths.

/// Shortens the absolute paths in a text to their last component.
pub fn without_paths(text: &str) -> String {
    let mut shortened = String::with_capacity(text.len());
    let mut rest = text;
    let mut before = ' ';
    while let Some(c) = rest.chars().next() {
        // A slash after a letter, a dot or a colon separates words, units or the host of a URL.
        let begins = c == '/' && (before.is_whitespace() || "\"'`([{<=,".contains(before));
        let end = rest.find(ends_a_path).unwrap_or(rest.len());
        let path = rest[..end].trim_end_matches([':', '.']);
        if begins && path.len() > 1 {
            shortened.push_str(path.trim_end_matches('/').rsplit('/').next().unwrap_or(path));
            rest = &rest[path.len()..];
            before = '/';
        } else {
            shortened.push(c);
            rest = &rest[c.len_utf8()..];
            before = c;
        }
    }
    shortened
}

fn ends_a_path(c: char) -> bool {
    c.is_whitespace() || "\"'`)]}>,;".contains(c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_absolute_paths_are_shortened_to_names() {
        for (text, shortened) in [
            ("/srv/fled/jobs/7/output/scene.ply: No such file", "scene.ply: No such file"),
            ("cannot read `/srv/a/b.json`.", "cannot read `b.json`."),
            ("colmap (/usr/bin/colmap) 3.9", "colmap (colmap) 3.9"),
            ("--out=/srv/x/ failed", "--out=x failed"),
            ("3 of 20 km/h and/or 1 / 2", "3 of 20 km/h and/or 1 / 2"),
            ("see https://example.org/a/b", "see https://example.org/a/b"),
            ("/srv/caf\u{e9}/\u{65e5}.png", "\u{65e5}.png"),
            ("", ""),
        ] {
            assert_eq!(without_paths(text), shortened);
        }
    }
}
