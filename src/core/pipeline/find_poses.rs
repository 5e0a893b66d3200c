//! Poses from whoever finds them, and rung F of COLMAP's ladder: once more, on deblurred photographs.

use std::path::Path;

use super::config::{OptionsError, PoseSource};
use super::error::PipelineError;
use super::job::Job;
use super::tone::Tone;
use crate::camera::Camera;
use crate::enhance::{self, Histogram};
use crate::image::{EncodeFormat, Image, read_header};
use crate::poses::{Lens, PoseRequest, PoseView, PosedView, Poses, PosesError};

/// Longest side of the photographs of rung F, px: that of rung A's copies.
const LONGEST_SIDE: usize = 640;
/// Name of the rung in results.
const RUNG: char = 'F';

impl Job<'_, '_> {
    pub(super) fn find_poses(&mut self) -> Result<Poses, PipelineError> {
        let view = |view: &crate::capture::CaptureView| PoseView {
            name: view.name.clone(),
            file: view.file.clone(),
            focal_px: view.focal_px,
        };
        let views: Vec<PoseView> = self.capture.views.iter().map(view).collect();
        let work_dir = self.workspace.work().join("poses");
        let first = self.ask(&views, &work_dir);
        let given = self.capture.poses.is_some() && self.options.pose_source != PoseSource::Colmap;
        let weak = match &first {
            Ok(poses) => poses.low_confidence,
            Err(PosesError::TooFew { .. }) => views.len() > 2,
            Err(_) => false,
        };
        let unguided = self.tools.deblurrer.unguided().unwrap_or_else(|| self.tools.deblurrer.describe());
        // 0: nothing would be deblurred.
        if given || !weak || unguided.channels == 0 {
            return Ok(first?);
        }
        self.sink.log(format!("poses: rung {RUNG}, the ladder once more on deblurred photographs"));
        let second = self.poses_of_deblurred(&views, &work_dir.join("deblurred"))?;
        Ok(better(first, second, self.sink)?)
    }

    fn ask(&mut self, views: &[PoseView], work_dir: &Path) -> Result<Poses, PosesError> {
        let request = PoseRequest { views, work_dir, seed: self.options.seed };
        self.tools.sfm.poses(&request, self.sink, self.cancel)
    }

    /// Poses by way of brightened, deblurred copies of the photographs; at the originals' sizes.
    fn poses_of_deblurred(
        &mut self,
        views: &[PoseView],
        folder: &Path,
    ) -> Result<Result<Poses, PosesError>, PipelineError> {
        let photograph = |view: &PoseView| {
            Image::load_at_most(&view.file, LONGEST_SIDE)
                .map_err(|source| PipelineError::Photograph { name: view.name.clone(), source })
        };
        let dark = views.iter().map(photograph).collect::<Result<Vec<_>, _>>()?;
        let target = enhance::resolve_target(&self.options.target, &Histogram::pooled(&dark))
            .map_err(|e| OptionsError { key: "target".to_owned(), message: e.to_string() })?;
        let bright = Tone::fit(self.options.lut_scope, &dark, &[target]).apply(&dark);
        self.workspace.make_folder(folder)?;
        let mut copies = Vec::with_capacity(views.len());
        for (index, (view, image)) in views.iter().zip(&bright).enumerate() {
            self.cancel.check()?;
            let file = folder.join(format!("d{index:05}.png"));
            let deblurred = self.tools.deblurrer.deblur(image, None)?;
            for warning in self.tools.deblurrer.take_warnings() {
                self.sink.warn("poses", format!("{}: {warning}", view.name));
            }
            let bytes = deblurred
                .encode(EncodeFormat::Png)
                .map_err(|source| PipelineError::Photograph { name: view.name.clone(), source })?;
            self.workspace.write(&file, &bytes)?;
            let (original, _) = upright_size(view)?;
            let focal_px = view.focal_px.map(|focal| focal * image.width() as f64 / original as f64);
            copies.push(PoseView { name: view.name.clone(), file, focal_px });
        }
        let found = match self.ask(&copies, &folder.join("colmap")) {
            Ok(found) => found,
            Err(error) => return Ok(Err(error)),
        };
        let original = |posed: PosedView| -> Result<PosedView, PipelineError> {
            let Some(view) = views.iter().find(|view| view.name == posed.name) else { return Ok(posed) };
            let (width, height) = upright_size(view)?;
            let lens = Lens { intrinsics: posed.lens.intrinsics.resized(width, height), ..posed.lens };
            let camera = Camera { intrinsics: lens.pinhole(), ..posed.camera };
            Ok(PosedView { camera, lens, ..posed })
        };
        let views = found.views.into_iter().map(original).collect::<Result<Vec<_>, _>>()?;
        Ok(Ok(Poses { views, rung: Some(RUNG), ..found }))
    }
}

