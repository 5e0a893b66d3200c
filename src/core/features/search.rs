//! Key points and matches of a whole capture.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};

use super::extractor::Extractor;
use super::key_points::KeyPoints;
use super::matcher::Matcher;
use super::weights::{Package, WeightsError};
use super::{nearest, pairs, self_test};
use crate::cancel::CancelToken;
use crate::image::Image;
use crate::inference::{self, Graph, Network, Provider, Runtime, RuntimeError};
use crate::poses::matching::{Correspondences, Matching, PairMatches, Pairs};
use crate::poses::{PosesError, name_of};

const XFEAT: &[u8] = include_bytes!("../../../models/xfeat.onnx");
const LIGHTERGLUE: &[u8] = include_bytes!("../../../models/lighterglue.onnx");

/// Each thread's networks take some 100 MiB at 2,048 key points.
const MOST_THREADS: usize = 8;

/// How many key points a photograph may have, and which pairs are worth the matcher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SearchOptions {
    /// Most key points of a photograph, where there are few pairs. More place more exactly: of 15
    /// photographs of a courtyard, shaken by 4.4 px, 13 are good with 1,024 and 15 with 2,048.
    pub key_points: usize,
    /// As many pairs can have so many; with more pairs each has fewer, as the matcher's time grows
    /// with their square.
    pub pairs: usize,
    /// Least mutual nearest neighbours of a pair that the matcher looks at.
    pub neighbours: usize,
    /// Threads, each with networks of its own.
    pub threads: usize,
}

impl SearchOptions {
    /// Most key points of each photograph where so many pairs are looked at, at least half of the
    /// most.
    pub(super) fn key_points_of(&self, pairs: usize) -> usize {
        let share = (self.pairs as f64 / pairs.max(self.pairs) as f64)
            .sqrt()
            .max(0.5);
        (self.key_points as f64 * share) as usize
    }
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self {
            key_points: 2048,
            pairs: 120,
            neighbours: 12,
            threads: std::thread::available_parallelism()
                .map_or(1, usize::from)
                .min(MOST_THREADS),
        }
    }
}

/// Why the networks cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FeatureError {
    /// Their weights.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// ONNX Runtime.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// ONNX Runtime refuses a graph.
    #[error("network {id} cannot be used: {detail}")]
    Unusable {
        /// Which.
        id: &'static str,
        /// What is wrong with it.
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
    /// Checks the weights in the first of `folders` that has them, and that ONNX Runtime computes
    /// with both graphs what it should.
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
        let matching = Self {
            runtime: runtime.clone(),
            weights,
            options,
            package,
        };
        let (mut extractor, mut matcher) = (matching.extractor()?, matching.matcher()?);
        self_test::run(&mut extractor, &mut matcher).map_err(|detail| FeatureError::Unusable {
            id: "xfeat-lighterglue",
            detail,
        })?;
        Ok(matching)
    }

    /// The same with the matcher's weights in another order: a library that errs.
    #[cfg(test)]
    pub(super) fn with_weights_shuffled(&self) -> Self {
        let mut matcher = self.weights[1].to_vec();
        // Not the file's header and tables: the middle, in numbers of four bytes.
        let quarter = matcher.len() / 16 * 4;
        matcher[quarter..3 * quarter]
            .chunks_exact_mut(8)
            .for_each(|two| two.rotate_left(4));
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
        self.session("lighterglue", LIGHTERGLUE, 1)
            .map(Matcher::new)
    }

    fn session(
        &self,
        id: &'static str,
        bytes: &[u8],
        weights: usize,
    ) -> Result<Network, FeatureError> {
        let graph = Graph {
            bytes,
            weights: Some((
                &self.package.weights[weights].file,
                self.weights[weights].clone(),
            )),
        };
        inference::session(&self.runtime, &graph, Provider::Cpu, false, 1)
            .map(Network::new)
            .map_err(|detail| FeatureError::Unusable { id, detail })
    }

    /// One of each, for every thread.
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
        extractor
            .key_points(&image, most)
            .map_err(|detail| PosesError::Matching {
                detail: format!("{}: {detail}", name_of(picture)),
            })
    }

    /// The matches of a pair, where a quick look says that there may be some.
    fn pair(
        &self,
        matcher: &mut Matcher,
        (first, second): (usize, usize),
        found: &[KeyPoints],
    ) -> Result<Option<PairMatches>, PosesError> {
        let (a, b) = (&found[first], &found[second]);
        if nearest::mutual(a, b).len() < self.options.neighbours {
            return Ok(None);
        }
        let matches = matcher
            .matches(a, b)
            .map_err(|detail| PosesError::Matching {
                detail: format!("pictures {first} and {second}: {detail}"),
            })?;
        Ok(Some(PairMatches {
            first,
            second,
            matches: matches.iter().map(|m| [m.first, m.second]).collect(),
        }))
    }
}

fn failed(error: &FeatureError) -> PosesError {
    PosesError::Matching {
        detail: error.to_string(),
    }
}

impl Matching for LearnedMatching {
    fn matches(
        &self,
        pictures: &[PathBuf],
        pairs: Pairs,
        advance: &mut dyn FnMut(u64, u64),
        cancel: &CancelToken,
    ) -> Result<Correspondences, PosesError> {
        let count = pairs::count(pictures.len(), pairs);
        // Told from the first picture on, so that what is done is never taken for all.
        let before = pictures.len() as u64;
        let total = before + count as u64;
        let mut extractors = self.sessions(Self::extractor)?;
        let most = self.options.key_points_of(count);
        let extract =
            |extractor: &mut _, picture: &PathBuf| Self::extract(extractor, picture, most);
        let found = each(pictures, &mut extractors, cancel, extract, &mut |done| {
            advance(done, total);
        })?;
        drop(extractors);
        let pooled: Vec<_> = found.iter().map(KeyPoints::pooled).collect();
        let candidates = pairs::candidates(&pooled, pairs);
        let mut matchers = self.sessions(Self::matcher)?;
        let pair = |matcher: &mut _, pair: &_| self.pair(matcher, *pair, &found);
        let matched = each(&candidates, &mut matchers, cancel, pair, &mut |done| {
            advance(before + done, total);
        })?;
        Ok(Correspondences {
            key_points: found.into_iter().map(|found| found.positions).collect(),
            pairs: matched.into_iter().flatten().collect(),
        })
    }

    fn describe(&self) -> String {
        let Self {
            package, options, ..
        } = self;
        format!(
            "{} of {} {}, up to {} key points",
            package.id, package.package, package.version, options.key_points
        )
    }
}

/// `work` on every item, by as many threads as there are states, in the items' order. `advance` is
/// told, on this thread, how many are done.
///
/// # Errors
/// The first of the work, or [`PosesError::Cancelled`].
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
