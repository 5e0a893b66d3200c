//! Key points and matches supplied to COLMAP from outside.

use std::path::{Path, PathBuf};

use super::PosesError;
use crate::cancel::CancelToken;

/// The pairs of pictures to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pairs {
    /// Pairs of one set that may overlap.
    Within,
    /// Each of the first this many with each of the others.
    Across(usize),
}

/// Where matches are kept as they come, so that an interrupted search continues with them.
#[derive(Clone, Copy, Debug)]
pub struct Keeping<'a> {
    /// The file.
    pub file: &'a Path,
    /// Identifies the build: matches of another one are not used.
    pub stamp: &'a str,
    /// Files of other searches, which are only read.
    pub earlier: &'a [PathBuf],
}

/// Finds key points and their matches in photographs.
pub trait Matching: Send + Sync {
    /// The key points of each picture (sRGB files, at the brightness of COLMAP's copies) and the
    /// matches of `pairs`; those that were kept are not computed again. `advance` is called with
    /// the number of pictures and pairs done and the total.
    ///
    /// # Errors
    /// [`PosesError::Matching`] if the networks fail, [`PosesError::File`] if a picture cannot be
    /// read or matches cannot be kept, [`PosesError::Cancelled`].
    fn matches(
        &self,
        pictures: &[PathBuf],
        pairs: Pairs,
        keeping: Option<Keeping<'_>>,
        advance: &mut dyn FnMut(u64, u64),
        cancel: &CancelToken,
    ) -> Result<Correspondences, PosesError>;

    /// A description that changes if the results may change.
    fn describe(&self) -> String;
}

/// Key points and matches of a capture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Correspondences {
    /// By picture: x and y in px; the centre of the first pixel is (0.5, 0.5).
    pub key_points: Vec<Vec<[f32; 2]>>,
    /// The pairs that have matches.
    pub pairs: Vec<PairMatches>,
    /// Number of pairs that an earlier search had compared.
    pub kept: usize,
}

impl Correspondences {
    /// Removes the matches of unwanted key points, given by picture and x and y in px.
    pub fn retain(&mut self, is_wanted: impl Fn(usize, [f32; 2]) -> bool) {
        let wanted: Vec<Vec<bool>> = { self.key_points.iter().enumerate() }
            .map(|(picture, points)| points.iter().map(|p| is_wanted(picture, *p)).collect())
            .collect();
        for pair in &mut self.pairs {
            let [first, second] = [&wanted[pair.first], &wanted[pair.second]];
            pair.matches.retain(|[one, other]| first[*one as usize] && second[*other as usize]);
        }
        self.pairs.retain(|pair| !pair.matches.is_empty());
    }
}

/// The matches of two pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct PairMatches {
    /// Index of the first picture.
    pub first: usize,
    /// Index of the second, above that of the first.
    pub second: usize,
    /// Indices of key points, in the first and in the second picture.
    pub matches: Vec<[u32; 2]>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_of_unwanted_points_are_left_out() {
        let pair = |first, second| PairMatches { first, second, matches: vec![[0, 1], [1, 0]] };
        let points = |picture: usize| vec![[picture as f32, 0.0], [picture as f32, 9.0]];
        let mut found = Correspondences {
            key_points: (0..3).map(points).collect(),
            pairs: vec![pair(0, 1), pair(0, 2), pair(1, 2)],
            kept: 0,
        };
        found.retain(|picture, [_, y]| picture != 2 && (picture != 1 || y > 5.0));
        let left = PairMatches { first: 0, second: 1, matches: vec![[0, 1]] };
        assert_eq!(found.pairs, [left]);
    }
}
