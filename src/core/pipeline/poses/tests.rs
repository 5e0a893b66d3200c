use std::cell::RefCell;

use super::*;
use crate::camera::{Camera, Intrinsics};
use crate::cancel::CancelToken;
use crate::capture::PreparedImage;
use crate::deblur::{DeblurError, Identity, Restorer, RestorerInfo};
use crate::event::{Event, Silent};
use crate::image::Image;
use crate::photo_path::PhotoPath;
use crate::pipeline::tools::Networks;
use crate::pipeline::workspace::Workspace;
use crate::poses::{Distortion, Lens, PoseRequest, PosedView, Sfm};

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
        let count = request.views.len();
        let mut found = Poses { total: count, ..placed(count, false, 'A') };
        let mut darkest = f32::INFINITY;
        for view in request.views {
            let image = view.prepared.load_at_most(usize::MAX).expect("an image");
            let mean = image.data().iter().sum::<f32>() / image.data().len() as f32;
            darkest = darkest.min(mean);
            self.0.borrow_mut().push((image.width(), mean));
            let (width, height) = (image.width(), image.height());
            let focal = width as f64;
            let (cx, cy) = (focal / 2.0, height as f64 / 2.0);
            let k = Intrinsics { width, height, fx: focal, fy: focal, cx, cy };
            let camera = Camera::look_at(k, glam::DVec3::ZERO, glam::DVec3::Z, glam::DVec3::Y);
            let lens = Lens { intrinsics: k, distortion: Distortion::None };
            found.views.push(PosedView { name: view.name.clone(), camera, lens });
        }
        if darkest < 0.3 { Err(few(1)) } else { Ok(found) }
    }

    fn describe(&self) -> String {
        "needs light".to_owned()
    }
}

/// Returns a grey level, and says of each view that it did.
struct Grey(f32, Vec<String>);

impl Restorer for Grey {
    fn restore(&mut self, blurry: &Image, _: Option<&Image>) -> Result<Image, DeblurError> {
        self.1.push(format!("is {} now", self.0));
        Ok(blurry.map(|_| self.0))
    }

    fn describe(&self) -> RestorerInfo {
        RestorerInfo { id: self.0.to_string(), channels: 3, ..Identity.describe() }
    }

    fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.1)
    }
}

/// The answer, the warnings, and what was asked, for three dark photographs of 960 x 640 px.
fn found_with(
    deblurrer: &mut dyn Restorer,
) -> (Result<Poses, PipelineError>, Vec<String>, NeedsLight) {
    let home = tempfile::tempdir().expect("temporary directory");
    let images = home.path().join("images");
    std::fs::create_dir(&images).expect("made");
    for (name, period) in [("a", 17), ("b", 19), ("c", 23)] {
        let mut image: Image = Image::new(960, 640);
        for (index, value) in image.data_mut().iter_mut().enumerate() {
            *value = 0.02 + 0.002 * (index % period) as f32;
        }
        image.save(&images.join(format!("{name}.png"))).expect("written");
    }
    let capture = Capture::open(home.path(), &home.path().join("scratch")).expect("a capture");
    let workspace = Workspace::open(&home.path().join("run")).expect("a workspace");
    let (sfm, mut warnings) = (NeedsLight::default(), Vec::new());
    let device = crate::device::Device::Processor;
    let mut tools = Tools {
        device: &device,
        sfm: &sfm,
        matching: None,
        deblurrer,
        enhancer: None,
        fallbacks: Vec::new(),
        cache: None,
    };
    let mut sink = |event: &Event| {
        if let Event::Warning { code, message } = event {
            warnings.push(format!("{code}: {message}"));
        }
    };
    let (options, cancel) = (Options::default(), CancelToken::new());
    let mut context = Context::new(&workspace, &mut sink, &cancel);
    let found = poses(&mut context, &capture, &options, &mut tools);
    (found, warnings, sfm)
}

