//! Key points and matches found by networks, imported into COLMAP's database: COLMAP verifies the
//! matches itself.

use std::cmp::Reverse;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::candidate::{Candidate, Evidence};
use super::copies::Copies;
use super::options::{self, set};
use super::search::Search;
use super::strategies::Mapping;
use crate::cancel::CancelToken;
use crate::event::{Event, ProgressSink, Stage};
use crate::poses::matching::{Correspondences, Keeping, Matching, PairMatches, Pairs};
use crate::poses::{PoseRequest, PosesError};
use crate::run_folder::KEPT_MATCHES;

/// Length of a descriptor in COLMAP's text files. Unused: nothing is matched by descriptors.
const DESCRIPTOR: usize = 128;

/// The selections of pairs for models, tried until one agrees with the strongest matches of all
/// photographs. Fewer of the strongest pairs mislead less, but also connect less.
const SELECTIONS: [Selection; 4] = [
    Selection::All,
    Selection::Strongest(STRONGEST),
    Selection::Strongest(5),
    Selection::Strongest(2),
];

/// This many pairs per photograph mislead least: between similar sides of a courtyard, true
/// neighbours have more matches than false ones.
const STRONGEST: usize = 3;

/// Number of times that pairs which a model contradicts are replaced.
const REVISIONS: usize = 2;

/// The pairs from which a model is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Selection {
    /// Every pair with matches.
    All,
    /// This many pairs with most matches for each photograph.
    Strongest(usize),
}

