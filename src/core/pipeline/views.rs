//! The registered photographs at their working size.

use std::borrow::Cow;

use rayon::prelude::*;

use super::config::{Options, OptionsError};
use super::context::Context;
use super::error::PipelineError;
use super::pictures;
use super::workspace::Workspace;
use crate::camera::normalisation::Normalisation;
use crate::camera::{Camera, NamedCamera, Split};
use crate::cancel::CancelToken;
use crate::capture::{Capture, CaptureView, MIN_VIEWS, PreparedImage, on_few_threads};
use crate::image::{Image, Linear};
use crate::mask::{Mask, counted};
use crate::photo_path::PhotoPath;
use crate::poses::{PosedView, Poses};
use crate::run_folder::RoundPictures;

/// Number of views from which every 8th is held out by default; the published split.
pub const HELD_OUT_FROM: usize = 12;

/// One registered view at working size, undistorted.
#[derive(Clone, Debug)]
pub struct View {
    pub name: String,
    /// The owner's path of the photograph, for messages.
    pub path: PhotoPath,
    /// The pinhole camera at working size.
    pub camera: Camera,
    /// The photograph as taken, sRGB.
    pub dark: Image,
    /// The sharp, bright ground truth, if the capture has it.
    pub gt: Option<Image>,
    /// The pixels that count; all without one.
    pub mask: Option<Mask>,
    /// Whether it trains or is held out.
    pub split: Split,
    /// Whether the scene of an earlier round placed it.
    pub is_late: bool,
}

/// L, the dark views.
pub fn dark(views: &[View]) -> Vec<&Image> {
    views.iter().map(|view| &view.dark).collect()
}

/// The masks of the views.
pub fn masks(views: &[View]) -> Vec<Option<&Mask>> {
    views.iter().map(|view| view.mask.as_ref()).collect()
}

/// The pixels of the dark views that count, for what does not depend on where they are.
pub fn counted_dark(views: &[View]) -> Vec<Cow<'_, Image>> {
    views.iter().map(|view| counted(&view.dark, view.mask.as_ref())).collect()
}

/// Names of the photographs that have no pose.
pub fn unregistered(capture: &Capture, poses: &Poses) -> Vec<String> {
    let names = capture.views.iter().map(|view| &view.name);
    let has_no_pose = |name: &&String| poses.views.iter().all(|view| view.name != **name);
    names.filter(has_no_pose).cloned().collect()
}

/// Loads L_j: the registered photographs, undistorted, at working size. Also writes their cameras
/// and pictures for observers of the run.
///
/// # Errors
/// [`PipelineError::Photograph`], [`PipelineError::TooFewViews`], [`PipelineError::Options`]
/// when `held_out` names a view that does not exist.
pub fn load(
    context: &Context<'_>,
    capture: &Capture,
    poses: &Poses,
    options: &Options,
) -> Result<Vec<View>, PipelineError> {
    let views = read(capture, poses, options, context.cancel)?;
    let workspace = context.workspace;
    write_cameras(workspace, &named(&views, &poses.normalisation))?;
    views.iter().try_for_each(|view| show(workspace, view))?;
    Ok(views)
}

/// Writes the pictures of a view's input.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn show(workspace: &Workspace, view: &View) -> Result<(), PipelineError> {
    let path = workspace.folder().input(&view.name);
    pictures::preview(workspace, &path, &view.dark)?;
    if let Some(gt) = &view.gt {
        let path = workspace.folder().truth(&view.name);
        pictures::preview(workspace, &path, gt)?;
    }
    Ok(())
}

/// Moves the views to the cameras that a round's training found.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn place(
    context: &Context<'_>,
    round: u32,
    views: &mut [View],
    cameras: &[Camera],
    normalisation: &Normalisation,
) -> Result<(), PipelineError> {
    for (view, camera) in views.iter_mut().zip(cameras) {
        view.camera = *camera;
    }
    let workspace = context.workspace;
    let cameras = named(views, normalisation);
    workspace.write_json(&workspace.folder().round(round).cameras(), &cameras)?;
    write_cameras(workspace, &cameras)
}

/// Writes `cameras.json`.
fn write_cameras(workspace: &Workspace, cameras: &[NamedCamera]) -> Result<(), PipelineError> {
    workspace.write_json(&workspace.folder().cameras(), &cameras)
}

/// The cameras of the views in the world of the poses.
fn named(views: &[View], normalisation: &Normalisation) -> Vec<NamedCamera> {
    let camera = |view: &View| normalisation.in_world(&view.camera);
    let named = |view: &View| NamedCamera::new(&view.name, &camera(view), view.split);
    views.iter().map(named).collect()
}

