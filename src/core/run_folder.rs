//! The folder that a run leaves: where everything in it lies, and from where one may look at it.
//!
//! ```text
//! scene.ply  cameras.json  metrics.json  config.json  poses.json  log.txt
//! inputs/VIEW.jpg  gt/VIEW.jpg  restored/VIEW.png
//! rounds/ROUND/{scene.ply, scene_at_target.ply, training.json}
//! rounds/ROUND/{enhanced, deblurred, renders}/VIEW.jpg
//! work/  what only a resumed run reads
//! ```
//! Paths only: nothing here reads, writes or makes a file.

use std::path::{Path, PathBuf};

use crate::camera::orbit::Orbit;
use crate::camera::{Camera, Intrinsics, NamedCamera};

/// Name of the folder of what only a resumed run reads.
const WORK: &str = "work";

/// The output folder of one run. Cheap to clone; holds a path only.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFolder {
    root: PathBuf,
}

impl RunFolder {
    /// The folder at `root`, whether it exists or not.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The delivered scene: of the best round, at the target brightness.
    pub fn scene(&self) -> PathBuf {
        self.root.join("scene.ply")
    }

    /// The scene of a round, or the delivered one.
    pub fn scene_of(&self, round: Option<u32>) -> PathBuf {
        match round {
            Some(round) => self.round(round).scene(),
            None => self.scene(),
        }
    }

    /// Every registered view's corrected camera, a list of [`NamedCamera`].
    pub fn cameras(&self) -> PathBuf {
        self.root.join("cameras.json")
    }

    /// The report, rewritten after every round.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.json")
    }

    /// The options of the run, complete.
    pub fn config(&self) -> PathBuf {
        self.root.join("config.json")
    }

    /// What structure from motion said, before any correction.
    pub fn poses(&self) -> PathBuf {
        self.root.join("poses.json")
    }

    /// The log of every run into this folder, appended to.
    pub fn log(&self) -> PathBuf {
        self.root.join("log.txt")
    }

    /// Folder of the dark views as they entered the pipeline.
    pub fn inputs(&self) -> PathBuf {
        self.root.join("inputs")
    }

    /// A dark view, JPEG.
    pub fn input(&self, view: &str) -> PathBuf {
        self.inputs().join(format!("{view}.jpg"))
    }

    /// Folder of the ground truth, where the capture brings one.
    pub fn truths(&self) -> PathBuf {
        self.root.join("gt")
    }

    /// A view's ground truth, JPEG.
    pub fn truth(&self, view: &str) -> PathBuf {
        self.truths().join(format!("{view}.jpg"))
    }

    /// Folder of the renders of the best round so far, at the target brightness.
    pub fn restored(&self) -> PathBuf {
        self.root.join("restored")
    }

    /// A view restored: rendered from the best round so far, at the target brightness; PNG.
    pub fn restored_view(&self, view: &str) -> PathBuf {
        self.restored().join(format!("{view}.png"))
    }

    /// What a round leaves; rounds are 1-based.
    pub fn round(&self, round: u32) -> RoundFolder {
        RoundFolder {
            root: self.root.join("rounds").join(round.to_string()),
        }
    }

    /// What only a resumed run reads.
    pub fn work(&self) -> WorkFolder {
        WorkFolder {
            root: self.root.join(WORK),
        }
    }

    /// Whether a file of this name, relative to the folder and with `/`, is part of the result: it
    /// lies below the folder, is not for a resumed run only, and no part of its name begins with a
    /// dot, as those of unfinished and temporary files do.
    pub fn is_public(name: &str) -> bool {
        let is_plain = |part: &str| {
            let is_hidden_or_up = part.is_empty() || part.starts_with('.');
            !is_hidden_or_up && !part.contains(['\\', '\0'])
        };
        name.split('/').next() != Some(WORK) && name.split('/').all(is_plain)
    }
}

/// The pictures of every view that a round leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RoundPictures {
    /// H: the dark views after the round's tone curve.
    Enhanced,
    /// D: the enhanced views after the deblurring network.
    Deblurred,
    /// R: the scene seen from the views' cameras.
    Renders,
}

impl RoundPictures {
    /// All of them, in the order in which a round makes them.
    pub const ALL: [Self; 3] = [Self::Enhanced, Self::Deblurred, Self::Renders];

    /// Name of their folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Enhanced => "enhanced",
            Self::Deblurred => "deblurred",
            Self::Renders => "renders",
        }
    }
}

