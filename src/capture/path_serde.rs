//! Paths in JSON: as text, or as numbers where they are not Unicode.

use std::ffi::{OsStr, OsString};
#[cfg(unix)]
use std::os::unix::ffi::{OsStrExt, OsStringExt};
#[cfg(windows)]
use std::os::windows::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The unit of the system's path encoding.
#[cfg(unix)]
type Unit = u8;
#[cfg(windows)]
type Unit = u16;

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Written {
    Text(String),
    Units(Vec<Unit>),
}

pub fn serialize<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    let written = match path.to_str() {
        Some(text) => Written::Text(text.to_owned()),
        None => Written::Units(units(path.as_os_str())),
    };
    written.serialize(serializer)
}

pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<PathBuf, D::Error> {
    Ok(match Written::deserialize(deserializer)? {
        Written::Text(text) => text.into(),
        Written::Units(units) => text(&units).into(),
    })
}

#[cfg(unix)]
fn units(text: &OsStr) -> Vec<Unit> {
    text.as_bytes().to_vec()
}

#[cfg(windows)]
fn units(text: &OsStr) -> Vec<Unit> {
    text.encode_wide().collect()
}

#[cfg(unix)]
fn text(units: &[Unit]) -> OsString {
    OsString::from_vec(units.to_vec())
}

#[cfg(windows)]
fn text(units: &[Unit]) -> OsString {
    OsString::from_wide(units)
}