#[test]
fn what_no_strategy_can_place_is_deblurred_once_and_asked_about_again() {
    let (found, warnings, asked) = found_with(&mut Grey(0.5, Vec::new()));
    let found = found.expect("placed on bright copies");
    assert_eq!((found.strategy, found.registered), (Some(STRATEGY), 3));
    let asked: Vec<_> =
        asked.0.into_inner().iter().map(|(width, mean)| (*width, *mean > 0.3)).collect();
    assert_eq!(
        asked,
        [(960, false), (960, false), (960, false), (640, true), (640, true), (640, true)]
    );
    for view in &found.views {
        let k = view.camera.intrinsics;
        assert_eq!(
            (k.width, k.height, view.lens.intrinsics.fx),
            (960, 640, 960.0),
            "as the original"
        );
    }
    assert_eq!(warnings, ["a", "b", "c"].map(|name| format!("poses: {name}.png: is 0.5 now")));
}

#[test]
fn a_run_without_a_network_has_no_second_look() {
    let (found, _, asked) = found_with(&mut Identity);
    assert!(matches!(found, Err(PipelineError::Poses(PosesError::TooFew { .. }))), "{found:?}");
    assert_eq!(asked.0.into_inner().len(), 3);
}

fn placed(registered: usize, low_confidence: bool, strategy: char) -> Poses {
    Poses {
        views: Vec::new(),
        points: Vec::new(),
        registered,
        total: 20,
        source: String::new(),
        strategy: Some(strategy),
        mean_reprojection_error: None,
        mean_track: None,
        verdicts: Vec::new(),
        parts: Vec::new(),
        low_confidence,
        network: None,
        seconds: 0.0,
        ..Poses::default()
    }
}

fn few(registered: usize) -> PosesError {
    PosesError::TooFew { registered, total: 20, advice: String::new() }
}

#[test]
fn the_second_look_wins_only_where_it_is_better() {
    let strategy = |first, second| better(first, second, &mut Silent).map(|poses| poses.strategy);
    assert_eq!(
        strategy(Ok(placed(12, true, 'C')), Ok(placed(18, true, 'F'))).ok(),
        Some(Some('F'))
    );
    assert_eq!(
        strategy(Ok(placed(18, true, 'C')), Ok(placed(17, false, 'F'))).ok(),
        Some(Some('F'))
    );
    assert_eq!(
        strategy(Ok(placed(18, true, 'C')), Ok(placed(18, true, 'F'))).ok(),
        Some(Some('C'))
    );
    assert_eq!(strategy(Ok(placed(12, true, 'C')), Err(few(4))).ok(), Some(Some('C')));
    assert_eq!(strategy(Err(few(4)), Ok(placed(17, false, 'F'))).ok(), Some(Some('F')));
    assert!(matches!(
        strategy(Err(few(4)), Err(few(9))),
        Err(PosesError::TooFew { registered: 4, .. })
    ));
}

#[test]
fn only_what_no_network_had_a_hand_in_serves_every_network() {
    let network = |id: &str| Networks {
        deblur: RestorerInfo { id: id.to_owned(), ..Identity.describe() },
        enhance: None,
    };
    let depends_on =
        |id: &str| PosesDependencies::new(&Options::default(), "capture", "source", &network(id));
    let by = |id: &str| Poses {
        network: Some(depends_on(id).second.fingerprint().to_owned()),
        ..placed(18, false, 'F')
    };
    assert!(serves(&placed(18, false, 'C'), &depends_on("one")));
    assert!(serves(&by("one"), &depends_on("one")));
    assert!(!serves(&by("one"), &depends_on("two")));
}