/// The folder of one round.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RoundFolder {
    root: PathBuf,
}

impl RoundFolder {
    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The scene at the round's own brightness.
    pub fn scene(&self) -> PathBuf {
        self.root.join("scene.ply")
    }

    /// The scene at the target brightness; the last round has none, it is there already.
    pub fn scene_at_target(&self) -> PathBuf {
        self.root.join("scene_at_target.ply")
    }

    /// What training found out besides the scene.
    pub fn training(&self) -> PathBuf {
        self.root.join("training.json")
    }

    /// Folder of one kind of pictures.
    pub fn pictures(&self, kind: RoundPictures) -> PathBuf {
        self.root.join(kind.name())
    }

    /// A view's picture of this kind, JPEG.
    pub fn picture(&self, kind: RoundPictures, view: &str) -> PathBuf {
        self.pictures(kind).join(format!("{view}.jpg"))
    }
}

/// What a network made of every view, kept in full precision until the run has ended well.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KeptImages {
    /// The dark views, brightened by a network; round 0.
    Brightened,
    /// The enhanced views of a round, deblurred.
    Deblurred,
}

impl KeptImages {
    /// Name of their folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Brightened => "brightened",
            Self::Deblurred => "deblurred",
        }
    }
}

/// The folder of what only a resumed run reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkFolder {
    root: PathBuf,
}

impl WorkFolder {
    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where a zipped capture is unpacked.
    pub fn capture(&self) -> PathBuf {
        self.root.join("capture")
    }

    /// Where structure from motion works.
    pub fn poses(&self) -> PathBuf {
        self.root.join("poses")
    }

    /// Where it works on deblurred copies.
    pub fn poses_of_deblurred(&self) -> PathBuf {
        self.poses().join("deblurred")
    }

    /// Says that the stage of this name is finished, and for which inputs.
    pub fn stamp(&self, stage: &str) -> PathBuf {
        self.root.join("stamps").join(format!("{stage}.json"))
    }

    /// The interrupted training.
    pub fn checkpoint(&self) -> PathBuf {
        self.root.join("training.checkpoint")
    }

    /// A view's kept image, planar `f32`.
    pub fn kept(&self, images: KeptImages, round: u32, view: &str) -> PathBuf {
        self.root
            .join(images.name())
            .join(round.to_string())
            .join(format!("{view}.f32"))
    }

    /// What goes when a run has ended well: the large files and folders among these.
    pub fn disposable(&self) -> [PathBuf; 3] {
        [
            self.root.join(KeptImages::Deblurred.name()),
            self.root.join(KeptImages::Brightened.name()),
            self.checkpoint(),
        ]
    }
}

/// From where a picture of the scene is asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Viewpoint {
    /// From the camera of the view of this name.
    View(String),
    /// From an orbit around the scene; see [`Orbit::camera`].
    Orbit {
        /// Degrees to the right of the middle of the photographers.
        azimuth: f64,
        /// Degrees above them.
        elevation: f64,
        /// Times their median distance from the centre, 0.01..=100.
        distance: f64,
    },
    /// From a camera of the asker's own.
    Pose(Camera),
}

/// Why a viewpoint is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ViewpointError {
    /// The run has no view of this name.
    #[error("no view `{name}`; there are {known}")]
    UnknownView {
        /// As asked for.
        name: String,
        /// Those that the run has.
        known: String,
    },
    /// The run's cameras say nothing about where the scene is.
    #[error("the cameras of this run span no orbit")]
    NoOrbit,
    /// A number of the orbit is infinite or none.
    #[error("`{0}` is no finite number")]
    NotFinite(&'static str),
    /// The orbit is too near or too far.
    #[error("`distance` is not in 0.01..=100")]
    Distance,
}

/// The size that is asked for, px. A side that is not given follows the view's proportions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PictureSize {
    /// px.
    pub width: Option<usize>,
    /// px.
    pub height: Option<usize>,
}

impl From<Option<(usize, usize)>> for PictureSize {
    fn from(sides: Option<(usize, usize)>) -> Self {
        Self {
            width: sides.map(|(width, _)| width),
            height: sides.map(|(_, height)| height),
        }
    }
}

