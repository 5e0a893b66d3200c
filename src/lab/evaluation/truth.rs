//! Sharp photographs with their own poses.

use std::path::Path;

use glam::DVec3;

use fled_core::camera::{Camera, Split};
use fled_core::cancel::CancelToken;
use fled_core::capture::{Capture, CaptureError, CaptureView, PREPARED_SIDE, masks_in};
use fled_core::event::Silent;
use fled_core::given_poses::GivenSfm;
use fled_core::image::Image;
use fled_core::mask::Mask;
use fled_core::pipeline::error::PipelineError;
use fled_core::pipeline::poses::pose_view;
use fled_core::pipeline::views::{self, working_size};
use fled_core::poses::align::Similarity;
use fled_core::poses::{Lens, PoseRequest, PoseView, PosedView, Poses, Sfm};

use super::error::EvaluationError;
use super::subject::Subject;

/// Minimum number of shared cameras needed to determine the similarity of two worlds.
const LEAST_TIED: usize = 3;

/// The photographs of a folder that have a pose in it, in natural order of their names.
pub struct Truth {
    views: Vec<(CaptureView, PosedView)>,
}

/// A sharp photograph at the run's size, undistorted, with its camera in the run's world.
pub(super) struct TruthView {
    pub(super) name: String,
    /// The photograph, sRGB.
    pub(super) photograph: Image,
    pub(super) camera: Camera,
}

/// A sharp photograph with lens and pose in the run's world.
pub(super) struct Placed<'a> {
    photograph: &'a CaptureView,
    posed: PosedView,
}

impl Placed<'_> {
    /// The camera at the working size.
    pub(super) fn camera(&self, size: usize) -> Camera {
        let k = &self.posed.camera.intrinsics;
        let (width, height) = working_size(k.width, k.height, size);
        self.posed.camera.resized(width, height)
    }

    /// The mask of the photograph at the working size: the pixels left by its masks in `folder`.
    ///
    /// # Errors
    /// [`EvaluationError::NoMask`]; a mask that cannot be read or has another shape.
    pub(super) fn mask(&self, folder: &Path, size: usize) -> Result<Mask, EvaluationError> {
        let path = &self.photograph.path;
        let fault = |error: CaptureError| EvaluationError::Pipeline(error.into());
        let mut all = masks_in(folder, std::slice::from_ref(path)).map_err(fault)?;
        let Some(pictures) = all.remove(path) else {
            return Err(EvaluationError::NoMask {
                path: folder.join(format!("{}.png", path.stem())),
            });
        };
        let k = self.camera(size).intrinsics;
        let undistorted = |shares: &Image<_>| self.posed.undistort(shares);
        let load = || {
            let mut all = Mask::full(k.width, k.height);
            for picture in pictures {
                all = all.and(&picture.load(self.photograph, (k.width, k.height), undistorted)?);
            }
            Ok(all)
        };
        load().map_err(|source| {
            let name = format!("the mask of {path}");
            EvaluationError::Pipeline(PipelineError::Photograph { name, source })
        })
    }

    /// The photograph at the working size.
    ///
    /// # Errors
    /// A photograph that cannot be read.
    pub(super) fn load(&self, size: usize) -> Result<TruthView, EvaluationError> {
        let view = views::view(self.photograph, &self.posed, Split::HeldOut, size)?;
        Ok(TruthView {
            name: view.name,
            photograph: view.gt.unwrap_or(view.dark),
            camera: view.camera,
        })
    }
}

/// The alignment of the truth's world to a run's.
pub(super) struct Tie {
    /// From the truth's world to the run's.
    pub(super) similarity: Similarity,
    /// Number of training views that both contain.
    pub(super) views: usize,
    /// Root mean square distance of their cameras, as a share of their extent.
    pub(super) error: f64,
}

impl Truth {
    /// Reads the poses of a folder of photographs, which are prepared under `scratch` for views of
    /// at most `size` px. If a photograph has a sharp one of the same name in `gt/` or `HL/`, the
    /// latter is the ground truth.
    ///
    /// # Errors
    /// [`EvaluationError::NoPoses`]; a folder that is not a capture, or poses that cannot be read.
    pub fn open(folder: &Path, scratch: &Path, size: usize) -> Result<Self, EvaluationError> {
        let fault = |error: CaptureError| EvaluationError::Pipeline(error.into());
        let side = PREPARED_SIDE.max(size);
        let capture = Capture::open_at(folder, scratch, side).map_err(fault)?;
        let no_poses = || EvaluationError::NoPoses { path: folder.to_owned() };
        let given = capture.poses.as_ref().ok_or_else(no_poses)?;
        let views: Vec<PoseView> = capture.views.iter().map(pose_view).collect();
        let request =
            PoseRequest { views: &views, work_dir: scratch, seed: 0, stamp: "", earlier: &[] };
        let poses = GivenSfm::new(given)
            .and_then(|given| given.poses(&request, &mut Silent, &CancelToken::default()))
            .map_err(PipelineError::from)?;
        Ok(Self::of(capture.views, &poses))
    }

