//! Identifies a photograph by its path as its owner wrote it, whatever the name of the stored file.
//! Poses and ground truth are matched to photographs by it.

mod lookup;

use std::fmt;

use serde::{Deserialize, Serialize};
use unicode_normalization::UnicodeNormalization;

pub use lookup::{Tie, find_each};

/// A relative path with `/` between its parts, in Unicode NFC: macOS writes e-acute as two
/// characters, other systems as one.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PhotoPath(String);

impl PhotoPath {
    /// From a written path: Windows separates parts by `\`, `./` is ignored, and `..` removes the
    /// part before it.
    pub fn new(written: &str) -> Self {
        let written: String = written.nfc().collect();
        let mut parts: Vec<&str> = Vec::new();
        for part in written.split(['/', '\\']) {
            match part {
                "" | "." => {}
                ".." => drop(parts.pop()),
                part => parts.push(part),
            }
        }
        Self(parts.join("/"))
    }

    /// The whole path.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The folders, without a trailing slash; empty if there are none.
    pub fn folder(&self) -> &str {
        self.0.rsplit_once('/').map_or("", |(folder, _)| folder)
    }

    /// The last part.
    pub fn name(&self) -> &str {
        self.0.rsplit_once('/').map_or(&self.0, |(_, name)| name)
    }

    /// The path without its extension.
    pub fn stem(&self) -> &str {
        let dot = self.name().rfind('.').unwrap_or(self.name().len());
        &self.0[..self.0.len() - self.name().len() + dot]
    }

    /// The path below this folder, if it is inside it.
    #[must_use]
    pub fn below(&self, folder: &str) -> Option<Self> {
        let rest = self.0.strip_prefix(folder)?;
        match folder {
            "" => Some(self.clone()),
            _ => rest.strip_prefix('/').map(|rest| Self(rest.to_owned())),
        }
    }

    /// This path in a folder.
    #[must_use]
    pub fn inside(&self, folder: &str) -> Self {
        Self::new(&format!("{folder}/{}", self.0))
    }

    /// Whether one of its folders has one of these names, ignoring case.
    pub fn lies_in(&self, names: &[&str]) -> bool {
        let mut folders = self.folder().split('/');
        folders.any(|part| names.iter().any(|name| part.eq_ignore_ascii_case(name)))
    }
}

/// The characters of IBM's code page 437 from 128 on.
const CODE_PAGE: &str = "ÇüéâäàåçêëèïîìÄÅÉæÆôöòûùÿÖÜ¢£¥₧ƒáíóúñÑªº¿⌐¬½¼¡«»\
                         ░▒▓│┤╡╢╖╕╣║╗╝╜╛┐└┴┬├─┼╞╟╚╔╩╦╠═╬╧╨╤╥╙╘╒╓╫╪┘┌█▄▌▐▀\
                         αßΓπΣσµτΦΘΩδ∞φε∩≡±≥≤⌠⌡÷≈°∙·√ⁿ²■\u{a0}";

/// Decodes a name in any encoding: UTF-8, or else code page 437, as in zips. It is only displayed
/// and compared: equal names stay equal. In a two-byte character, the second byte may be that of a
/// backslash.
pub fn decoded(name: &[u8]) -> String {
    if let Ok(name) = str::from_utf8(name) {
        return name.to_owned();
    }
    let letters: Vec<char> = CODE_PAGE.chars().collect();
    let mut is_second = false;
    let letter = |&byte: &u8| {
        let was_second = std::mem::replace(&mut is_second, byte >= 128);
        match byte {
            128.. => letters[usize::from(byte) - 128],
            b'\\' if was_second => '\u{a5}',
            byte => char::from(byte),
        }
    };
    name.iter().map(letter).collect()
}

impl fmt::Display for PhotoPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests;