impl PictureSize {
    /// Width and height of a picture of what a camera of size `own` sees.
    fn resolve(self, own: &Intrinsics) -> (usize, usize) {
        let in_proportion = |side: usize, this: usize, other: usize| {
            let scaled = side as f64 * other as f64 / this as f64;
            (scaled.round() as usize).max(1)
        };
        match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, in_proportion(width, own.width, own.height)),
            (None, Some(height)) => (in_proportion(height, own.height, own.width), height),
            (None, None) => (own.width, own.height),
        }
    }
}

impl Viewpoint {
    /// The camera of a picture of this size, of the scene whose views have these cameras. Pixels
    /// stay as square as the photograph's: in a picture of other proportions all that the
    /// photograph sees is seen, and more beside it.
    ///
    /// # Errors
    /// [`ViewpointError`].
    pub fn camera(
        &self,
        cameras: &[NamedCamera],
        size: PictureSize,
    ) -> Result<Camera, ViewpointError> {
        match self {
            Self::View(name) => {
                let view = cameras.iter().find(|camera| camera.name == *name);
                let view = view.ok_or_else(|| unknown(name, cameras))?;
                Ok(fitted(&view.camera(), size))
            }
            Self::Pose(camera) => Ok(fitted(camera, size)),
            Self::Orbit {
                azimuth,
                elevation,
                distance,
            } => {
                let azimuth = finite("azimuth", *azimuth)?;
                let elevation = finite("elevation", *elevation)?;
                let distance = finite("distance", *distance)?;
                if !(0.01..=100.0).contains(&distance) {
                    return Err(ViewpointError::Distance);
                }
                let first = cameras.first().ok_or(ViewpointError::NoOrbit)?;
                let orbit = Orbit::from_cameras(cameras).ok_or(ViewpointError::NoOrbit)?;
                let sides = size.resolve(&first.intrinsics);
                Ok(orbit.camera(azimuth, elevation, distance, sides))
            }
        }
    }
}

fn unknown(name: &str, cameras: &[NamedCamera]) -> ViewpointError {
    let known: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    ViewpointError::UnknownView {
        name: name.to_owned(),
        known: known.join(", "),
    }
}

fn finite(name: &'static str, value: f64) -> Result<f64, ViewpointError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(ViewpointError::NotFinite(name))
    }
}

