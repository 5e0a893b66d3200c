//! Unusable items in files, by name.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

/// Maximum number of names listed for a reason.
const MOST: usize = 40;

/// A view, frame or row that is left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Its name in the file.
    pub name: String,
    /// The fault and its location.
    pub reason: String,
}

impl LeftOut {
    /// Creates it from a name and a reason.
    pub fn new(name: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { name: name.into(), reason: reason.into() }
    }
}

/// For a message: each reason once, after the names that it applies to.
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
