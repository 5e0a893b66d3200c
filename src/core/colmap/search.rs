//! The search: each strategy is tried only if the previous ones gave no good model.

use std::path::Path;

use super::candidate::{Candidate, Evidence};
use super::consistency::Consistency;
use super::copies::{Copies, Copy, Kind};
use super::files::{empty, largest_model, remove_if_there};
use super::groups;
use super::options::{self, Prober, Setting, masks, set};
use super::process::Runner;
use super::strategies::{
    Acceptance, FIRST_LEARNED, LEARNED, Mapping, STRATEGIES, Strategy, advance, begin,
};
use crate::cancel::CancelToken;
use crate::capture::MIN_VIEWS;
use crate::event::{Event, ProgressSink};
use crate::poses::matching::Matching;
use crate::poses::model::SparseModel;
use crate::poses::overlap::Overlap;
use crate::poses::{PoseRequest, PoseView, Poses, PosesError, in_words};

/// Above this number matching all pairs takes too long: match neighbours in the capture's order.
const MAX_EXHAUSTIVE: usize = 150;

/// How far apart neighbours are: the defaults of COLMAP's own sequential matcher, which orders
/// photographs by the names of their files, so that `a10` comes before `a9`.
const NEIGHBOURS: [usize; 16] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 16, 32, 64, 128, 256, 512];

/// A search for a good model.
pub(super) struct Search<'a> {
    runner: &'a Runner,
    prober: Prober<'a>,
    pub(super) request: &'a PoseRequest<'a>,
    acceptance: Acceptance,
    matching: Option<&'a dyn Matching>,
}

impl<'a> Search<'a> {
    pub fn new(
        runner: &'a Runner,
        request: &'a PoseRequest<'a>,
        acceptance: Acceptance,
        matching: Option<&'a dyn Matching>,
    ) -> Self {
        Self { runner, prober: Prober::new(runner), request, acceptance, matching }
    }