/// The same pose in a picture of another size: one scale for both axes, so that all of the field of
/// view is seen, and the principal point as far from the middle as it was.
fn fitted(camera: &Camera, size: PictureSize) -> Camera {
    let own = &camera.intrinsics;
    let (width, height) = size.resolve(own);
    if (width, height) == (own.width, own.height) {
        return *camera;
    }
    let scale = (width as f64 / own.width as f64).min(height as f64 / own.height as f64);
    let (right, down) = (
        own.cx - own.width as f64 / 2.0,
        own.cy - own.height as f64 / 2.0,
    );
    let intrinsics = Intrinsics {
        width,
        height,
        fx: own.fx * scale,
        fy: own.fy * scale,
        cx: width as f64 / 2.0 + right * scale,
        cy: height as f64 / 2.0 + down * scale,
    };
    Camera {
        intrinsics,
        ..*camera
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::camera::Split;

    fn cameras() -> Vec<NamedCamera> {
        let intrinsics = Intrinsics {
            width: 200,
            height: 100,
            fx: 150.0,
            fy: 150.0,
            cx: 104.0,
            cy: 47.0,
        };
        let camera = |x: f64| {
            let eye = DVec3::new(x, -0.2, -4.0);
            Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y)
        };
        ["a", "b", "c"]
            .into_iter()
            .zip([-1.0, 0.0, 1.0])
            .map(|(name, x)| NamedCamera::new(name, &camera(x), Split::Train))
            .collect()
    }

    fn everywhere() -> [Viewpoint; 3] {
        let orbit = Viewpoint::Orbit {
            azimuth: 10.0,
            elevation: 5.0,
            distance: 1.0,
        };
        let pose = Viewpoint::Pose(cameras()[2].camera());
        [Viewpoint::View("b".to_owned()), orbit, pose]
    }

    #[test]
    fn every_file_lies_where_readers_of_a_result_look_for_it() {
        let run = RunFolder::new("out");
        let round = run.round(2);
        let work = run.work();
        let paths = [
            (run.scene_of(None), "out/scene.ply"),
            (run.scene_of(Some(2)), "out/rounds/2/scene.ply"),
            (run.cameras(), "out/cameras.json"),
            (run.metrics(), "out/metrics.json"),
            (run.config(), "out/config.json"),
            (run.poses(), "out/poses.json"),
            (run.log(), "out/log.txt"),
            (run.input("a"), "out/inputs/a.jpg"),
            (run.truth("a"), "out/gt/a.jpg"),
            (run.restored_view("a"), "out/restored/a.png"),
            (round.scene_at_target(), "out/rounds/2/scene_at_target.ply"),
            (round.training(), "out/rounds/2/training.json"),
            (
                round.picture(RoundPictures::Enhanced, "a"),
                "out/rounds/2/enhanced/a.jpg",
            ),
            (
                round.picture(RoundPictures::Deblurred, "a"),
                "out/rounds/2/deblurred/a.jpg",
            ),
            (
                round.picture(RoundPictures::Renders, "a"),
                "out/rounds/2/renders/a.jpg",
            ),
            (work.stamp("poses"), "out/work/stamps/poses.json"),
            (work.checkpoint(), "out/work/training.checkpoint"),
            (
                work.kept(KeptImages::Deblurred, 1, "a"),
                "out/work/deblurred/1/a.f32",
            ),
        ];
        for (path, expected) in paths {
            assert_eq!(path, Path::new(expected));
        }
    }

    #[test]
    fn work_hidden_files_and_ways_out_are_not_public() {
        for name in ["scene.ply", "rounds/1/renders/a b.jpg", "inputs/work.jpg"] {
            assert!(RunFolder::is_public(name), "{name}");
        }
        let private = [
            "work/stamps/poses.json",
            "work",
            ".scene.ply.tmp",
            "rounds/.1/scene.ply",
            "../scene.ply",
            "rounds/../../secret",
            "/etc/passwd",
            "rounds//1",
            "",
            "a\\b",
            "a\0b",
        ];
        for name in private {
            assert!(!RunFolder::is_public(name), "{name:?}");
        }
    }

    #[test]
    fn a_picture_of_other_proportions_keeps_its_pixels_square_and_sees_all_of_the_view() {
        for viewpoint in everywhere() {
            for (width, height) in [(50, 50), (400, 100), (64, 333)] {
                let size = PictureSize::from(Some((width, height)));
                let camera = viewpoint.camera(&cameras(), size).expect("a camera");
                let k = camera.intrinsics;
                assert_eq!((k.width, k.height), (width, height), "{viewpoint:?}");
                assert_eq!(k.fx, k.fy, "{viewpoint:?} at {width}x{height}");
                // Whichever side is short keeps the photograph's field of view; the other grows.
                let own = [200.0 / 150.0, 100.0 / 150.0];
                let seen = [width as f64 / k.fx, height as f64 / k.fy];
                let grown = [seen[0] / own[0], seen[1] / own[1]];
                assert!((grown[0].min(grown[1]) - 1.0).abs() < 1e-12, "{grown:?}");
            }
        }
    }

    #[test]
    fn without_a_size_a_view_is_its_own_camera_and_one_side_gives_the_other() {
        let view = Viewpoint::View("b".to_owned());
        let own = cameras()[1].camera();
        let camera = |size| view.camera(&cameras(), size).expect("a camera");
        assert_eq!(camera(PictureSize::default()), own);
        let width_only = PictureSize {
            width: Some(100),
            height: None,
        };
        assert_eq!(camera(width_only), own.resized(100, 50));
        let height_only = PictureSize {
            width: None,
            height: Some(200),
        };
        assert_eq!(camera(height_only), own.resized(400, 200));
    }

    #[test]
    fn what_is_no_viewpoint_says_why() {
        let cameras = cameras();
        let why = |viewpoint: Viewpoint, cameras: &[NamedCamera]| {
            viewpoint
                .camera(cameras, PictureSize::default())
                .expect_err("no camera")
        };
        let orbit = |azimuth: f64, distance: f64| Viewpoint::Orbit {
            azimuth,
            elevation: 0.0,
            distance,
        };
        assert_eq!(
            why(Viewpoint::View("d".to_owned()), &cameras).to_string(),
            "no view `d`; there are a, b, c"
        );
        assert_eq!(why(orbit(0.0, 1.0), &[]), ViewpointError::NoOrbit);
        assert_eq!(
            why(orbit(f64::NAN, 1.0), &cameras),
            ViewpointError::NotFinite("azimuth")
        );
        assert_eq!(why(orbit(0.0, 0.0), &cameras), ViewpointError::Distance);
    }
}
