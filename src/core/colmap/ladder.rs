//! The ladder of settings: each rung is tried only when the ones before gave no good model.

use std::path::{Path, PathBuf};

use super::copies::Copies;
use super::options::{self, Prober, Setting, set};
use super::process::Runner;
use super::rungs::{Acceptance, LADDER, Rung};
use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::event::{Event, ProgressSink, Stage};
use crate::poses::model::SparseModel;
use crate::poses::{Lens, PoseRequest, PosedView, Poses, PosesError};

/// Two views give a depth but no check of it.
pub(super) const MIN_VIEWS: usize = 3;

/// Above this many photographs all pairs are too many: neighbours in the capture's order.
const MOST_EXHAUSTIVE: usize = 150;

/// A rung's result.
struct Candidate {
    rung: char,
    model: SparseModel,
    copies: Copies,
    accepted: bool,
}

impl Candidate {
    /// What decides between candidates, most important first.
    fn rank(&self) -> (bool, usize, usize) {
        (
            self.accepted,
            self.model.images.len(),
            self.model.observations(),
        )
    }
}

/// One climb up the ladder.
pub(super) struct Climb<'a> {
    runner: &'a Runner,
    prober: Prober<'a>,
    pub(super) request: &'a PoseRequest<'a>,
    acceptance: Acceptance,
}

impl<'a> Climb<'a> {
    pub fn new(runner: &'a Runner, request: &'a PoseRequest<'a>, acceptance: Acceptance) -> Self {
        Self {
            runner,
            prober: Prober::new(runner),
            request,
            acceptance,
        }
    }

