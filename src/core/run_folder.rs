//! The output folder of a run: the paths in it, and the viewpoints for its pictures.
//!
//! ```text
//! scene.ply  cameras.json  metrics.json  config.json  poses.json  poses.svg  log.txt
//! inputs/VIEW.jpg  gt/VIEW.jpg  restored/VIEW.png
//! rounds/ROUND/{scene.ply, scene_at_target.ply, training.json}
//! rounds/ROUND/{enhanced, deblurred, renders}/VIEW.jpg
//! evaluation/  scores against sharp photographs, after `fled eval`
//! work/  only for resumed runs
//! ```
//! Paths only: nothing here reads, writes or creates a file.

mod viewpoint;

use std::path::{Path, PathBuf};

pub use viewpoint::{PictureSize, Viewpoint, ViewpointError, view_named};

/// Name of the file with the matches of an interrupted search for poses.
pub const KEPT_MATCHES: &str = "matches.kept";

/// Name of the folder for resumed runs only.
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

    /// The delivered scene: the delivered round's, at the target brightness.
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

    /// Every registered view's corrected camera, a list of
    /// [`crate::camera::NamedCamera`].
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

    /// The result of structure from motion, before any correction, and which views joined or left
    /// since.
    pub fn poses(&self) -> PathBuf {
        self.root.join("poses.json")
    }

    /// A picture of the poses: cameras and points from above.
    pub fn poses_picture(&self) -> PathBuf {
        self.root.join("poses.svg")
    }

    /// The log of every run into this folder, appended to.
    pub fn log(&self) -> PathBuf {
        self.root.join("log.txt")
    }

    /// The evaluation of the run against sharp photographs.
    pub fn evaluation(&self) -> PathBuf {
        self.root.join("evaluation")
    }

    /// Folder of the dark views as they entered the pipeline.
    pub fn inputs(&self) -> PathBuf {
        self.root.join("inputs")
    }

    /// A dark view, JPEG.
    pub fn input(&self, view: &str) -> PathBuf {
        self.inputs().join(format!("{view}.jpg"))
    }

    /// Folder of the ground truth, if the capture has one.
    pub fn truths(&self) -> PathBuf {
        self.root.join("gt")
    }

    /// A view's ground truth, JPEG.
    pub fn truth(&self, view: &str) -> PathBuf {
        self.truths().join(format!("{view}.jpg"))
    }

    /// Folder of the renders of the latest deliverable round, at the target brightness.
    pub fn restored(&self) -> PathBuf {
        self.root.join("restored")
    }

    /// A restored view: rendered from the latest deliverable round, at the target brightness; PNG.
    pub fn restored_view(&self, view: &str) -> PathBuf {
        self.restored().join(format!("{view}.png"))
    }

    /// The output of a round; rounds are 1-based.
    pub fn round(&self, round: u32) -> RoundFolder {
        RoundFolder { root: self.root.join("rounds").join(round.to_string()) }
    }

    /// The files for resumed runs only.
    pub fn work(&self) -> WorkFolder {
        WorkFolder { root: self.root.join(WORK) }
    }

    /// Whether a file with this name, relative to the folder and with `/`, is part of the result:
    /// it is below the folder, is not only for resumed runs, and no part of its name begins with a
    /// dot, as in unfinished and temporary files.
    pub fn is_public(name: &str) -> bool {
        let is_plain = |part: &str| {
            let is_hidden_or_up = part.is_empty() || part.starts_with('.');
            !is_hidden_or_up && !part.contains(['\\', '\0'])
        };
        name.split('/').next() != Some(WORK) && name.split('/').all(is_plain)
    }
}

/// The pictures of every view that a round writes.
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

    /// The scene at the target brightness; not for the last round, whose scene already has it.
    pub fn scene_at_target(&self) -> PathBuf {
        self.root.join("scene_at_target.ply")
    }

    /// The cameras of the round's views, as corrected by training.
    pub fn cameras(&self) -> PathBuf {
        self.root.join("cameras.json")
    }

    /// The poses for the rounds after this one, if its scene changed them; normalised.
    pub fn late_views(&self) -> PathBuf {
        self.root.join("late_views.json")
    }

    /// The results of training besides the scene.
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

/// A network's output for every view, kept in full precision until the run succeeds.
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

/// The folder of the files for resumed runs only.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkFolder {
    root: PathBuf,
}

impl WorkFolder {
    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The prepared capture.
    pub fn prepared(&self) -> PathBuf {
        self.root.join("prepared")
    }

    /// The working folder of structure from motion.
    pub fn poses(&self) -> PathBuf {
        self.root.join("poses")
    }

    /// The result of structure from motion.
    pub fn found_poses(&self) -> PathBuf {
        self.poses().join("found.json")
    }