fn upright_size(view: &PoseView) -> Result<(usize, usize), PipelineError> {
    let header = read_header(&view.file)
        .map_err(|source| PipelineError::Photograph { name: view.name.clone(), source })?;
    Ok((header.width, header.height))
}

/// Whether these are the poses that a run with any other network finds, too: the first look was good enough.
pub(super) fn without_network(poses: &Poses) -> bool {
    poses.rung != Some(RUNG) && !poses.low_confidence
}

/// The second answer where it places more photographs, or as many with more confidence.
fn better(
    first: Result<Poses, PosesError>,
    second: Result<Poses, PosesError>,
    sink: &mut dyn crate::event::ProgressSink,
) -> Result<Poses, PosesError> {
    match (first, second) {
        (_, Err(PosesError::Cancelled(cancelled))) => Err(cancelled.into()),
        (first, Err(error)) => {
            sink.log(format!("poses: rung {RUNG}: {error}"));
            first
        }
        (Ok(first), Ok(second)) => {
            let rank = |poses: &Poses| (!poses.low_confidence, poses.registered);
            Ok(if rank(&second) > rank(&first) { second } else { first })
        }
        (Err(_), Ok(second)) => Ok(second),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Silent;

    fn poses(registered: usize, low_confidence: bool, rung: char) -> Poses {
        Poses {
            views: Vec::new(),
            points: Vec::new(),
            registered,
            total: 20,
            source: String::new(),
            rung: Some(rung),
            mean_reprojection_error: None,
            mean_track: None,
            low_confidence,
            seconds: 0.0,
        }
    }

    fn few(registered: usize) -> PosesError {
        PosesError::TooFew { registered, total: 20, advice: String::new() }
    }

    #[test]
    fn the_second_look_wins_only_where_it_is_better() {
        let rung = |first, second| better(first, second, &mut Silent).map(|poses| poses.rung);
        assert_eq!(rung(Ok(poses(12, true, 'C')), Ok(poses(18, true, 'F'))).ok(), Some(Some('F')));
        assert_eq!(rung(Ok(poses(18, true, 'C')), Ok(poses(17, false, 'F'))).ok(), Some(Some('F')));
        assert_eq!(rung(Ok(poses(18, true, 'C')), Ok(poses(18, true, 'F'))).ok(), Some(Some('C')));
        assert_eq!(rung(Ok(poses(12, true, 'C')), Err(few(4))).ok(), Some(Some('C')));
        assert_eq!(rung(Err(few(4)), Ok(poses(17, false, 'F'))).ok(), Some(Some('F')));
        assert!(matches!(rung(Err(few(4)), Err(few(9))), Err(PosesError::TooFew { registered: 4, .. })));
    }

    #[test]
    fn only_a_good_first_look_serves_every_network() {
        assert!(without_network(&poses(18, false, 'C')));
        assert!(!without_network(&poses(18, true, 'C')), "another network may lead to better ones");
        assert!(!without_network(&poses(18, false, 'F')));
    }
}
