//! Poses from whoever finds them, and rung F of COLMAP's ladder: once more, on deblurred
//! photographs.

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
        let unguided = self
            .tools
            .deblurrer
            .unguided()
            .unwrap_or_else(|| self.tools.deblurrer.describe());
        // 0: nothing would be deblurred.
        if given || !weak || unguided.channels == 0 {
            return Ok(first?);
        }
        self.sink.log(format!(
            "poses: rung {RUNG}, the ladder once more on deblurred photographs"
        ));
        let second = self.poses_of_deblurred(&views, &work_dir.join("deblurred"))?;
        Ok(better(first, second, self.sink)?)
    }

    fn ask(&mut self, views: &[PoseView], work_dir: &Path) -> Result<Poses, PosesError> {
        let request = PoseRequest {
            views,
            work_dir,
            seed: self.options.seed,
        };
        self.tools.sfm.poses(&request, self.sink, self.cancel)
    }

    /// Poses by way of brightened, deblurred copies of the photographs; at the originals' sizes.
    fn poses_of_deblurred(
        &mut self,
        views: &[PoseView],
        folder: &Path,
    ) -> Result<Result<Poses, PosesError>, PipelineError> {
        let photograph = |view: &PoseView| {
            Image::load_at_most(&view.file, LONGEST_SIDE).map_err(|source| {
                PipelineError::Photograph {
                    name: view.name.clone(),
                    source,
                }
            })
        };
        let dark = views
            .iter()
            .map(photograph)
            .collect::<Result<Vec<_>, _>>()?;
        let target = enhance::resolve_target(&self.options.target, &Histogram::pooled(&dark))
            .map_err(|e| OptionsError {
                key: "target".to_owned(),
                message: e.to_string(),
            })?;
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
            let bytes = deblurred.encode(EncodeFormat::Png).map_err(|source| {
                PipelineError::Photograph {
                    name: view.name.clone(),
                    source,
                }
            })?;
            self.workspace.write(&file, &bytes)?;
            let (original, _) = upright_size(view)?;
            let focal_px = view
                .focal_px
                .map(|focal| focal * image.width() as f64 / original as f64);
            copies.push(PoseView {
                name: view.name.clone(),
                file,
                focal_px,
            });
        }
        let found = match self.ask(&copies, &folder.join("colmap")) {
            Ok(found) => found,
            Err(error) => return Ok(Err(error)),
        };
        let original = |posed: PosedView| -> Result<PosedView, PipelineError> {
            let Some(view) = views.iter().find(|view| view.name == posed.name) else {
                return Ok(posed);
            };
            let (width, height) = upright_size(view)?;
            let lens = Lens {
                intrinsics: posed.lens.intrinsics.resized(width, height),
                ..posed.lens
            };
            let camera = Camera {
                intrinsics: lens.pinhole(),
                ..posed.camera
            };
            Ok(PosedView {
                camera,
                lens,
                ..posed
            })
        };
        let views = found
            .views
            .into_iter()
            .map(original)
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Ok(Poses {
            views,
            rung: Some(RUNG),
            ..found
        }))
    }
}

fn upright_size(view: &PoseView) -> Result<(usize, usize), PipelineError> {
    let header = read_header(&view.file).map_err(|source| PipelineError::Photograph {
        name: view.name.clone(),
        source,
    })?;
    Ok((header.width, header.height))
}

