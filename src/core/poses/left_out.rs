//! What files give and cannot be used, by name.

use std::fmt::Write as _;

/// Most names that are listed for a reason.
const MOST: usize = 40;

/// A view, frame or row that is left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// What the file calls it.
    pub name: String,
    /// What is wrong with it, and where.
    pub reason: String,
}

impl LeftOut {
    /// From its name and what is wrong with it.
    pub fn new(name: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { name: name.into(), reason: reason.into() }
    }
}

/// For a sentence: each reason once, after the names it holds for.
pub fn in_words(left_out: &[LeftOut]) -> String {
    let mut groups: Vec<(&str, Vec<&str>)> = Vec::new();
    for LeftOut { name, reason } in left_out {
        match groups.iter_mut().find(|(known, _)| known == reason) {
            Some((_, names)) => names.push(name),
            None => groups.push((reason, vec![name])),
        }
    }
    let mut words = String::new();
    for (reason, names) in groups {
        let separator = if words.is_empty() { "" } else { "; " };
        let listed = names[..names.len().min(MOST)].join(", ");
        let _ = match names.len().saturating_sub(MOST) {
            0 => write!(words, "{separator}{listed}: {reason}"),
            more => write!(words, "{separator}{listed} and {more} more: {reason}"),
        };
    }
    words
}