/// Writes a round's pictures of all views.
///
/// # Errors
/// [`PipelineError::Photograph`], [`PipelineError::Io`].
pub fn previews(
    workspace: &Workspace,
    round: u32,
    kind: RoundPictures,
    views: &[View],
    images: &[Image],
) -> Result<(), PipelineError> {
    let folder = workspace.folder().round(round);
    views.iter().zip(images).try_for_each(|(view, image)| {
        pictures::preview(workspace, &folder.picture(kind, &view.name), image)
    })
}

fn read(
    capture: &Capture,
    poses: &Poses,
    options: &Options,
    cancel: &CancelToken,
) -> Result<Vec<View>, PipelineError> {
    let names: Vec<&str> = poses.views.iter().map(|view| view.name.as_str()).collect();
    let splits = splits(&options.held_out, capture.hold, &poses.held_out, &names)?;
    if names.len() < MIN_VIEWS {
        return Err(PipelineError::TooFewViews {
            registered: names.len(),
            views: capture.views.len(),
            needed: MIN_VIEWS,
        });
    }
    leave_enough(&splits)?;
    let posed = poses.views.par_iter().zip(splits);
    let read = posed.map(|(posed, split)| {
        cancel.check()?;
        let photograph =
            capture.views.iter().find(|view| view.name == posed.name).ok_or_else(|| {
                let message =
                    format!("the poses name a view `{}` that is not in the capture", posed.name);
                OptionsError { key: "pose_source".to_owned(), message }
            })?;
        view(photograph, posed, split, options.longest_side() as usize)
    });
    on_few_threads(|| read.collect())
}

/// A photograph as seen by its pose's pinhole camera, at working size.
///
/// # Errors
/// [`PipelineError::Photograph`].
pub fn view(
    photograph: &CaptureView,
    posed: &PosedView,
    split: Split,
    size: usize,
) -> Result<View, PipelineError> {
    let (width, height) = working_size(photograph.width, photograph.height, size);
    let failed = |source| PipelineError::Photograph { name: photograph.path.to_string(), source };
    let load = |prepared: &PreparedImage| {
        let image = prepared.load().map_err(failed)?;
        Ok::<_, PipelineError>(resample(&posed.undistort(&image), width, height).to_srgb())
    };
    let dark = load(&photograph.prepared)?;
    let gt = photograph.gt.as_ref().map(load).transpose()?;
    let load = |mask: &PreparedImage| {
        mask.load_mask((width, height), |shares| posed.undistort(shares)).map_err(failed)
    };
    let mask = photograph.mask.as_ref().map(load).transpose()?;
    Ok(View {
        name: posed.name.clone(),
        path: photograph.path.clone(),
        camera: posed.camera.resized(width, height),
        dark,
        gt,
        mask,
        split,
        is_late: false,
    })
}

/// Longest side of the working images, px; below the option for small photographs.
pub fn longest_side(views: &[View]) -> u32 {
    let sides = views.iter().map(|view| view.dark.width().max(view.dark.height()) as u32);
    sides.max().unwrap_or(0)
}

/// Working size for a photograph: long side at most `size`, never above the original.
pub fn working_size(width: usize, height: usize, size: usize) -> (usize, usize) {
    let long = width.max(height);
    if long <= size {
        return (width, height);
    }
    let scale = size as f64 / long as f64;
    let side = |pixels: usize| ((pixels as f64 * scale).round() as usize).max(1);
    (side(width), side(height))
}

/// Resizes by averaging light.
fn resample(image: &Image<Linear>, width: usize, height: usize) -> Image<Linear> {
    if (image.width(), image.height()) == (width, height) {
        return image.clone();
    }
    image.resize_area(width, height)
}