/// Whether these are the poses that a run with any other network finds, too: the first look was
/// good enough.
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
            Ok(if rank(&second) > rank(&first) {
                second
            } else {
                first
            })
        }
        (Err(_), Ok(second)) => Ok(second),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::cancel::CancelToken;
    use crate::capture::Capture;
    use crate::deblur::{ByGuide, DeblurError, DeblurInfo, Deblurrer, Identity};
    use crate::event::{Event, ProgressSink, Silent};
    use crate::pipeline::config::Options;
    use crate::pipeline::{Tools, Workspace};
    use crate::poses::{Distortion, Sfm};

    /// Finds photographs only where they are bright; keeps the width, px, and the mean of each that
    /// it was asked about.
    #[derive(Default)]
    struct NeedsLight(RefCell<Vec<(usize, f32)>>);

    impl Sfm for NeedsLight {
        fn poses(
            &self,
            request: &PoseRequest<'_>,
            _: &mut dyn ProgressSink,
            _: &CancelToken,
        ) -> Result<Poses, PosesError> {
            let mut found = poses(request.views.len(), false, 'A');
            let mut darkest = f32::INFINITY;
            for view in request.views {
                let image = Image::load(&view.file).expect("a photograph");
                let mean = image.data().iter().sum::<f32>() / image.data().len() as f32;
                darkest = darkest.min(mean);
                self.0.borrow_mut().push((image.width(), mean));
                let (width, height) = (image.width(), image.height());
                let focal = width as f64;
                let (cx, cy) = (focal / 2.0, height as f64 / 2.0);
                let k = crate::camera::Intrinsics {
                    width,
                    height,
                    fx: focal,
                    fy: focal,
                    cx,
                    cy,
                };
                let camera = Camera::look_at(k, glam::DVec3::ZERO, glam::DVec3::Z, glam::DVec3::Y);
                let lens = Lens {
                    intrinsics: k,
                    distortion: Distortion::None,
                };
                found.views.push(PosedView {
                    name: view.name.clone(),
                    camera,
                    lens,
                });
            }
            if darkest < 0.3 {
                Err(few(1))
            } else {
                Ok(found)
            }
        }

        fn describe(&self) -> String {
            "needs light".to_owned()
        }
    }

    /// Returns a grey level, and says of each view that it did.
    struct Grey(f32, Vec<String>);

    impl Deblurrer for Grey {
        fn deblur(&mut self, blurry: &Image, _: Option<&Image>) -> Result<Image, DeblurError> {
            self.1.push(format!("is {} now", self.0));
            Ok(blurry.map(|_| self.0))
        }

        fn describe(&self) -> DeblurInfo {
            DeblurInfo {
                id: self.0.to_string(),
                channels: 3,
                ..Identity.describe()
            }
        }

        fn take_warnings(&mut self) -> Vec<String> {
            std::mem::take(&mut self.1)
        }
    }

    /// The answer, the warnings, and what was asked, for three dark photographs of 960 x 640 px.
    fn found_with(
        deblurrer: &mut dyn Deblurrer,
    ) -> (Result<Poses, PipelineError>, Vec<String>, NeedsLight) {
        let home = tempfile::tempdir().expect("temporary directory");
        let images = home.path().join("images");
        std::fs::create_dir(&images).expect("made");
        for (name, period) in [("a", 17), ("b", 19), ("c", 23)] {
            let mut image: Image = Image::new(960, 640);
            for (index, value) in image.data_mut().iter_mut().enumerate() {
                *value = 0.02 + 0.002 * (index % period) as f32;
            }
            image
                .save(&images.join(format!("{name}.png")))
                .expect("written");
        }
        let capture = Capture::open(home.path(), &home.path().join("scratch")).expect("a capture");
        let workspace = Workspace::open(&home.path().join("run")).expect("a workspace");
        let (sfm, mut warnings) = (NeedsLight::default(), Vec::new());
        let gpu = fled_gpu::Gpu::new("auto").expect("the tests need a Vulkan adapter");
        let mut tools = Tools {
            gpu: &gpu,
            sfm: &sfm,
            deblurrer,
            enhancer: None,
            fallbacks: Vec::new(),
            pose_cache: None,
        };
        let mut sink = |event: &Event| {
            if let Event::Warning { code, message } = event {
                warnings.push(format!("{code}: {message}"));
            }
        };
        let (options, cancel) = (Options::default(), CancelToken::new());
        let mut job = Job::new(
            &capture, &options, &mut tools, &workspace, &mut sink, &cancel,
        )
        .expect("a job");
        let found = job.find_poses();
        (found, warnings, sfm)
    }

    #[test]
    fn what_the_ladder_cannot_place_is_deblurred_once_and_asked_about_again() {
        let mut networks = ByGuide::new(
            Box::new(Grey(0.5, Vec::new())),
            Box::new(Grey(0.75, Vec::new())),
        );
        let (found, warnings, asked) = found_with(&mut networks);
        let found = found.expect("placed on bright copies");
        assert_eq!((found.rung, found.registered), (Some(RUNG), 3));
        let asked: Vec<_> = asked
            .0
            .into_inner()
            .iter()
            .map(|(width, mean)| (*width, *mean > 0.3))
            .collect();
        assert_eq!(
            asked,
            [
                (960, false),
                (960, false),
                (960, false),
                (640, true),
                (640, true),
                (640, true)
            ]
        );
        for view in &found.views {
            let k = view.camera.intrinsics;
            assert_eq!(
                (k.width, k.height, view.lens.intrinsics.fx),
                (960, 640, 960.0),
                "as the original"
            );
        }
        // Of the network that was used: none of these views has a guide.
        assert_eq!(
            warnings,
            ["a", "b", "c"].map(|name| format!("poses: {name}: is 0.5 now"))
        );
    }

    #[test]
    fn a_run_without_a_network_has_no_second_look() {
        let (found, _, asked) = found_with(&mut Identity);
        assert!(
            matches!(found, Err(PipelineError::Poses(PosesError::TooFew { .. }))),
            "{found:?}"
        );
        assert_eq!(asked.0.into_inner().len(), 3);
    }

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
        PosesError::TooFew {
            registered,
            total: 20,
            advice: String::new(),
        }
    }

    #[test]
    fn the_second_look_wins_only_where_it_is_better() {
        let rung = |first, second| better(first, second, &mut Silent).map(|poses| poses.rung);
        assert_eq!(
            rung(Ok(poses(12, true, 'C')), Ok(poses(18, true, 'F'))).ok(),
            Some(Some('F'))
        );
        assert_eq!(
            rung(Ok(poses(18, true, 'C')), Ok(poses(17, false, 'F'))).ok(),
            Some(Some('F'))
        );
        assert_eq!(
            rung(Ok(poses(18, true, 'C')), Ok(poses(18, true, 'F'))).ok(),
            Some(Some('C'))
        );
        assert_eq!(
            rung(Ok(poses(12, true, 'C')), Err(few(4))).ok(),
            Some(Some('C'))
        );
        assert_eq!(
            rung(Err(few(4)), Ok(poses(17, false, 'F'))).ok(),
            Some(Some('F'))
        );
        assert!(matches!(
            rung(Err(few(4)), Err(few(9))),
            Err(PosesError::TooFew { registered: 4, .. })
        ));
    }

    #[test]
    fn only_a_good_first_look_serves_every_network() {
        assert!(without_network(&poses(18, false, 'C')));
        assert!(
            !without_network(&poses(18, true, 'C')),
            "another network may lead to better ones"
        );
        assert!(!without_network(&poses(18, false, 'F')));
    }
}