    fn of(photographs: Vec<CaptureView>, poses: &Poses) -> Self {
        let posed = |view: CaptureView| {
            let mut all = poses.views.iter();
            let posed = all.find(|posed| posed.name == view.name)?.clone();
            Some((view, posed))
        };
        Self::new(photographs.into_iter().filter_map(posed).collect())
    }

    pub(super) fn new(views: Vec<(CaptureView, PosedView)>) -> Self {
        Self { views }
    }

    /// The similarity that maps the truth's cameras to those of a run.
    ///
    /// # Errors
    /// [`EvaluationError::NotTied`].
    pub(super) fn tie(&self, subject: &Subject) -> Result<Tie, EvaluationError> {
        let in_both = subject.training().filter_map(|(name, camera)| {
            let posed = self.posed(name)?;
            Some((posed.camera, camera))
        });
        let (here, there): (Vec<Camera>, Vec<Camera>) = in_both.unzip();
        let not_tied =
            || EvaluationError::NotTied { tied: here.len(), views: subject.training().count() };
        if here.len() < LEAST_TIED {
            return Err(not_tied());
        }
        let similarity = Similarity::between(&here, &there).ok_or_else(not_tied)?;
        let centre = there.iter().map(Camera::centre).sum::<DVec3>() / there.len() as f64;
        let extent = there.iter().map(|camera| camera.centre().distance(centre));
        let extent = extent.fold(0.0, f64::max).max(f64::MIN_POSITIVE);
        let away = here.iter().zip(&there).map(|(from, to)| {
            let apart = similarity.apply(from.centre()) - to.centre();
            apart.length_squared()
        });
        Ok(Tie {
            similarity,
            views: here.len(),
            error: (away.sum::<f64>() / here.len() as f64).sqrt() / extent,
        })
    }

    /// Names of the photographs not used in training; with `inside`, only those between two that
    /// were.
    pub(super) fn test_views(&self, subject: &Subject, inside: bool) -> Vec<&str> {
        let trained: Vec<bool> = self
            .views
            .iter()
            .map(|(view, _)| subject.training().any(|(name, _)| name == view.name))
            .collect();
        let first = trained.iter().position(|&trained| trained).unwrap_or(0);
        let last = trained.iter().rposition(|&trained| trained).unwrap_or(0);
        let rows = self.views.iter().zip(&trained).enumerate();
        rows.filter(|(index, (_, trained))| {
            !**trained && (!inside || (first..last).contains(index))
        })
        .map(|(_, ((view, _), _))| view.name.as_str())
        .collect()
    }

    /// The photographs of these names as the run would see them: undistorted with the lens that it
    /// found for the nearest training view, at the aligned pose. A run estimates distortion and
    /// depth together, so another lens, even the true one, would show a different scene.
    ///
    /// # Errors
    /// [`EvaluationError::NoLens`].
    pub(super) fn placed(
        &self,
        names: &[&str],
        subject: &Subject,
        tie: &Tie,
    ) -> Result<Vec<Placed<'_>>, EvaluationError> {
        let wanted = self.views.iter().filter(|(view, _)| names.contains(&view.name.as_str()));
        let place = |(photograph, posed): &'_ (CaptureView, PosedView)| {
            let camera = tie.similarity.camera(&posed.camera);
            let lens = subject.lens(subject.nearest(&camera))?;
            let lens = Lens {
                intrinsics: lens.intrinsics.resized(photograph.width, photograph.height),
                ..lens
            };
            let camera = Camera { intrinsics: lens.pinhole(), ..camera };
            let name = posed.name.clone();
            Ok::<_, EvaluationError>(PosedView { name, camera, lens })
        };
        let placed = wanted.map(|view| Ok(Placed { photograph: &view.0, posed: place(view)? }));
        placed.collect()
    }

    fn posed(&self, name: &str) -> Option<&PosedView> {
        let mut views = self.views.iter();
        views.find(|(view, _)| view.name == name).map(|(_, posed)| posed)
    }
}