#[test]
fn cached_poses_are_as_young_as_their_last_use() {
    let home = tempfile::tempdir().expect("temporary directory");
    let workspace = Workspace::open(&home.path().join("run")).expect("a workspace");
    let networks = Networks { deblur: Identity.describe(), enhance: None };
    let depends_on = PosesDependencies::new(&Options::default(), "capture", "source", &networks);
    let cache = Cache { folder: Some(home.path().join(CACHED)), depends_on: &depends_on };
    let poses = placed(18, false, 'A');
    cache.write(&workspace, &poses).expect("written");
    let file = cache.file(&depends_on.first).expect("a cache");
    let about = || std::fs::metadata(&file).expect("there").modified().expect("known");
    let day = std::time::Duration::from_secs(24 * 3600);
    let opened = File::options().write(true).open(&file).expect("opened");
    opened.set_modified(SystemTime::now() - 29 * day).expect("set");
    cache.write(&workspace, &poses).expect("used");
    assert!(about().elapsed().expect("past") < day);
}

#[test]
fn the_newest_matches_of_earlier_searches_are_found() {
    let home = tempfile::tempdir().expect("temporary directory");
    let workspace = Workspace::open(&home.path().join("run")).expect("a workspace");
    let networks = Networks { deblur: Identity.describe(), enhance: None };
    let folder = home.path().join(CACHED);
    let of = |capture: usize| {
        let capture = capture.to_string();
        PosesDependencies::new(&Options::default(), &capture, "source", &networks)
    };
    let kept = home.path().join("kept");
    let now = SystemTime::now();
    let mut expected = Vec::new();
    for capture in 0..MOST_FILES + 2 {
        let depends_on = of(capture);
        let cache = Cache { folder: Some(folder.clone()), depends_on: &depends_on };
        cache.keep_matches(&workspace, &home.path().join("none")).expect("nothing to keep");
        std::fs::write(&kept, capture.to_string()).expect("written");
        cache.keep_matches(&workspace, &kept).expect("kept");
        cache.write(&workspace, &placed(18, false, 'A')).expect("written");
        let file = cache.file(&depends_on.first).expect("a cache").with_extension(MATCHES);
        let opened = File::options().write(true).open(&file).expect("opened");
        let age = std::time::Duration::from_secs(100 - capture as u64);
        opened.set_modified(now - age).expect("set");
        expected.insert(0, file);
    }
    let depends_on = of(0);
    let cache = Cache { folder: Some(folder), depends_on: &depends_on };
    assert_eq!(cache.matches(MOST_BYTES), expected[..MOST_FILES]);
    let bytes = std::fs::metadata(&expected[0]).expect("there").len();
    assert_eq!(cache.matches(2 * bytes), expected[..2], "as many as fit in memory");
    let none = Cache { folder: None, depends_on: &depends_on };
    assert!(none.matches(MOST_BYTES).is_empty());
}

#[test]
fn photographs_without_a_pose_and_doubtful_poses_are_reported_once_with_names_and_figures() {
    let mut warnings = Vec::new();
    let mut sink = |event: &Event| {
        if let Event::Warning { code, message } = event {
            warnings.push(format!("{code}: {message}"));
        }
    };
    let poses = Poses { total: 2, mean_track: Some(2.5), ..placed(1, true, 'C') };
    let path = PhotoPath::new("cam0/b.jpg");
    let view = CaptureView::upright("cam0_b".to_owned(), path, PreparedImage::default());
    warn(&mut sink, &poses, &[view]);
    assert_eq!(
        warnings,
        [
            "poses_low_confidence: the poses met no acceptance rule (1 of 2 views, 0 points, 0 \
             observations per view, a mean track of 2.50); check the result before you rely on it",
            "poses_missing: 1 of 2 photographs have a pose; excluded: cam0/b.jpg",
        ]
    );
    warnings.clear();
    let mut sink = |event: &Event| warnings.push(format!("{event:?}"));
    let whole = Poses { total: 18, ..placed(18, false, 'A') };
    warn(&mut sink, &whole, &[]);
    assert!(warnings.is_empty(), "{warnings:?}");
}