/// The split of each view by the option `held_out`: `auto`, `none`, every n-th, or names. For
/// `auto`, `hold` is the capture's own setting, at least 2, and `given` are the names that its
/// poses hold out.
///
/// # Errors
/// [`OptionsError`] for a number below 2 and for names without a view.
pub fn splits(
    held_out: &str,
    hold: Option<u32>,
    given: &[String],
    names: &[&str],
) -> Result<Vec<Split>, OptionsError> {
    let every = |n: usize| -> Vec<Split> {
        (0..names.len()).map(|i| if i % n == 0 { Split::HeldOut } else { Split::Train }).collect()
    };
    let these = |wanted: &[&str]| -> Vec<Split> {
        let split = |name: &&str| match wanted.contains(name) {
            true => Split::HeldOut,
            false => Split::Train,
        };
        names.iter().map(split).collect()
    };
    let fault = |message: String| OptionsError { key: "held_out".to_owned(), message };
    match (held_out, hold) {
        ("auto", Some(n)) => return Ok(every(n as usize)),
        ("auto", None) if !given.is_empty() => {
            let given: Vec<&str> = given.iter().map(String::as_str).collect();
            return Ok(these(&given));
        }
        ("auto", None) if names.len() >= HELD_OUT_FROM => return Ok(every(8)),
        ("auto" | "none", _) => return Ok(vec![Split::Train; names.len()]),
        _ => {}
    }
    if let Ok(n) = held_out.parse::<usize>() {
        return if n >= 2 {
            Ok(every(n))
        } else {
            Err(fault(format!("holding out every {n}-th view leaves nothing to train on")))
        };
    }
    let wanted: Vec<&str> =
        held_out.split(',').map(str::trim).filter(|name| !name.is_empty()).collect();
    if let Some(unknown) = wanted.iter().find(|name| !names.contains(name)) {
        return Err(fault(format!("`{unknown}` is not a view with a pose")));
    }
    Ok(these(&wanted))
}

/// # Errors
/// [`OptionsError`] where too few views are left to train on.
fn leave_enough(splits: &[Split]) -> Result<(), OptionsError> {
    let trains = |split: &&Split| **split == Split::Train;
    let (training, all) = (splits.iter().filter(trains).count(), splits.len());
    if training >= MIN_VIEWS {
        return Ok(());
    }
    Err(OptionsError {
        key: "held_out".to_owned(),
        message: format!(
            "{} of {all} photographs with a pose are held out, by it or by lists of the capture, \
             and {training} are left to train on, fewer than {MIN_VIEWS}: set it to `none` or to \
             fewer names",
            all - training
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn auto_holds_out_every_eighth_of_at_least_twelve() {
        let names: Vec<String> = (0..20).map(|i| format!("v{i}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let held = |option: &str, names: &[&str]| -> Vec<usize> {
            let splits = splits(option, None, &[], names).expect("valid");
            (0..names.len()).filter(|&i| splits[i] == Split::HeldOut).collect()
        };
        assert_eq!(held("auto", &names), [0, 8, 16]);
        assert_eq!(held("auto", &names[..11]), Vec::<usize>::new());
        assert_eq!(held("5", &names[..11]), [0, 5, 10]);
        assert_eq!(held("v3, v4", &names), [3, 4]);
        assert_eq!(held("none", &names), Vec::<usize>::new());
    }

    #[test]
    fn auto_holds_out_what_the_capture_holds_out() {
        let held = |option: &str| {
            let splits = splits(option, Some(3), &["b".to_owned()], &["a", "b", "c", "d", "e"])
                .expect("valid");
            let held_out = splits.iter().map(|split| *split == Split::HeldOut);
            held_out.collect::<Vec<_>>()
        };
        assert_eq!(held("auto"), [true, false, false, true, false]);
        assert_eq!(held("b"), [false, true, false, false, false]);
        assert_eq!(held("none"), [false; 5]);
    }

    #[test]
    fn views_held_out_by_given_poses_stand_by_default() {
        let held = |option: &str| {
            let given = ["b".to_owned(), "lost".to_owned()];
            let splits = splits(option, None, &given, &["a", "b", "c"]).expect("valid");
            let held_out = splits.iter().map(|split| *split == Split::HeldOut);
            held_out.collect::<Vec<_>>()
        };
        assert_eq!(held("auto"), [false, true, false]);
        assert_eq!(held("c"), [false, false, true]);
        assert_eq!(held("none"), [false; 3]);
    }

    #[test]
    fn an_impossible_held_out_option_is_refused() {
        assert!(splits("1", None, &[], &["a", "b"]).is_err());
        assert!(splits("c", None, &[], &["a", "b"]).is_err());
    }

    #[test]
    fn views_that_are_all_held_out_are_an_error_that_says_so() {
        let (train, held_out) = (Split::Train, Split::HeldOut);
        assert!(leave_enough(&[train, held_out, train, train]).is_ok());
        let error = leave_enough(&[held_out, held_out, train, train]).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("2 of 4") && message.contains("`none`"), "{message}");
    }

    #[test]
    fn the_working_size_keeps_the_aspect_and_never_enlarges() {
        assert_eq!(working_size(1120, 640, 560), (560, 320));
        assert_eq!(working_size(315, 559, 560), (315, 559));
        assert_eq!(working_size(581, 427, 280), (280, 206));
    }
}
