//! Whether a capture is shaken at all, found out before anything is trained.
//!
//! A deblurring network takes a shake out of a shaken view and nothing but noise out of a still
//! one: the kernel from its result back to the view is a path there and a dot here. Measured in
//! docs/decisions/shake.md.

use std::collections::BTreeSet;

use rayon::prelude::*;

use super::config::{Options, ShakeModel, TrainOn};
use super::context::Context;
use super::dependencies::RunDependencies;
use super::enhance::Brightening;
use super::error::PipelineError;
use super::restore::Restoration;
use super::tools::Tools;
use super::views::View;
use crate::deblur::NetworkChoice;
use crate::event::Stage;
use crate::image::Image;
use crate::run_folder::KeptImages;
use crate::shake::{self, Response};

/// Elongation of the kernel from D to H from which a view is shaken, px, at a longer side of
/// [`TOLD_SIDE`]. Still views reach 0.54 at 280 px, 0.91 at 420 and 1.33 at 560; three in four of
/// those shaken by 4.4 px at 560 have 1.4 and more at every size (docs/decisions/shake.md).
const TOLD_FROM: f64 = 1.5;
const TOLD_SIDE: f64 = 560.0;

/// The same in images of any size. A shake grows with the image and noise does not: the root lies
/// between the two.
fn told_from(longer_side: usize) -> f64 {
    TOLD_FROM * (longer_side as f64 / TOLD_SIDE).sqrt()
}

/// Of every view, whether deblurring took a shake out of it that differs from none.
pub fn told(enhanced: &[Image], deblurred: &[Image], response: &Response) -> Vec<bool> {
    let is_shaken = |(view, sharper): (&Image, &Image)| {
        let kernel = shake::estimate(sharper, view, response);
        kernel.elongation() >= told_from(view.width().max(view.height()))
    };
    enhanced.par_iter().zip(deblurred).map(is_shaken).collect()
}

/// Whether a run with these options asks before the rounds: only where kernels and the network both
/// have to be earned.
fn asks(options: &Options) -> bool {
    options.shake == ShakeModel::Late
        && options.train_on == TrainOn::Auto
        && options.deblur != NetworkChoice::Identity
}

/// The views found shaken, of those with a pose.
#[derive(Clone, Debug)]
pub struct Shaken {
    /// Their names.
    told: BTreeSet<String>,
    /// All of them.
    views: usize,
}

impl Shaken {
    /// The views of these names, of so many.
    pub fn of<'a>(told: impl Iterator<Item = &'a str>, views: usize) -> Self {
        Self {
            told: told.map(str::to_owned).collect(),
            views,
        }
    }

    /// Whether this view is one of them.
    pub fn tells(&self, view: &View) -> bool {
        self.told.contains(&view.name)
    }

    /// How many they are.
    pub fn count(&self) -> u32 {
        self.told.len() as u32
    }

    /// Whether more than half of the views are still: a scene of them is sharp, and shows the shake
    /// of the few from the first round on.
    pub fn is_mostly_still(&self) -> bool {
        2 * self.told.len() < self.views
    }
}

/// Finds the shaken views at the target brightness: a stage before the rounds. `None` where
/// the options leave nothing to decide.
///
/// # Errors
/// [`PipelineError::Deblur`], [`PipelineError::Io`], [`PipelineError::Cancelled`].
pub fn shaken(
    context: &mut Context<'_>,
    tools: &mut Tools<'_>,
    options: &Options,
    views: &[View],
    brightening: &Brightening,
    depends_on: &RunDependencies,
) -> Result<Option<Shaken>, PipelineError> {
    if !asks(options) {
        return Ok(None);
    }
    let restoration = Restoration {
        stage: Stage::Deblur,
        round: 0,
        kept: KeptImages::Deblurred,
        views,
        images: &brightening.target,
        guides: None,
    };
    let on = depends_on.round(0, None).deblur;
    let deblurred = restoration.by(tools.deblurrer, context, &on)?;
    let response = &brightening.last().response;
    let told = told(&brightening.target, &deblurred, response);
    let told = views.iter().zip(told).filter(|(_, told)| *told);
    let shaken = Shaken::of(told.map(|(view, _)| &view.name[..]), views.len());
    let (count, all) = (shaken.count(), shaken.views);
    let line = format!("{count} of {all} views are shaken");
    context.sink.log(line);
    Ok(Some(shaken))
}

/// The options that the rounds are made with. A capture that is mostly still is splatted plainly:
/// enhanced views, with a kernel for the few that are shaken. Its cameras stay as found: correcting
/// them cost 0.2 to 0.5 dB on both museum captures (docs/decisions/cameras.md).
pub fn in_effect(options: &Options, shaken: Option<&Shaken>) -> Options {
    if !shaken.is_some_and(Shaken::is_mostly_still) {
        return options.clone();
    }
    Options {
        train_on: TrainOn::Enhanced,
        refine_poses: false,
        ..options.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smaller_image_is_shaken_by_fewer_pixels() {
        let at = [280, 420, 560].map(told_from);
        assert!(
            (0.98..1.26).contains(&at[0]),
            "fox, and the room of `fled synth`"
        );
        assert!((0.91..1.45).contains(&at[1]), "still and shaken cells");
        assert!(
            (1.33..1.66).contains(&at[2]),
            "still cells, and most shaken ones"
        );
    }

    #[test]
    fn a_capture_is_mostly_still_with_fewer_than_half_shaken() {
        let names = ["a", "b", "c", "d"];
        let with = |shaken, views| Shaken::of(names[..shaken].iter().copied(), views);
        assert!(with(0, 3).is_mostly_still() && with(3, 7).is_mostly_still());
        assert!(!with(4, 8).is_mostly_still());
    }

    #[test]
    fn only_where_kernels_and_network_are_to_be_earned_is_anything_decided() {
        let options = Options::default();
        let still = in_effect(&options, Some(&Shaken::of(["a"].into_iter(), 3)));
        assert_eq!(still.train_on, TrainOn::Enhanced);
        assert!(!still.refine_poses);
        let shaken = Shaken::of(["a", "b"].into_iter(), 3);
        assert_eq!(in_effect(&options, Some(&shaken)), options);
        assert_eq!(in_effect(&options, None), options);
        let asked = |change: fn(&mut Options)| {
            let mut options = Options::default();
            change(&mut options);
            asks(&options)
        };
        assert!(asked(|_| {}));
        assert!(!asked(|options| options.shake = ShakeModel::Kernel));
        assert!(!asked(|options| options.train_on = TrainOn::Deblurred));
        assert!(!asked(|options| options.deblur = NetworkChoice::Identity));
    }
}
