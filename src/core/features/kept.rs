//! Matches of pairs, kept in a file as they come: an interrupted search continues with them.
//!
//! A pair is known by its key points, so matches never serve other photographs, whatever their
//! names and order. Key points are not kept: they are found again in a small part of the time of
//! matching them.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Write as _};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::key_points::KeyPoints;
use crate::poses::PosesError;
use crate::poses::matching::Keeping;

/// Bytes of a key, and of the head of a file.
const HASH: usize = blake3::OUT_LEN;
/// Bytes of a record's checksum.
const CHECK: usize = 8;
/// The number of matches of a pair that the matcher did not process.
const SKIPPED: u32 = u32::MAX;

/// The matches of a pair, as indices of key points; `None` if the matcher did not process it.
pub(super) type Matches = Option<Vec<[u32; 2]>>;

/// Identifies a pair by its key points.
pub(super) type Key = [u8; HASH];

/// The matches so far, in memory and in the file, if there is one.
pub(super) struct KeptMatches {
    known: Mutex<HashMap<Key, Matches>>,
    file: Option<(PathBuf, File)>,
    /// Those in the files of other searches.
    lent: HashMap<Key, Matches>,
}

impl KeptMatches {
    /// The matches in the file of an interrupted search by the matcher that `describe` describes.
    /// A record that was being written when it ended is left out. Files of other searches that
    /// cannot be read have been removed from the cache.
    ///
    /// # Errors
    /// [`PosesError::File`].
    pub fn open(keeping: Option<Keeping<'_>>, describe: &str) -> Result<Self, PosesError> {
        let Some(Keeping { file: path, stamp, earlier }) = keeping else {
            return Ok(Self { known: Mutex::default(), file: None, lent: HashMap::new() });
        };
        let mut head = blake3::Hasher::new();
        head.update(blake3::hash(stamp.as_bytes()).as_bytes()).update(describe.as_bytes());
        let head = head.finalize();
        let io = |error| PosesError::io(path)(error);
        let bytes = match std::fs::read(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
            bytes => bytes.map_err(io)?,
        };
        let mut known = HashMap::new();
        let valid = records(&bytes, head.as_bytes(), &mut known);
        let mut lent = HashMap::new();
        for bytes in earlier.iter().filter_map(|path| std::fs::read(path).ok()) {
            records(&bytes, head.as_bytes(), &mut lent);
        }
        let mut file = OpenOptions::new().create(true).append(true).open(path).map_err(io)?;
        file.set_len(valid as u64).map_err(io)?;
        if valid == 0 {
            file.write_all(head.as_bytes()).map_err(io)?;
        }
        Ok(Self { known: Mutex::new(known), file: Some((path.to_owned(), file)), lent })
    }

    /// Takes over the matches of a pair that another search has kept, and keeps them.
    ///
    /// # Errors
    /// [`PosesError::Io`].
    pub fn take_over(&self, key: &Key) -> Result<(), PosesError> {
        match self.lent.get(key) {
            Some(matches) if !self.has(key) => self.keep(*key, matches.clone()),
            _ => Ok(()),
        }
    }

    /// Whether the matches of a pair are known.
    pub fn has(&self, key: &Key) -> bool {
        self.lock().contains_key(key)
    }

    /// The known matches of a pair.
    pub fn get(&self, key: &Key) -> Matches {
        self.lock().get(key).cloned().flatten()
    }