    /// Tries strategies until a model is accepted, and returns the best.
    pub fn run(
        &self,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError> {
        let small = self.small_copies(sink, cancel)?;
        let mut evidence = Evidence { small: &small, found: None };
        let outcome = match self.best(&mut evidence, sink, cancel)? {
            Some(best) => self.deliver(&best, &evidence),
            None => Err(self.too_few(0, &evidence)),
        };
        if let (Err(PosesError::TooFew { .. }), Some(overlap)) = (&outcome, self.overlap(&evidence))
        {
            sink.event(&Event::OverlapFound(overlap));
        }
        outcome
    }

    /// The copies used by the learned strategies and most of COLMAP's own.
    pub(super) fn small_copies(
        &self,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Copies, PosesError> {
        let Self { request, .. } = self;
        let folder = request.work_dir.join("small");
        let small = Copies::write(&folder, request.views, Kind::Small, cancel)?;
        warn_of_zooms(&small, sink);
        Ok(small)
    }

    /// The best result of the strategies tried; `None` if none gave a model.
    pub(super) fn best(
        &self,
        evidence: &mut Evidence<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Candidate>, PosesError> {
        let (total, small) = (self.request.views.len(), evidence.small);
        let mut best: Option<Candidate> = None;
        let mut broken = None;
        if let Some(matching) = self.matching {
            begin(sink, FIRST_LEARNED, LEARNED);
            match self.best_learned(matching, evidence, &mut broken, sink, cancel) {
                Ok(candidate) => best = candidate,
                Err(error) if error.is_about_the_tool() => {
                    sink.warn("matcher_failed", format!("learned matches: {error}"));
                    broken = Some(error);
                }
                Err(error) => return Err(error),
            }
        }
        let reach = evidence.reach();
        let clear = evidence.clear_reach().filter(|&clear| self.is_short(clear));
        let believed = best.as_ref().map_or(0, Candidate::believed);
        // Of a broken tool the first strategies tell more than the matches do.
        let clear = clear.filter(|_| broken.is_none());
        if let Some(clear) = clear.filter(|_| self.is_short(believed)) {
            // COLMAP's own features connect fewer photographs than those of the networks.
            sink.log(format!(
                "poses: matches connect at most {clear} of {total} photographs: no other strategy is \
                 tried"
            ));
            return Ok(best);
        }
        for strategy in STRATEGIES
            .iter()
            .filter(|strategy| !(strategy.copies == Kind::Full && small.are_full_size()))
            .filter(|strategy| strategy.beside_networks || evidence.found.is_none())
        {
            if best.as_ref().is_some_and(|best| self.is_enough(strategy, best, reach)) {
                break;
            }
            begin(sink, strategy.letter, strategy.name);
            let candidate = match self.attempt(strategy, evidence, sink, cancel) {
                Ok(candidate) => candidate,
                Err(error) if error.is_about_the_tool() => {
                    sink.warn("colmap_failed", format!("strategy {}: {error}", strategy.letter));
                    broken = Some(error);
                    continue;
                }
                Err(error) => return Err(error),
            };
            if candidate.as_ref().map(Candidate::rank) > best.as_ref().map(Candidate::rank) {
                best = candidate;
            }
        }
        match (best, broken) {
            (None, Some(error)) => Err(error),
            (best, _) => Ok(best),
        }
    }

    /// Whether so few photographs make no scene.
    pub(super) fn is_short(&self, registered: usize) -> bool {
        let share = self.acceptance.salvage * self.request.views.len() as f64;
        registered < MIN_VIEWS || (registered as f64) < share
    }

    /// Whether a strategy and those after it are not needed. A model that has the `reach`
    /// photographs which the networks' matches connect, too few to be accepted, is as good as any.
    fn is_enough(&self, strategy: &Strategy, best: &Candidate, reach: Option<usize>) -> bool {
        let total = self.request.views.len();
        let accepted = self.acceptance.registered * total as f64;
        let is_all =
            reach.is_some_and(|reach| best.believed() >= reach && (reach as f64) < accepted);
        match strategy.letter {
            // With little shake COLMAP's own points are finer than learned ones.
            'A' => false,
            // Mapping again is cheap, so also try if a good model lacks a photograph.
            'B' => is_all || best.accepted && best.believed() == total,
            _ => is_all || best.accepted,
        }
    }

    /// One strategy; `None` if nothing registered.
    fn attempt(
        &self,
        strategy: &Strategy,
        evidence: &Evidence<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Candidate>, PosesError> {
        let views = self.request.views;
        advance(sink, strategy.letter, 0);
        let written = |folder: &str| {
            Copies::write(&self.request.work_dir.join(folder), views, strategy.copies, cancel)
        };
        let copies = match strategy.copies {
            Kind::Small => evidence.small.clone(),
            Kind::Full => written("full")?,
            Kind::Plain => written("plain")?,
        };
        let database = self.request.work_dir.join(format!("{}.db", strategy.database));
        if strategy.database == strategy.letter {
            self.extract(strategy, &copies, &database, cancel)?;
            advance(sink, strategy.letter, 1);
            self.match_pairs(strategy, &copies, &database, cancel)?;
        }
        advance(sink, strategy.letter, 2);
        let mapping = Mapping { letter: strategy.letter, loose: strategy.loose_mapper };
        let model = self.map(mapping, &copies, &database, cancel)?;
        advance(sink, strategy.letter, 3);
        Ok(self.weigh(strategy.letter, model, copies, evidence, sink))
    }

    /// Turns a strategy's model into a candidate, and logs it.
    pub(super) fn weigh(
        &self,
        strategy: char,
        model: Option<SparseModel>,
        copies: Copies,
        evidence: &Evidence<'_>,
        sink: &mut dyn ProgressSink,
    ) -> Option<Candidate> {
        let total = self.request.views.len();
        let Some(model) = model else {
            sink.log(format!("poses: strategy {strategy} registered none of {total}"));
            return None;
        };
        let found = evidence.found.as_ref();
        let consistency =
            found.map(|found| Consistency::of(&model, &copies, evidence.small, found));
        let accepted = match &consistency {
            Some(consistency) => self.believes(consistency),
            None => self.accepts(&model),
        };
        let candidate = Candidate { strategy, model, copies, consistency, accepted };
        let registered = candidate.model.images.len();
        sink.log(format!(
            "poses: strategy {strategy} registered {registered} of {total}, {} of them believed, {:.0} \
             observations a photograph, mean track {:.2}, {}",
            candidate.believed(),
            candidate.model.observations() as f64 / registered as f64,
            candidate.model.mean_track().unwrap_or(0.0),
            if accepted {
                "accepted"
            } else {
                "not good enough"
            }
        ));
        Some(candidate)
    }

    fn seed(&self, letter: char) -> Setting {
        // Another attempt with the same seed might repeat the failure.
        let attempt = u64::from(u32::from(letter));
        set(options::RANDOM_SEED, &(self.request.seed.wrapping_add(attempt) % (1 << 31)))
    }

    /// How photographs are read into a new database: cameras and lens.
    pub(super) fn reading(
        &self,
        copies: &Copies,
        database: &Path,
    ) -> Result<Vec<Setting>, PosesError> {
        // The database of an earlier, killed run may be locked or incomplete.
        remove_if_there(database)?;
        let share = if copies.one_camera {
            set(&["ImageReader.single_camera"], &1)
        } else {
            set(&["ImageReader.single_camera_per_folder"], &1)
        };
        let mut settings = vec![
            set(&["database_path"], &database.display()),
            set(&["image_path"], &copies.dir.display()),
            set(&["ImageReader.camera_model"], &"SIMPLE_RADIAL"),
            share,
        ];
        settings.extend(masks(copies));
        if let Some(focal) = copies.focal(self.request.views) {
            let (width, height) = copies.copies[0].size;
            let params = format!("{focal},{},{},0", width as f64 / 2.0, height as f64 / 2.0);
            settings.push(set(&["ImageReader.camera_params"], &params));
        }
        Ok(settings)
    }

    fn extract(
        &self,
        strategy: &Strategy,
        copies: &Copies,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        let mut settings = self.reading(copies, database)?;
        settings.extend([set(options::EXTRACT_USE_GPU, &0), self.seed(strategy.letter)]);
        if strategy.robust_features {
            settings.extend([
                set(&["SiftExtraction.estimate_affine_shape"], &1),
                set(&["SiftExtraction.domain_size_pooling"], &1),
                set(&["SiftExtraction.peak_threshold"], &0.003),
            ]);
        }
        self.succeed("feature_extractor", &settings, cancel)
    }

    /// Matches for strategy A.
    pub(super) fn match_features(
        &self,
        copies: &Copies,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        self.match_pairs(&STRATEGIES[0], copies, database, cancel)
    }

    fn match_pairs(
        &self,
        strategy: &Strategy,
        copies: &Copies,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        let mut settings = vec![
            set(&["database_path"], &database.display()),
            set(options::MATCH_USE_GPU, &0),
            set(options::GUIDED_MATCHING, &1),
            self.seed(strategy.letter),
        ];
        if strategy.robust_features {
            settings.push(set(&["SiftMatching.max_ratio"], &0.85));
        }
        if copies.copies.len() <= MAX_EXHAUSTIVE {
            return self.succeed("exhaustive_matcher", &settings, cancel);
        }
        let list = database.with_extension("pairs");
        std::fs::write(&list, neighbours(&copies.copies)).map_err(PosesError::io(&list))?;
        settings.push(set(&["match_list_path"], &list.display()));
        self.succeed("matches_importer", &settings, cancel)
    }

    /// The largest model of the mapper; `None` if it found no initial pair.
    pub(super) fn map(
        &self,
        mapping: Mapping,
        copies: &Copies,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<Option<SparseModel>, PosesError> {
        let output = self.request.work_dir.join(format!("sparse-{}", mapping.letter));
        empty(&output)?;
        let mut settings = vec![
            set(&["database_path"], &database.display()),
            set(&["image_path"], &copies.dir.display()),
            set(&["output_path"], &output.display()),
            self.seed(mapping.letter),
        ];
        if mapping.loose {
            settings.extend([
                set(&["Mapper.init_min_num_inliers"], &50),
                set(&["Mapper.init_min_tri_angle"], &4),
                set(&["Mapper.abs_pose_min_num_inliers"], &15),
                set(&["Mapper.abs_pose_min_inlier_ratio"], &0.15),
                set(&["Mapper.min_model_size"], &MIN_VIEWS),
            ]);
        }
        let finished = self.prober.run("mapper", &settings, cancel)?;
        let found_nothing =
            || finished.text().to_ascii_lowercase().contains("failed to create sparse model");
        if !finished.status.success() && !found_nothing() {
            return Err(finished.failure("mapper"));
        }
        largest_model(&output)
    }

    pub(super) fn succeed(
        &self,
        command: &str,
        settings: &[Setting],
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        let finished = self.prober.run(command, settings, cancel)?;
        if finished.status.success() { Ok(()) } else { Err(finished.failure(command)) }
    }

    /// Whether the matches support enough of the photographs.
    fn believes(&self, consistency: &Consistency) -> bool {
        let (believed, total) = (consistency.believed().len(), self.request.views.len());
        believed >= MIN_VIEWS && believed as f64 >= self.acceptance.registered * total as f64
    }

    fn accepts(&self, model: &SparseModel) -> bool {
        let (registered, total) = (model.images.len() as f64, self.request.views.len() as f64);
        // Points in fewer than ten photographs have short tracks: 2 with two photographs.
        let track =
            self.acceptance.track.min(2.0 + (self.acceptance.track - 2.0) * (total - 2.0) / 8.0);
        registered >= self.acceptance.registered * total
            && model.observations() as f64 >= self.acceptance.observations * registered
            && model.mean_track().is_some_and(|mean| mean >= track)
    }

    /// The poses of a candidate, in the request's order and at the originals' sizes.
    pub(super) fn deliver(
        &self,
        best: &Candidate,
        evidence: &Evidence<'_>,
    ) -> Result<Poses, PosesError> {
        let (registered, total) = (best.believed(), self.request.views.len());
        if !best.accepted && self.is_short(registered) {
            return Err(self.too_few(registered, evidence));
        }
        let all = self.request.views.iter().enumerate();
        let verdicts: Vec<_> = all.map(|(index, view)| best.verdict(index, view)).collect();
        let views = best.placed(self.request.views);
        self.runner.note(&format!("[strategy {} taken]", best.strategy));
        Ok(Poses {
            registered: views.len(),
            views,
            points: best.points(),
            total,
            source: String::new(),
            strategy: Some(best.strategy),
            verdicts,
            parts: self.parts(evidence, |view| view.name.clone()),
            mean_reprojection_error: best.model.mean_error(),
            mean_track: best.model.mean_track(),
            low_confidence: !best.accepted,
            network: None,
            seconds: 0.0,
            ..Poses::default()
        })
    }

    /// The connected photographs, if matches do not connect all: the names of their views or what
    /// else `of` says.
    fn parts(&self, evidence: &Evidence<'_>, of: impl Fn(&PoseView) -> String) -> Vec<Vec<String>> {
        let connected = evidence.found.as_ref().map(groups::connected);
        let mut parts = connected.unwrap_or_default();
        parts.retain(|part| part.len() >= MIN_VIEWS);
        if parts.len() < 2 {
            return Vec::new();
        }
        let of = |&index: &usize| of(&self.request.views[index]);
        parts.iter().map(|part| part.iter().map(of).collect()).collect()
    }

    /// Which photographs clearly show the same things, if not all do.
    fn overlap(&self, evidence: &Evidence<'_>) -> Option<Overlap> {
        groups::overlap(evidence.found.as_ref()?, self.request.views)
    }

    fn too_few(&self, registered: usize, evidence: &Evidence<'_>) -> PosesError {
        let parts = self.parts(evidence, |view| view.path.to_string());
        let total = self.request.views.len();
        let overlap = self.overlap(evidence);
        let advice = if !parts.is_empty() {
            format!(
                "they show {}: make a capture of each, or add photographs that connect them",
                in_words(&parts)
            )
        } else if let Some(overlap) = overlap.filter(|overlap| 2 * overlap.matched() >= total) {
            format!(
                "matches connect them only in {}: take more photographs between these, each of \
                 which shows most of what the one before it shows",
                overlap.in_words()
            )
        } else {
            "take 20 to 60 photographs with large overlap, moving the camera sideways between \
             them; hold it still, add light, and include textured objects"
                .to_owned()
        };
        PosesError::TooFew { registered, total, advice }
    }
}

/// COLMAP's list of pairs, by the names of their files.
fn neighbours(copies: &[Copy]) -> String {
    let pair = |(at, first): (usize, &Copy), apart: usize| {
        copies.get(at + apart).map(|second| format!("{} {}\n", first.file, second.file))
    };
    let all = copies.iter().enumerate();
    all.flat_map(|one| NEIGHBOURS.iter().filter_map(move |apart| pair(one, *apart))).collect()
}

fn warn_of_zooms(copies: &Copies, sink: &mut dyn ProgressSink) {
    let zooms = copies.zooms;
    if zooms > 1 {
        let message = format!(
            "the photographs were taken at {zooms} focal lengths. Each counts as a camera of its \
             own, with fewer photographs to determine it; do not change the zoom"
        );
        sink.warn("zoom_changed", message);
    }
}