impl Search<'_> {
    /// The best model from the matches of the networks. If one contradicts stronger matches than
    /// those it is built on, another is built from the strongest alone, and from what agrees with
    /// it. `broken` becomes the failure of the tool, if any.
    pub(super) fn best_learned(
        &self,
        matching: &dyn Matching,
        evidence: &mut Evidence<'_>,
        broken: &mut Option<PosesError>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Candidate>, PosesError> {
        let found = self.find(matching, evidence.small, sink, cancel)?;
        evidence.found = Some(found.clone());
        if evidence.reach().is_some_and(|reach| self.is_short(reach)) {
            return Ok(None);
        }
        let total = self.request.views.len();
        let mut best = None;
        for selection in SELECTIONS {
            let letters = match selection {
                Selection::All => ['L', 'M'],
                Selection::Strongest(_) => ['N', 'O'],
            };
            let selected = selection.of(&found);
            let built = self.build(&selected, letters, evidence, sink, cancel);
            best = better(best, or_warning(built, broken, sink)?);
            let Some(best) = &best else { continue };
            if best.believed() == total {
                break;
            }
        }
        // Matches that agree with a model built from few place photographs more precisely, and more
        // of them.
        let strongest = Selection::Strongest(STRONGEST).of(&found);
        for _ in 0..REVISIONS {
            let Some(now) = best.as_ref().filter(|best| best.strategy > 'M') else {
                break;
            };
            let Some(consistency) = &now.consistency else {
                break;
            };
            let (believed, agreeing) = (now.believed(), consistency.agreeing(&found, &strongest));
            let built = self.build(&agreeing, ['P', 'Q'], evidence, sink, cancel);
            best = better(best, or_warning(built, broken, sink)?);
            if best.as_ref().is_none_or(|best| [believed, total].contains(&best.believed())) {
                break;
            }
        }
        Ok(best)
    }

    /// A model from some of the matches: with the default mapper, and with a loose one if that does
    /// not place all photographs.
    fn build(
        &self,
        matches: &Correspondences,
        letters: [char; 2],
        evidence: &Evidence<'_>,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Candidate>, PosesError> {
        let (small, total) = (evidence.small, self.request.views.len());
        let database = self.request.work_dir.join("L.db");
        self.import(matches, small, &database, cancel)?;
        let mut best = None;
        for (letter, loose) in letters.into_iter().zip([false, true]) {
            let model = self.map(Mapping { letter, loose }, small, &database, cancel)?;
            let placed = model.as_ref().map_or(0, |model| model.images.len());
            best = better(best, self.weigh(letter, model, small.clone(), evidence, sink));
            if placed == total {
                break;
            }
        }
        Ok(best)
    }

    /// Key points and matches of the copies, found by networks.
    fn find(
        &self,
        matching: &dyn Matching,
        copies: &Copies,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Correspondences, PosesError> {
        let files = copies.copies.iter().map(|copy| copies.dir.join(&copy.file));
        let pictures: Vec<PathBuf> = files.collect();
        let mut advance = |done, total| {
            sink.event(&Event::advanced(Stage::Poses, done, total));
        };
        let start = Instant::now();
        let file = self.request.work_dir.join(KEPT_MATCHES);
        let PoseRequest { stamp, earlier, .. } = *self.request;
        let keeping = Some(Keeping { file: &file, stamp, earlier });
        let mut found =
            matching.matches(&pictures, Pairs::Within, keeping, &mut advance, cancel)?;
        found.retain(|picture, point| !copies.hides(picture, point));
        if found.kept > 0 {
            let (kept, pairs) = (found.kept, pictures.len() * (pictures.len() - 1) / 2);
            sink.log(format!("poses: {kept} of {pairs} pairs were compared by an earlier search"));
        }
        let matches: usize = found.pairs.iter().map(|pair| pair.matches.len()).sum();
        sink.log(format!(
            "poses: {matches} matches in {} pairs of {} photographs, {} in {:.1} s",
            found.pairs.len(),
            pictures.len(),
            matching.describe(),
            start.elapsed().as_secs_f64()
        ));
        Ok(found)
    }

    /// Fills a new database with the findings in the copies.
    pub(super) fn import(
        &self,
        found: &Correspondences,
        copies: &Copies,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        let folder = self.request.work_dir.join("learned");
        for (copy, points) in copies.copies.iter().zip(&found.key_points) {
            write(&folder.join(format!("{}.txt", copy.file)), &features(points))?;
        }
        let mut settings = self.reading(copies, database)?;
        settings.push(set(&["import_path"], &folder.display()));
        self.succeed("feature_importer", &settings, cancel)?;
        let list = folder.join("matches.txt");
        write(&list, &matches(copies, &found.pairs))?;
        let settings = [
            set(&["database_path"], &database.display()),
            set(&["match_list_path"], &list.display()),
            set(&["match_type"], &"raw"),
            set(options::MATCH_USE_GPU, &0),
        ];
        self.succeed("matches_importer", &settings, cancel)
    }
}

impl Selection {
    fn of(self, found: &Correspondences) -> Correspondences {
        let Self::Strongest(most) = self else {
            return found.clone();
        };
        let mut pairs: Vec<&PairMatches> = found.pairs.iter().collect();
        pairs.sort_by_key(|pair| (Reverse(pair.matches.len()), pair.first, pair.second));
        let mut taken = vec![0; found.key_points.len()];
        pairs.retain(|pair| {
            let is_wanted = taken[pair.first] < most || taken[pair.second] < most;
            taken[pair.first] += 1;
            taken[pair.second] += 1;
            is_wanted
        });
        Correspondences {
            key_points: found.key_points.clone(),
            pairs: pairs.into_iter().cloned().collect(),
            kept: found.kept,
        }
    }
}

/// The built model; a failure of the tool becomes a warning and is put into `broken`, and another
/// selection may do better.
fn or_warning(
    built: Result<Option<Candidate>, PosesError>,
    broken: &mut Option<PosesError>,
    sink: &mut dyn ProgressSink,
) -> Result<Option<Candidate>, PosesError> {
    match built {
        Err(error) if error.is_about_the_tool() => {
            sink.warn("colmap_failed", format!("learned matches: {error}"));
            *broken = Some(error);
            Ok(None)
        }
        built => built,
    }
}

fn better(one: Option<Candidate>, other: Option<Candidate>) -> Option<Candidate> {
    match (one, other) {
        (Some(one), Some(other)) if other.rank() > one.rank() => Some(other),
        (one, other) => one.or(other),
    }
}

/// COLMAP's text format for key points: x, y, scale, orientation and a descriptor each.
fn features(points: &[[f32; 2]]) -> String {
    let descriptor = " 0".repeat(DESCRIPTOR);
    let mut text = format!("{} {DESCRIPTOR}\n", points.len());
    for [x, y] in points {
        let _ = writeln!(text, "{x} {y} 1 0{descriptor}");
    }
    text
}

/// COLMAP's list of raw matches: the names of a pair, one line per match, an empty line.
fn matches(copies: &Copies, pairs: &[PairMatches]) -> String {
    let mut text = String::new();
    for pair in pairs.iter().filter(|pair| !pair.matches.is_empty()) {
        let name = |index: usize| &copies.copies[index].file;
        let _ = writeln!(text, "{} {}", name(pair.first), name(pair.second));
        for [first, second] in &pair.matches {
            let _ = writeln!(text, "{first} {second}");
        }
        text.push('\n');
    }
    text
}

fn write(path: &PathBuf, text: &str) -> Result<(), PosesError> {
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder).map_err(PosesError::io(folder))?;
    std::fs::write(path, text).map_err(PosesError::io(path))
}
