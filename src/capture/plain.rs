//! The rule for names and other short texts that are displayed.

/// Whether a text is displayed as written: no control characters, which databases, logs and
/// terminals may interpret, no line separators, and none of Unicode's embeddings, overrides and
/// isolates, which reorder the text around them.
pub fn is_plain(text: &str) -> bool {
    let is_obeyed =
        |c: char| c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    !text.contains(is_obeyed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_texts_displayed_as_written_are_plain() {
        // Persian and many emoji need joiners.
        for plain in ["", "Küche 2", "תמונה", "می\u{200c}خواهم", "\u{1f468}\u{200d}\u{1f373}"]
        {
            assert!(is_plain(plain), "{plain:?}");
        }
        for other in [
            "a\0b",
            "a\tb",
            "a\n",
            "\u{1b}[2J",
            "\u{7f}",
            "\u{85}",
            "\u{2028}",
            "\u{202e}gpj",
            "\u{202a}",
            "\u{2066}",
            "\u{2069}",
        ] {
            assert!(!is_plain(other), "{other:?}");
        }
    }
}