    /// Keeps the matches of a pair.
    ///
    /// # Errors
    /// [`PosesError::File`].
    pub fn keep(&self, key: Key, matches: Matches) -> Result<(), PosesError> {
        let mut known = self.lock();
        if let Some((path, file)) = &self.file {
            // In one piece, so that the end of the process leaves at most one incomplete record.
            let mut file = file;
            file.write_all(&bytes(&key, &matches)).map_err(PosesError::io(path))?;
        }
        known.insert(key, matches);
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Key, Matches>> {
        // What a thread that panicked has inserted is complete.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Identifies the key points of a photograph.
pub(super) fn print(points: &KeyPoints) -> Key {
    let mut hasher = blake3::Hasher::new();
    for side in [points.width, points.height, points.len()] {
        hasher.update(&(side as u64).to_le_bytes());
    }
    let positions = points.positions.as_flattened();
    for values in [positions, &points.scores, &points.descriptors] {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        hasher.update(&bytes);
    }
    hasher.finalize().into()
}

/// Identifies a pair by the prints of its photographs and the least number of mutual nearest
/// neighbours.
pub(super) fn key(first: &Key, second: &Key, neighbours: usize) -> Key {
    let mut hasher = blake3::Hasher::new();
    hasher.update(first).update(second).update(&(neighbours as u64).to_le_bytes());
    hasher.finalize().into()
}

fn bytes(key: &Key, matches: &Matches) -> Vec<u8> {
    let count = matches.as_ref().map_or(SKIPPED, |matches| matches.len() as u32);
    let mut bytes = key.to_vec();
    bytes.extend(count.to_le_bytes());
    let indices = matches.iter().flatten().flatten();
    bytes.extend(indices.flat_map(|index| index.to_le_bytes()));
    let check = blake3::hash(&bytes);
    bytes.extend(&check.as_bytes()[..CHECK]);
    bytes
}

/// Reads the records of a file that has this head up to the first incomplete one, and returns the
/// bytes that they and the head take; 0 if the head is another.
fn records(bytes: &[u8], head: &[u8], into: &mut HashMap<Key, Matches>) -> usize {
    let Some(mut rest) = bytes.strip_prefix(head) else {
        return 0;
    };
    while let Some((key, matches, after)) = record(rest) {
        into.insert(key, matches);
        rest = after;
    }
    bytes.len() - rest.len()
}

/// The first record of `bytes`, and the bytes after it; `None` if it is incomplete.
fn record(bytes: &[u8]) -> Option<(Key, Matches, &[u8])> {
    let (key, rest) = bytes.split_first_chunk::<HASH>()?;
    let (count, rest) = rest.split_first_chunk::<4>()?;
    let count = u32::from_le_bytes(*count);
    let length = if count == SKIPPED { 0 } else { 8 * count as usize };
    let (indices, rest) = rest.split_at_checked(length)?;
    let (check, rest) = rest.split_first_chunk::<CHECK>()?;
    let whole = &bytes[..HASH + 4 + length];
    if blake3::hash(whole).as_bytes()[..CHECK] != *check {
        return None;
    }
    let (indices, _) = indices.as_chunks::<4>();
    let (pairs, _) = indices.as_chunks::<2>();
    let matches = pairs.iter().map(|pair| pair.map(u32::from_le_bytes)).collect();
    Some((*key, (count != SKIPPED).then_some(matches), rest))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn open(file: &Path, stamp: &str, describe: &str) -> KeptMatches {
        KeptMatches::open(Some(Keeping { file, stamp, earlier: &[] }), describe).expect("opened")
    }

    const KEYS: [Key; 3] = [[1; HASH], [2; HASH], [3; HASH]];

    /// A file with three pairs, one of them not processed, and its length after each.
    fn filled(file: &Path) -> Vec<u64> {
        let kept = open(file, "build", "networks");
        let matches = [Some(vec![[1, 2], [3, 4]]), None, Some(Vec::new())];
        let keep = |(key, matches)| {
            kept.keep(key, matches).expect("written");
            std::fs::metadata(file).expect("there").len()
        };
        KEYS.into_iter().zip(matches).map(keep).collect()
    }

    fn known(kept: &KeptMatches) -> [bool; 3] {
        KEYS.map(|key| kept.has(&key))
    }

    #[test]
    fn what_was_kept_is_found_again_by_the_same_build_and_networks_only() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let file = folder.path().join("matches");
        for (stamp, describe, expected) in
            [("build", "networks", true), ("other", "networks", false), ("build", "other", false)]
        {
            filled(&file);
            let kept = open(&file, stamp, describe);
            assert_eq!(known(&kept), [expected; 3], "{stamp}, {describe}");
            let first = expected.then(|| vec![[1, 2], [3, 4]]);
            assert_eq!(kept.get(&KEYS[0]), first);
            assert_eq!(kept.get(&KEYS[1]), None);
            std::fs::remove_file(&file).expect("removed");
        }
    }

    #[test]
    fn matches_of_another_search_are_taken_over_by_the_same_build_only() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let [other, file] = ["other", "own"].map(|name| folder.path().join(name));
        filled(&other);
        let earlier = [folder.path().join("gone"), other.clone()];
        let before = std::fs::read(&other).expect("there");
        for (stamp, is_known) in [("other", false), ("build", true)] {
            let keeping = Keeping { file: &file, stamp, earlier: &earlier };
            let kept = KeptMatches::open(Some(keeping), "networks").expect("opened");
            assert_eq!(known(&kept), [false; 3], "only pairs that are asked for");
            kept.take_over(&KEYS[0]).expect("written");
            assert_eq!(known(&kept), [is_known, false, false], "{stamp}");
        }
        assert_eq!(known(&open(&file, "build", "networks")), [true, false, false], "and kept");
        assert!(std::fs::read(&other).expect("there") == before);
    }

    #[test]
    fn an_incomplete_or_damaged_record_is_matched_again_and_those_before_it_are_not() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let file = folder.path().join("matches");
        let [_, before, end] = filled(&file)[..] else { panic!("three pairs") };
        let whole = std::fs::read(&file).expect("read");
        for cut in before..end {
            std::fs::write(&file, &whole[..cut as usize]).expect("written");
            assert_eq!(known(&open(&file, "build", "networks")), [true, true, false], "{cut}");
        }
        let kept = open(&file, "build", "networks");
        kept.keep(KEYS[2], Some(Vec::new())).expect("written");
        assert!(std::fs::read(&file).expect("read") == whole, "nothing is left of the half");
        let mut damaged = whole.clone();
        damaged[before as usize - 1] ^= 1;
        std::fs::write(&file, damaged).expect("written");
        assert_eq!(known(&open(&file, "build", "networks")), [true, false, false]);
    }

    #[test]
    fn a_pair_is_another_one_if_any_of_its_key_points_changes() {
        let points = KeyPoints {
            width: 64,
            height: 48,
            positions: vec![[1.5, 2.5]],
            scores: vec![0.5],
            descriptors: vec![0.125; 64],
        };
        let changes: [fn(&mut KeyPoints); 4] = [
            |points| points.width = 65,
            |points| points.positions[0][1] = 3.5,
            |points| points.scores[0] = 0.25,
            |points| points.descriptors[63] = 0.0,
        ];
        let own = print(&points);
        assert_eq!(own, print(&points.clone()));
        for change in changes {
            let mut changed = points.clone();
            change(&mut changed);
            assert_ne!(own, print(&changed), "{changed:?}");
        }
        let other = [7; HASH];
        assert_ne!(key(&own, &other, 12), key(&other, &own, 12));
        assert_ne!(key(&own, &other, 12), key(&own, &other, 13));
    }
}