    /// Climbs until a model is accepted, and takes the best.
    pub fn run(
        &self,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Poses, PosesError> {
        let total = self.request.views.len();
        let small = Copies::write(
            &self.request.work_dir.join("small"),
            self.request.views,
            true,
            cancel,
        )?;
        let mut best: Option<Candidate> = None;
        let mut broken = None;
        for rung in LADDER
            .iter()
            .filter(|rung| !(rung.full_size && small.are_full_size()))
        {
            let outcome = self.attempt(rung, &small, sink, cancel);
            let candidate = match outcome {
                Ok(candidate) => candidate,
                Err(error @ PosesError::Tool { .. }) => {
                    sink.warn("colmap_failed", format!("rung {}: {error}", rung.letter));
                    broken = Some(error);
                    continue;
                }
                Err(error) => return Err(error),
            };
            if candidate.as_ref().map(Candidate::rank) > best.as_ref().map(Candidate::rank) {
                best = candidate;
            }
            // Mapping again is cheap, so a good model that lacks a photograph still tries rung B.
            let accepted = best.as_ref().filter(|best| best.accepted);
            if accepted.is_some_and(|best| best.model.images.len() == total || rung.letter != 'A') {
                break;
            }
        }
        match (best, broken) {
            (Some(best), _) => self.deliver(&best),
            (None, Some(error)) => Err(error),
            (None, None) => Err(self.too_few(0)),
        }
    }

    /// One rung; `None` when nothing registered.
    fn attempt(
        &self,
        rung: &Rung,
        small: &Copies,
        sink: &mut dyn ProgressSink,
        cancel: &CancelToken,
    ) -> Result<Option<Candidate>, PosesError> {
        let views = self.request.views;
        let mut report = |part| advance(sink, rung.letter, part);
        report(0);
        let copies = match rung.full_size {
            true => Copies::write(&self.request.work_dir.join("full"), views, false, cancel)?,
            false => small.clone(),
        };
        let database = self.request.work_dir.join(format!("{}.db", rung.database));
        if rung.database == rung.letter {
            self.extract(rung, &copies, &database, cancel)?;
            report(1);
            self.match_pairs(rung, &database, cancel)?;
        }
        report(2);
        let model = self.map(rung, &copies, &database, cancel)?;
        report(3);
        let accepted = model.as_ref().is_some_and(|model| self.accepts(model));
        sink.log(match &model {
            Some(model) => format!(
                "poses: rung {} registered {} of {}, {:.0} observations a photograph, mean track {:.2}, {}",
                rung.letter,
                model.images.len(),
                views.len(),
                model.observations() as f64 / model.images.len() as f64,
                model.mean_track().unwrap_or(0.0),
                if accepted { "accepted" } else { "not good enough" }
            ),
            None => format!("poses: rung {} registered none of {}", rung.letter, views.len()),
        });
        Ok(model.map(|model| Candidate {
            rung: rung.letter,
            model,
            copies,
            accepted,
        }))
    }

    fn seed(&self, rung: &Rung) -> Setting {
        // A fresh attempt with the same seed might repeat the failure.
        let attempt = u64::from(u32::from(rung.letter));
        set(
            options::RANDOM_SEED,
            &(self.request.seed.wrapping_add(attempt) % (1 << 31)),
        )
    }

    fn extract(
        &self,
        rung: &Rung,
        copies: &Copies,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        // A database of an earlier, killed run may be locked or half full.
        remove_if_there(database)?;
        let share = if copies.one_size {
            set(&["ImageReader.single_camera"], &1)
        } else {
            set(&["ImageReader.single_camera_per_folder"], &1)
        };
        let mut settings = vec![
            set(&["database_path"], &database.display()),
            set(&["image_path"], &copies.dir.display()),
            set(&["ImageReader.camera_model"], &"SIMPLE_RADIAL"),
            share,
            set(options::EXTRACT_USE_GPU, &0),
            self.seed(rung),
        ];
        if let Some(focal) = copies.focal(self.request.views) {
            let (width, height) = copies.copies[0].size;
            let params = format!("{focal},{},{},0", width as f64 / 2.0, height as f64 / 2.0);
            settings.push(set(&["ImageReader.camera_params"], &params));
        }
        if rung.robust_features {
            settings.extend([
                set(&["SiftExtraction.estimate_affine_shape"], &1),
                set(&["SiftExtraction.domain_size_pooling"], &1),
                set(&["SiftExtraction.peak_threshold"], &0.003),
            ]);
        }
        self.succeed("feature_extractor", &settings, cancel)
    }

    /// Matches of rung A.
    pub(super) fn match_features(
        &self,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        self.match_pairs(&LADDER[0], database, cancel)
    }

    fn match_pairs(
        &self,
        rung: &Rung,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        let mut settings = vec![
            set(&["database_path"], &database.display()),
            set(options::MATCH_USE_GPU, &0),
            set(options::GUIDED_MATCHING, &1),
            self.seed(rung),
        ];
        if rung.robust_features {
            settings.push(set(&["SiftMatching.max_ratio"], &0.85));
        }
        let exhaustive = self.request.views.len() <= MOST_EXHAUSTIVE;
        let command = if exhaustive {
            "exhaustive_matcher"
        } else {
            "sequential_matcher"
        };
        self.succeed(command, &settings, cancel)
    }

    /// The largest model of the mapper; `None` when it found no start.
    fn map(
        &self,
        rung: &Rung,
        copies: &Copies,
        database: &Path,
        cancel: &CancelToken,
    ) -> Result<Option<SparseModel>, PosesError> {
        let output = self
            .request
            .work_dir
            .join(format!("sparse-{}", rung.letter));
        if output.exists() {
            std::fs::remove_dir_all(&output).map_err(PosesError::io(&output))?;
        }
        std::fs::create_dir_all(&output).map_err(PosesError::io(&output))?;
        let mut settings = vec![
            set(&["database_path"], &database.display()),
            set(&["image_path"], &copies.dir.display()),
            set(&["output_path"], &output.display()),
            self.seed(rung),
        ];
        if rung.loose_mapper {
            settings.extend([
                set(&["Mapper.init_min_num_inliers"], &50),
                set(&["Mapper.init_min_tri_angle"], &4),
                set(&["Mapper.abs_pose_min_num_inliers"], &15),
                set(&["Mapper.abs_pose_min_inlier_ratio"], &0.15),
                set(&["Mapper.min_model_size"], &MIN_VIEWS),
            ]);
        }
        let finished = self.prober.run("mapper", &settings, cancel)?;
        let found_nothing = || {
            finished
                .text()
                .to_ascii_lowercase()
                .contains("failed to create sparse model")
        };
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
        if finished.status.success() {
            Ok(())
        } else {
            Err(finished.failure(command))
        }
    }

    fn accepts(&self, model: &SparseModel) -> bool {
        let (registered, total) = (model.images.len() as f64, self.request.views.len() as f64);
        // Of fewer than ten photographs a point cannot be seen by many: 2 for two of them.
        let track = self
            .acceptance
            .track
            .min(2.0 + (self.acceptance.track - 2.0) * (total - 2.0) / 8.0);
        registered >= self.acceptance.registered * total
            && model.observations() as f64 >= self.acceptance.observations * registered
            && model.mean_track().is_some_and(|mean| mean >= track)
    }

    /// The poses of a candidate, in the request's order and at the originals' sizes.
    fn deliver(&self, best: &Candidate) -> Result<Poses, PosesError> {
        let (registered, total) = (best.model.images.len(), self.request.views.len());
        let least = (self.acceptance.salvage * total as f64).max(MIN_VIEWS as f64);
        if !best.accepted && (registered as f64) < least {
            return Err(self.too_few(registered));
        }
        let mut views = Vec::new();
        for (view, copy) in self.request.views.iter().zip(&best.copies.copies) {
            let Some(image) = best
                .model
                .images
                .iter()
                .find(|image| image.name == copy.file)
            else {
                continue;
            };
            let lens = best.model.camera_of(image).lens();
            let (width, height) = copy.original;
            let lens = Lens {
                intrinsics: lens.intrinsics.resized(width, height),
                ..lens
            };
            let camera = Camera {
                intrinsics: lens.pinhole(),
                world_to_camera: image.world_to_camera(),
            };
            views.push(PosedView {
                name: view.name.clone(),
                camera,
                lens,
            });
        }
        self.runner.note(&format!("[rung {} taken]", best.rung));
        Ok(Poses {
            registered: views.len(),
            views,
            points: best.model.sparse_points(),
            total,
            source: String::new(),
            rung: Some(best.rung),
            mean_reprojection_error: best.model.mean_error(),
            mean_track: best.model.mean_track(),
            low_confidence: !best.accepted,
            network: None,
            seconds: 0.0,
        })
    }

    fn too_few(&self, registered: usize) -> PosesError {
        let advice =
            "take 20 to 60 photographs with large overlap, moving the camera sideways between \
                      them; hold it still, add light, and include things with texture"
                .to_owned();
        PosesError::TooFew {
            registered,
            total: self.request.views.len(),
            advice,
        }
    }
}

/// COLMAP numbers its models as it starts them: the first is not always the largest.
fn largest_model(output: &Path) -> Result<Option<SparseModel>, PosesError> {
    let entries = std::fs::read_dir(output).map_err(PosesError::io(output))?;
    let mut dirs: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|dir| SparseModel::stands_in(dir))
        .collect();
    dirs.sort();
    let models = dirs
        .iter()
        .map(|dir| SparseModel::read(dir))
        .collect::<Result<Vec<_>, _>>()?;
    let ranked = models.into_iter().filter(|model| !model.images.is_empty());
    Ok(ranked.max_by_key(|model| (model.images.len(), model.points.len())))
}

pub(super) fn remove_if_there(file: &Path) -> Result<(), PosesError> {
    for suffix in ["", "-wal", "-shm", "-journal"] {
        let path = PathBuf::from(format!("{}{suffix}", file.display()));
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(PosesError::io(&path)(error));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Progress in thirds of a rung; the total grows with each rung that is needed.
fn advance(sink: &mut dyn ProgressSink, letter: char, part: u64) {
    let rungs_before = LADDER
        .iter()
        .take_while(|rung| rung.letter != letter)
        .count() as u64;
    let (done, total) = (3 * rungs_before + part, 3 * (rungs_before + 1));
    sink.event(&Event::StageAdvanced {
        stage: Stage::Poses,
        round: 0,
        done,
        total,
        steps_per_second: None,
    });
}
