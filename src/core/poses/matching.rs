//! Key points and matches that somebody else than COLMAP finds for it.

use std::path::PathBuf;

use super::PosesError;
use crate::cancel::CancelToken;

/// Which pairs of pictures are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pairs {
    /// Those of one set that may overlap.
    Within,
    /// Each of the first so many with each of the others.
    Across(usize),
}

/// Finds key points and their matches in photographs.
pub trait Matching: Send + Sync {
    /// The key points of each picture (sRGB files, as bright as COLMAP gets them) and the matches
    /// of `pairs`. `advance` is told how many parts of how many are done.
    ///
    /// # Errors
    /// [`PosesError::Matching`] when the networks fail, [`PosesError::BadFile`],
    /// [`PosesError::Cancelled`].
    fn matches(
        &self,
        pictures: &[PathBuf],
        pairs: Pairs,
        advance: &mut dyn FnMut(u64, u64),
        cancel: &CancelToken,
    ) -> Result<Correspondences, PosesError>;

    /// What finds them, in words that change when its answers may.
    fn describe(&self) -> String;
}

/// Key points and matches of a capture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Correspondences {
    /// By picture: x and y in px; the centre of the first pixel is (0.5, 0.5).
    pub key_points: Vec<Vec<[f32; 2]>>,
    /// The pairs that have matches.
    pub pairs: Vec<PairMatches>,
}

/// The matches of two pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct PairMatches {
    /// Index of the first picture.
    pub first: usize,
    /// Index of the second, above that of the first.
    pub second: usize,
    /// Indices of key points, in the first and in the second.
    pub matches: Vec<[u32; 2]>,
}
