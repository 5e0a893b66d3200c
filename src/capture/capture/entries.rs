//! The files of a capture, under the paths that the user knows.

use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::image::named_like_a_photograph;
use crate::photo_path::{PhotoPath, decoded};

use super::error::{CaptureError, MAX_FILES};

/// Maximum depth of folders: more than any capture has, and a stop for links that form a loop.
const MAX_DEPTH: usize = 12;

/// One file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// The path inside the capture as its owner wrote it; only displayed and compared.
    pub(super) path: PhotoPath,
    /// Where it is stored.
    pub(super) file: PathBuf,
    /// Its number among files with the same path, from 1: phone browsers name every file
    /// `image.jpg`.
    pub(super) number: usize,
    /// Its size in bytes, if it is a zipped photograph over the size limit, which is not unpacked.
    pub(super) too_large: Option<u64>,
}

impl Entry {
    pub(super) fn new(path: PhotoPath, file: PathBuf) -> Self {
        Self { path, file, number: 1, too_large: None }
    }

    /// Its name, unique in the capture.
    pub(super) fn name(&self) -> PhotoPath {
        match self.number {
            1 => self.path.clone(),
            number => numbered(&self.path, number),
        }
    }
}

/// `a/image-2.jpg` for `a/image.jpg`.
fn numbered(path: &PhotoPath, number: usize) -> PhotoPath {
    let stem = path.stem();
    PhotoPath::new(&format!("{stem}-{number}{}", &path.as_str()[stem.len()..]))
}

/// Numbers the files with equal paths, in the order of their stored names.
fn number(entries: &mut [Entry]) {
    let stored = |entry: &Entry| (entry.file.as_os_str().len(), entry.file.clone());
    entries.sort_by(|a, b| a.path.cmp(&b.path).then_with(|| stored(a).cmp(&stored(b))));
    let mut taken: HashSet<PhotoPath> = entries.iter().map(|entry| entry.path.clone()).collect();
    for at in 1..entries.len() {
        let (before, rest) = entries.split_at_mut(at);
        let (last, entry) = (&before[at - 1], &mut rest[0]);
        if last.path == entry.path {
            let mut numbers = last.number + 1..;
            let is_free = |number: &usize| taken.insert(numbered(&entry.path, *number));
            entry.number = numbers.find(is_free).expect("numbers do not end");
        }
    }
}

/// A file that maps stored paths to the owner's names for the files of a folder, where the stored
/// names differ: a JSON object.
pub const NAMES: &str = ".names.json";

/// The files of a folder, except hidden ones.
pub(super) fn of_folder(root: &Path) -> Result<Vec<Entry>, CaptureError> {
    let mut entries = Vec::new();
    walk(root, "", 0, &mut entries)?;
    let names: HashMap<String, PhotoPath> = match fs::read(root.join(NAMES)) {
        Ok(bytes) => serde_json::from_slice(&bytes)
            .map_err(|error| CaptureError::io(&root.join(NAMES))(error.into()))?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => HashMap::new(),
        Err(error) => return Err(CaptureError::io(&root.join(NAMES))(error)),
    };
    let entry = |(place, file): (String, PathBuf)| {
        let path = { names.get(&place) }.map_or_else(|| PhotoPath::new(&place), Clone::clone);
        Entry::new(path, file)
    };
    let is_seen = |entry: &Entry| !entry.path.as_str().split('/').any(is_hidden);
    let mut entries: Vec<Entry> = entries.into_iter().map(entry).filter(is_seen).collect();
    number(&mut entries);
    Ok(entries)
}

fn walk(
    folder: &Path,
    prefix: &str,
    depth: usize,
    found: &mut Vec<(String, PathBuf)>,
) -> Result<(), CaptureError> {
    for item in fs::read_dir(folder).map_err(CaptureError::io(folder))? {
        let item = item.map_err(CaptureError::io(folder))?;
        let name = decoded(item.file_name().as_encoded_bytes());
        if is_hidden(&name) {
            continue;
        }
        let (path, file) = (format!("{prefix}{name}"), item.path());
        // Links are followed: the folder is the operator's own. A dangling link to a photograph is
        // an unreadable photograph.
        let Ok(metadata) = file.metadata() else {
            if named_like_a_photograph(Path::new(&name)) {
                found.push((path, file));
            }
            continue;
        };
        if metadata.is_dir() && depth < MAX_DEPTH {
            walk(&file, &format!("{path}/"), depth + 1, found)?;
        } else if metadata.is_file() {
            found.push((path, file));
        }
        if found.len() > MAX_FILES {
            return Err(CaptureError::TooManyFiles);
        }
    }
    Ok(())
}

/// Files that systems leave behind: macOS's packer, Windows and Synology.
const TRACES: [&str; 5] = ["__macosx", "thumbs.db", "$recycle.bin", "@eadir", "#recycle"];

/// Whether a name is hidden or left by a system. A file that iCloud has not downloaded is neither.
pub(super) fn is_hidden(name: &str) -> bool {
    let lower = name.to_ascii_lowercase();
    let has_dot = name.starts_with('.') && name != ".";
    has_dot && !lower.ends_with(".icloud") || TRACES.contains(&&*lower)
}

/// Natural order of names: `img2` before `img10`, ignoring case. Total: names that compare equal
/// this way are ordered by their bytes.
pub(super) fn natural(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    while !left.is_empty() && !right.is_empty() {
        let (number_a, number_b) = (digits(left), digits(right));
        let order = if !number_a.is_empty() && !number_b.is_empty() {
            (left, right) = (&left[number_a.len()..], &right[number_b.len()..]);
            let (value_a, value_b) =
                (number_a.trim_start_matches('0'), number_b.trim_start_matches('0'));
            value_a.len().cmp(&value_b.len()).then_with(|| value_a.cmp(value_b))
        } else {
            let mut chars = (left.chars(), right.chars());
            let (x, y) = (chars.0.next(), chars.1.next());
            (left, right) = (chars.0.as_str(), chars.1.as_str());
            let fold = |c: Option<char>| c.map(|c| c.to_ascii_lowercase());
            fold(x).cmp(&fold(y))
        };
        if order.is_ne() {
            return order;
        }
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(b))
}

fn digits(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    &text[..end]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn numbers_are_ordered_by_value_and_letters_without_case() {
        let mut names = ["img10.jpg", "IMG2.jpg", "img1.jpg", "img02b.jpg", "a.jpg", "img.jpg"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["a.jpg", "img.jpg", "img1.jpg", "IMG2.jpg", "img02b.jpg", "img10.jpg"]);
    }

    proptest! {
        #[test]
        fn the_order_is_total(a in "[aA0-9.é]{0,8}", b in "[aA0-9.é]{0,8}", c in "[aA0-9.é]{0,8}") {
            prop_assert_eq!(natural(&a, &b), natural(&b, &a).reverse());
            prop_assert_eq!(natural(&a, &b).is_eq(), a == b);
            if natural(&a, &b).is_le() && natural(&b, &c).is_le() {
                prop_assert!(natural(&a, &c).is_le());
            }
        }
    }
}
