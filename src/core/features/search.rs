//! Key points and matches of a whole capture.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};

use super::extractor::Extractor;
use super::kept::{self, KeptMatches, Matches};
use super::key_points::KeyPoints;
use super::matcher::Matcher;
use super::weights::{Package, WeightsError};
use super::{nearest, pairs, self_test};
use crate::cancel::CancelToken;
use crate::image::Image;
use crate::inference::{self, Graph, Network, Provider, Runtime, RuntimeError};
use crate::poses::matching::{Correspondences, Keeping, Matching, PairMatches, Pairs};
use crate::poses::{PosesError, name_of};

const XFEAT: &[u8] = include_bytes!("../../../models/xfeat.onnx");
const LIGHTERGLUE: &[u8] = include_bytes!("../../../models/lighterglue.onnx");

/// Most threads: each thread's networks take some 100 MiB at 2,048 key points.
const MOST_THREADS: usize = 8;

/// The number of key points per photograph, and the pairs worth the matcher's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SearchOptions {
    /// Most key points of a photograph, if there are few pairs. More give more accurate poses: of
    /// 15 photographs of a courtyard, shaken by 4.4 px, 13 are good with 1,024 and 15 with 2,048.
    pub key_points: usize,
    /// Number of pairs up to which photographs have that many; with more pairs each has fewer,
    /// because the matcher's time grows with their square.
    pub pairs: usize,
    /// Least number of mutual nearest neighbours of a pair that the matcher processes.
    pub neighbours: usize,
    /// Number of threads, each with its own networks.
    pub threads: usize,
}

impl SearchOptions {
    /// Most key points of each photograph for this number of pairs; at least half of the maximum.
    pub fn key_points_of(&self, pairs: usize) -> usize {
        let share = (self.pairs as f64 / pairs.max(self.pairs) as f64).sqrt().max(0.5);
        (self.key_points as f64 * share) as usize
    }
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self {
            key_points: 2048,
            pairs: 120,
            neighbours: 12,
            threads: std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS),
        }
    }
}

/// The reason why the networks cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FeatureError {
    /// The weights are missing or invalid.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// ONNX Runtime is missing.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// ONNX Runtime rejects a graph, or it fails the self-test.
    #[error("network {id} cannot be used: {detail}")]
    Unusable {
        /// The network.
        id: &'static str,
        /// The reason.
        detail: String,
    },
}

/// XFeat and LighterGlue as a [`Matching`].
pub struct LearnedMatching {
    runtime: Runtime,
    package: Package,
    weights: [Arc<[u8]>; 2],
    options: SearchOptions,
}

impl LearnedMatching {
    /// Checks the weights in the first of `folders` that has them, and both graphs in ONNX Runtime
    /// by the self-test.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn open(
        runtime: &Runtime,
        folders: &[PathBuf],
        options: SearchOptions,
    ) -> Result<Self, FeatureError> {
        let package = Package::embedded();
        let [xfeat, lighterglue] = &package.weights;
        let weights = [xfeat.load(folders)?, lighterglue.load(folders)?];
        let matching = Self { runtime: runtime.clone(), weights, options, package };
        let (mut extractor, mut matcher) = (matching.extractor()?, matching.matcher()?);
        self_test::run(&mut extractor, &mut matcher)
            .map_err(|detail| FeatureError::Unusable { id: "xfeat-lighterglue", detail })?;
        Ok(matching)
    }

    /// A copy with the matcher's weights in another order, as if the library were faulty.
    #[cfg(test)]
    pub(super) fn with_weights_shuffled(&self) -> Self {
        let mut matcher = self.weights[1].to_vec();
        // Skips the file's header and tables: only the middle, in numbers of four bytes.
        let quarter = matcher.len() / 16 * 4;
        matcher[quarter..3 * quarter].chunks_exact_mut(8).for_each(|two| two.rotate_left(4));
        Self {
            runtime: self.runtime.clone(),
            package: self.package.clone(),
            weights: [self.weights[0].clone(), matcher.into()],
            options: self.options,
        }
    }

    /// A new session of XFeat.
    ///
    /// # Errors
    /// [`FeatureError::Unusable`].
    pub fn extractor(&self) -> Result<Extractor, FeatureError> {
        self.session("xfeat", XFEAT, 0).map(Extractor::new)
    }

    /// A new session of LighterGlue.
    ///
    /// # Errors
    /// [`FeatureError::Unusable`].
    pub fn matcher(&self) -> Result<Matcher, FeatureError> {
        self.session("lighterglue", LIGHTERGLUE, 1).map(Matcher::new)
    }

    fn session(
        &self,
        id: &'static str,
        bytes: &[u8],
        weights: usize,
    ) -> Result<Network, FeatureError> {
        let graph = Graph {
            bytes,
            weights: vec![(&self.package.weights[weights].file, self.weights[weights].clone())],
        };
        inference::session(&self.runtime, &graph, Provider::Cpu, false, 1)
            .map(Network::new)
            .map_err(|detail| FeatureError::Unusable { id, detail })
    }

    /// Creates one session per thread.
    fn sessions<T>(
        &self,
        one: impl Fn(&Self) -> Result<T, FeatureError>,
    ) -> Result<Vec<T>, PosesError> {
        let all =
            (0..self.options.threads.max(1)).map(|_| one(self).map_err(|error| failed(&error)));
        all.collect()
    }

    fn extract(
        extractor: &mut Extractor,
        picture: &Path,
        most: usize,
    ) -> Result<KeyPoints, PosesError> {
        let image =
            Image::load(picture).map_err(|e| PosesError::bad_file(picture, e.to_string()))?;
        extractor.key_points(&image, most).map_err(|detail| PosesError::Matching {
            detail: format!("{}: {detail}", name_of(picture)),
        })
    }

    /// The key points of every picture, for this number of pairs.
    fn key_points(
        &self,
        pictures: &[PathBuf],
        pairs: usize,
        advance: &mut dyn FnMut(u64, u64),
        cancel: &CancelToken,
    ) -> Result<Vec<KeyPoints>, PosesError> {
        let mut extractors = self.sessions(Self::extractor)?;
        let most = self.options.key_points_of(pairs);
        let extract =
            |extractor: &mut _, picture: &PathBuf| Self::extract(extractor, picture, most);
        // The total includes all pairs from the first picture on, so that the progress never looks
        // complete too early.
        let count = pictures.len() as u64;
        let total = count + pairs as u64;
        each(pictures, &mut extractors, cancel, extract, &mut |done| {
            // The last one is reported with the pairs of an interrupted search.
            if done < count {
                advance(done, total);
            }
        })
    }

    /// The matches of a pair, if the fast check passes.
    fn pair(
        &self,
        matcher: &mut Matcher,
        (first, second): (usize, usize),
        found: &[KeyPoints],
    ) -> Result<Matches, PosesError> {
        let (a, b) = (&found[first], &found[second]);
        if nearest::mutual(a, b).len() < self.options.neighbours {
            return Ok(None);
        }
        let matches = matcher.matches(a, b).map_err(|detail| PosesError::Matching {
            detail: format!("pictures {first} and {second}: {detail}"),
        })?;
        Ok(Some(matches.iter().map(|m| [m.first, m.second]).collect()))
    }
}

