//! Which photograph is which: by its path, as its owner wrote it, whatever its file is called where
//! it is stored. Poses and ground truth find their photograph by it.

mod lookup;

use std::fmt;

use serde::{Deserialize, Serialize};
use unicode_normalization::UnicodeNormalization;

pub use lookup::{Tie, find_each};

/// A relative path with `/` between its parts, in Unicode's NFC: macOS writes `é` as two
/// characters, other systems as one.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PhotoPath(String);

impl PhotoPath {
    /// From a path as somebody wrote it: Windows parts it by `\`, `./` says nothing, and `..` takes
    /// back the part before it.
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

    /// The folders, without a slash at the end; empty where there are none.
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

    /// What stands below this folder, if it does.
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

    /// Whether one of its folders has one of these names, in whatever case.
    pub fn lies_in(&self, names: &[&str]) -> bool {
        let mut folders = self.folder().split('/');
        folders.any(|part| names.iter().any(|name| part.eq_ignore_ascii_case(name)))
    }
}

/// The letters of IBM's code page 437 from 128 on.
const CODE_PAGE: &str = "ÇüéâäàåçêëèïîìÄÅÉæÆôöòûùÿÖÜ¢£¥₧ƒáíóúñÑªº¿⌐¬½¼¡«»\
                         ░▒▓│┤╡╢╖╕╣║╗╝╜╛┐└┴┬├─┼╞╟╚╔╩╦╠═╬╧╨╤╥╙╘╒╓╫╪┘┌█▄▌▐▀\
                         αßΓπΣσµτΦΘΩδ∞φε∩≡±≥≤⌠⌡÷≈°∙·√ⁿ²■\u{a0}";

/// A name in bytes of any encoding: UTF-8, or else read as code page 437, as zips have it. It is
/// only shown and compared: equal names stay equal. Where a letter has two bytes, the second one
/// may be that of a backslash.
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