    /// Pictures in which late views are searched for.
    pub fn late_views(&self) -> PathBuf {
        self.root.join("late_views")
    }

    /// The working folder of structure from motion on deblurred copies.
    pub fn poses_of_deblurred(&self) -> PathBuf {
        self.poses().join("deblurred")
    }

    /// The version of the code that began the run.
    pub fn code_version(&self) -> PathBuf {
        self.root.join("code_version.json")
    }

    /// The decisions about a run with a time limit.
    pub fn minutes(&self) -> PathBuf {
        self.root.join("minutes.json")
    }

    /// Marks the stage with this name as finished, with its inputs.
    pub fn stamp(&self, stage: &str) -> PathBuf {
        self.stamps().join(format!("{stage}.json"))
    }

    /// The marks of finished stages.
    pub fn stamps(&self) -> PathBuf {
        self.root.join("stamps")
    }

    /// The interrupted training.
    pub fn checkpoint(&self) -> PathBuf {
        self.root.join("training.checkpoint")
    }

    /// The current look of the scene in training, JPEG; exists only during training.
    pub fn live_picture(&self) -> PathBuf {
        self.root.join("training.jpg")
    }

    /// A view's kept image, planar `f32`.
    pub fn kept(&self, images: KeptImages, round: u32, view: &str) -> PathBuf {
        self.root.join(images.name()).join(round.to_string()).join(format!("{view}.f32"))
    }

    /// The files and folders deleted when a run succeeds: the large ones of these.
    pub fn disposable(&self) -> [PathBuf; 7] {
        [
            self.prepared(),
            // Where builds before CODE_VERSION 10 prepared and unpacked it.
            self.root.join("capture"),
            self.root.join(KeptImages::Deblurred.name()),
            self.root.join(KeptImages::Brightened.name()),
            self.late_views(),
            self.poses().join(KEPT_MATCHES),
            self.checkpoint(),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{Capture, is_of_a_run};
    use crate::image::{Image, Srgb};
    use crate::pipeline::config::Options;

    #[test]
    fn a_result_inside_a_capture_is_recognised_by_its_configuration() {
        let dir = tempfile::tempdir().expect("a folder");
        let inputs = dir.path().join("out/inputs");
        std::fs::create_dir_all(&inputs).expect("made");
        let mut image: Image<Srgb> = Image::new(96, 64);
        for (at, folder) in [dir.path(), dir.path(), dir.path(), &inputs].into_iter().enumerate() {
            image.data_mut().iter_mut().zip(0..).for_each(|(value, i)| {
                *value = f32::from((i * (at + 3) % 97) as u8) / 97.0;
            });
            image.save(&folder.join(format!("{at}.png"))).expect("written");
        }
        let options = serde_json::to_vec_pretty(&Options::default()).expect("JSON");
        std::fs::write(dir.path().join("out/config.json"), options).expect("written");
        let capture = Capture::open(dir.path(), &dir.path().join(".scratch"));
        assert_eq!(capture.expect("a capture").photographs.len(), 3);
    }

    #[test]
    fn files_have_the_published_paths() {
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
            (run.poses_picture(), "out/poses.svg"),
            (run.log(), "out/log.txt"),
            (run.evaluation(), "out/evaluation"),
            (run.input("a"), "out/inputs/a.jpg"),
            (run.truth("a"), "out/gt/a.jpg"),
            (run.restored_view("a"), "out/restored/a.png"),
            (round.scene_at_target(), "out/rounds/2/scene_at_target.ply"),
            (round.cameras(), "out/rounds/2/cameras.json"),
            (round.late_views(), "out/rounds/2/late_views.json"),
            (round.training(), "out/rounds/2/training.json"),
            (round.picture(RoundPictures::Enhanced, "a"), "out/rounds/2/enhanced/a.jpg"),
            (round.picture(RoundPictures::Deblurred, "a"), "out/rounds/2/deblurred/a.jpg"),
            (round.picture(RoundPictures::Renders, "a"), "out/rounds/2/renders/a.jpg"),
            (work.stamp("poses"), "out/work/stamps/poses.json"),
            (work.found_poses(), "out/work/poses/found.json"),
            (work.late_views(), "out/work/late_views"),
            (work.checkpoint(), "out/work/training.checkpoint"),
            (work.live_picture(), "out/work/training.jpg"),
            (work.kept(KeptImages::Deblurred, 1, "a"), "out/work/deblurred/1/a.f32"),
        ];
        for (path, expected) in paths {
            assert_eq!(path, Path::new(expected));
            let name = expected.strip_prefix("out/").expect("below the folder");
            assert!(is_of_a_run(name) || name == "gt/a.jpg", "{name}");
        }
        assert!(!is_of_a_run("images/a.jpg") && !is_of_a_run("a.jpg"));
    }

    #[test]
    fn work_hidden_and_outside_files_are_not_public() {
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
}
