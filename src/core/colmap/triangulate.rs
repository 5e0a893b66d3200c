//! Sparse points for views with known poses: COLMAP's features and matches, triangulated.

use super::copies::{Copies, Kind};
use super::files::{empty, remove_if_there};
use super::options::{self, masks, set};
use super::search::Search;
use crate::cancel::CancelToken;
use crate::poses::model::{ModelCamera, ModelImage, SparseModel};
use crate::poses::{Lens, PoseView, PosedView, PosesError, SparsePoint};

impl Search<'_> {
    /// Points from the features of strategy A's copies of `posed` (a subset of the request's views,
    /// in its order) at their known poses; none if nothing matches.
    pub fn triangulate(
        &self,
        posed: &[PosedView],
        cancel: &CancelToken,
    ) -> Result<Vec<SparsePoint>, PosesError> {
        let of = |posed: &PosedView| {
            self.request.views.iter().find(|view| view.name == posed.name).cloned()
        };
        let views: Vec<PoseView> = posed.iter().filter_map(of).collect();
        let work = self.request.work_dir;
        let copies = Copies::write(&work.join("small"), &views, Kind::Small, cancel)?;
        let (known, output) = (work.join("known"), work.join("triangulated"));
        for folder in [&known, &output] {
            empty(folder)?;
        }
        known_model(posed, &copies).write_text(&known)?;
        let database = work.join("known.db");
        self.extract_known(&copies, &database, cancel)?;
        self.match_features(&copies, &database, cancel)?;
        let settings = [
            set(&["database_path"], &database.display()),
            set(&["image_path"], &copies.dir.display()),
            set(&["input_path"], &known.display()),
            set(&["output_path"], &output.display()),
        ];
        self.succeed("point_triangulator", &settings, cancel)?;
        Ok(SparseModel::read(&output)?.sparse_points())
    }

    /// Extracts features; each photograph has its own camera, with the lens from the model.
    fn extract_known(
        &self,
        copies: &Copies,
        database: &std::path::Path,
        cancel: &CancelToken,
    ) -> Result<(), PosesError> {
        remove_if_there(database)?;
        let mut settings = vec![
            set(&["database_path"], &database.display()),
            set(&["image_path"], &copies.dir.display()),
            set(&["ImageReader.camera_model"], &"PINHOLE"),
            set(&["ImageReader.single_camera"], &0),
            set(options::EXTRACT_USE_GPU, &0),
            // Several threads would number the photographs as they finish; the model must know the
            // numbers.
            set(options::EXTRACT_THREADS, &1),
        ];
        settings.extend(masks(copies));
        self.succeed("feature_extractor", &settings, cancel)
    }
}

/// The poses as a model without points, at the size of the copies. Identifiers follow the order of
/// the file names, as in the database.
fn known_model(posed: &[PosedView], copies: &Copies) -> SparseModel {
    let mut rows: Vec<_> = copies.copies.iter().zip(posed).collect();
    rows.sort_by(|a, b| a.0.file.cmp(&b.0.file));
    let numbered = || rows.iter().zip(1_u32..);
    SparseModel {
        cameras: numbered()
            .map(|((copy, view), id)| {
                let intrinsics = view.lens.intrinsics.resized(copy.size.0, copy.size.1);
                ModelCamera::of_lens(id, &Lens { intrinsics, ..view.lens })
            })
            .collect(),
        images: numbered()
            .map(|((copy, view), id)| ModelImage::posed(id, id, copy.file.clone(), &view.camera))
            .collect(),
        points: Vec::new(),
    }
}