fn failed(error: &FeatureError) -> PosesError {
    PosesError::Matching { detail: error.to_string() }
}

impl Matching for LearnedMatching {
    fn matches(
        &self,
        pictures: &[PathBuf],
        pairs: Pairs,
        keeping: Option<Keeping<'_>>,
        advance: &mut dyn FnMut(u64, u64),
        cancel: &CancelToken,
    ) -> Result<Correspondences, PosesError> {
        let kept = KeptMatches::open(keeping, &self.describe())?;
        let count = pairs::count(pictures.len(), pairs);
        let found = self.key_points(pictures, count, advance, cancel)?;
        let pooled: Vec<_> = found.iter().map(KeyPoints::pooled).collect();
        let candidates = pairs::candidates(&pooled, pairs);
        let prints: Vec<_> = found.iter().map(kept::print).collect();
        let key = |(first, second): (usize, usize)| {
            kept::key(&prints[first], &prints[second], self.options.neighbours)
        };
        let keys: Vec<_> = candidates.iter().map(|pair| key(*pair)).collect();
        keys.iter().try_for_each(|key| kept.take_over(key))?;
        let pairs = candidates.iter().zip(&keys);
        let missing: Vec<_> = pairs.clone().filter(|(_, key)| !kept.has(key)).collect();
        let total = (pictures.len() + candidates.len()) as u64;
        let before = total - missing.len() as u64;
        advance(before, total);
        if !missing.is_empty() {
            let mut matchers = self.sessions(Self::matcher)?;
            let pair = |matcher: &mut _, (pair, key): &(&_, &kept::Key)| {
                kept.keep(**key, self.pair(matcher, **pair, &found)?)
            };
            each(&missing, &mut matchers, cancel, pair, &mut |done| {
                advance(before + done, total);
            })?;
        }
        let pairs = pairs.filter_map(|(&(first, second), key)| {
            Some(PairMatches { first, second, matches: kept.get(key)? })
        });
        Ok(Correspondences {
            pairs: pairs.collect(),
            kept: candidates.len() - missing.len(),
            key_points: found.into_iter().map(|found| found.positions).collect(),
        })
    }

    fn describe(&self) -> String {
        let Self { package, options, .. } = self;
        format!(
            "{} of {} {}, up to {} key points",
            package.id, package.package, package.version, options.key_points
        )
    }
}

/// Applies `work` to every item, on as many threads as there are states, and returns the results in
/// the items' order. Calls `advance` on this thread with the number of finished items.
///
/// # Errors
/// The first error of `work`, or [`PosesError::Cancelled`].
fn each<I: Sync, S: Send, R: Send>(
    items: &[I],
    states: &mut [S],
    cancel: &CancelToken,
    work: impl Fn(&mut S, &I) -> Result<R, PosesError> + Sync,
    advance: &mut dyn FnMut(u64),
) -> Result<Vec<R>, PosesError> {
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::channel();
    let mut results: Vec<Option<R>> = items.iter().map(|_| None).collect();
    std::thread::scope(|scope| {
        for state in states {
            let (next, work, sender) = (&next, &work, sender.clone());
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(index) else { break };
                    let result = cancel.check().map_err(PosesError::from);
                    let result = result.and_then(|()| work(state, item));
                    if sender.send((index, result)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        for (done, (index, result)) in (1..).zip(receiver) {
            results[index] = Some(result?);
            advance(done);
        }
        Ok::<_, PosesError>(())
    })?;
    Ok(results.into_iter().flatten().collect())
}
