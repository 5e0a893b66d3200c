//! What the rounds do: decided once, from the options and from what was found in the photographs.

use std::collections::BTreeSet;

use super::config::{Options, Setting};
use super::dependencies::Levels;
use super::shaken::Shaken;
use super::views::View;
use crate::metrics::CaptureShake;
use crate::metrics::report::ViewScore;

/// The decisions about a run. The stages get their options from here alone.
#[derive(Clone, Debug, PartialEq)]
pub struct Effective {
    /// The options in effect.
    pub options: Options,
    /// The brightness of the rounds.
    pub levels: Levels,
    /// Whether another round follows only if the previous one placed a photograph or showed that a
    /// view has a wrong pose.
    pub is_single: bool,
    /// The views that have a kernel in the first round if shaken views have one, by name.
    shaken_at_first: BTreeSet<String>,
}

impl Effective {
    /// `found` are the shaken views, if the options require that they are found.
    pub fn of(options: &Options, found: Option<&Shaken>) -> Self {
        let verdict = found.map(Shaken::verdict);
        let sizes = found
            .map(|found| Sizes { before: found.size_before(options), now: found.size(options) });
        let is_still = verdict == Some(CaptureShake::Still);
        let shaken_at_first = found.filter(|_| is_still).map(Shaken::names).unwrap_or_default();
        Self {
            options: in_effect(options, verdict, sizes),
            levels: if is_still { Levels::Target } else { Levels::Rising },
            is_single: is_still && options.rounds == Setting::Auto,
            shaken_at_first,
        }
    }

    /// Number of rounds, unless a single one changes the views.
    pub fn rounds(&self) -> u32 {
        if self.is_single { 1 } else { self.options.round_count() }
    }

    /// For each view in order, whether it has a kernel in a round. `before` are the scores of the
    /// previous round's renders.
    ///
    /// In the first round of a shaken capture none has: there is no sharp scene yet to find one in.
    pub fn kernels(&self, views: &[View], before: Option<&[ViewScore]>) -> Vec<bool> {
        let is_shaken = |view: &View| match before {
            Some(before) => {
                let row = before.iter().find(|row| row.name == view.name);
                row.and_then(|row| row.is_shaken).unwrap_or(false)
            }
            None => self.shaken_at_first.contains(&view.name),
        };
        views.iter().map(|view| self.options.shake.has_kernel(is_shaken(view))).collect()
    }
}

/// Longest sides of the working images, px; below the option for small photographs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Before the verdict on the shake.
    pub before: u32,
    /// In the rounds.
    pub now: u32,
}

/// The options in effect for rounds whose images have these `sizes`; without them they stay.
///
/// A still capture is splatted plainly, in one round with the steps of all unless the options say
/// otherwise. Its cameras stay as found: correcting them costs one museum capture 0.3 to 0.6 dB and
/// hardly changes the other (docs/decisions/cameras.md). Where the options leave it open, images of
/// a shaken capture may be smaller, with as many Gaussians a pixel.
pub fn in_effect(
    options: &Options,
    verdict: Option<CaptureShake>,
    sizes: Option<Sizes>,
) -> Options {
    let mut options = options.clone();
    match verdict {
        Some(CaptureShake::Still) => {
            options.refine_poses = false;
            if options.rounds == Setting::Auto && options.steps.is_open() {
                let all = options.steps_per_round() * options.round_count();
                options.steps = Setting::Given(all);
            }
        }
        Some(CaptureShake::Shaken) => {
            if let Some(Sizes { before, now }) = sizes.filter(|sizes| sizes.now < sizes.before) {
                let area = (f64::from(now) / f64::from(before)).powi(2);
                if options.cap.is_open() {
                    let cap = (f64::from(options.most_gaussians()) * area).round();
                    options.cap = Setting::Given(cap as u32);
                }
                options.size = Setting::Given(now);
            }
        }
        None => {}
    }
    options
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Split;
    use crate::pipeline::config::Preset;
    use crate::pipeline::training_images::tests::view;

    #[test]
    fn shake_decides_the_rounds_of_a_capture() {
        let options = Options::default();
        let sizes = |before, now| Some(Sizes { before, now });
        let (same, smaller) = (sizes(560, 560), sizes(560, 420));
        let still = in_effect(&options, Some(CaptureShake::Still), same);
        assert!(!still.refine_poses);
        assert_eq!((still.rounds, still.steps), (Setting::Auto, Setting::Given(2_000)));
        let small =
            Options { size: Setting::Given(420), cap: Setting::Given(16_875), ..options.clone() };
        assert_eq!(in_effect(&options, Some(CaptureShake::Shaken), smaller), small);
        assert_eq!(in_effect(&options, Some(CaptureShake::Shaken), same), options);
        assert_eq!(in_effect(&options, Some(CaptureShake::Shaken), sizes(400, 400)), options);
        assert_eq!(in_effect(&options, None, None), options);
        let of_small_photographs =
            in_effect(&Preset::High.options(), Some(CaptureShake::Shaken), sizes(525, 420));
        assert_eq!(of_small_photographs.cap, Setting::Given(640_000), "of their own pixels");
        let options = Options { cap: Setting::Given(50_000), ..options };
        let small = in_effect(&options, Some(CaptureShake::Shaken), smaller);
        assert_eq!(small.cap, options.cap, "a number that was set stays");
    }

    #[test]
    fn rounds_and_steps_that_were_set_are_used_in_still_captures_too() {
        let still = Shaken::of([("a", 0.1), ("b", 0.2), ("c", 0.1)].into_iter());
        let of = |rounds, steps| {
            let options = Options { rounds, steps, ..Options::default() };
            let effective = Effective::of(&options, Some(&still));
            (effective.rounds(), effective.options.steps_per_round())
        };
        let (auto, given) = (Setting::Auto, Setting::Given);
        assert_eq!(of(auto, auto), (1, 2_000));
        assert_eq!(of(given(3), auto), (3, 1_000));
        assert_eq!(of(auto, given(70)), (1, 70));
        assert_eq!(of(given(2), given(70)), (2, 70));
    }

    #[test]
    fn a_few_shaken_views_have_kernels_then_those_that_renders_show() {
        let options = Options::default();
        let views = ["a", "b", "c", "d", "e"].map(view);
        let shaken = |names: &[&str]| {
            let ratio = |view: &View| f64::from(u8::from(names.contains(&&view.name[..])));
            Shaken::of(views.iter().map(|view| (&view.name[..], ratio(view))))
        };
        let of = |names: &[&str]| Effective::of(&options, Some(&shaken(names)));
        assert_eq!(of(&["b"]).kernels(&views, None), [false, true, false, false, false]);
        assert_eq!(of(&["a", "b"]).kernels(&views, None), [false; 5]);
        let score = |name: &str, is_shaken| ViewScore {
            name: name.to_owned(),
            registered: true,
            split: Some(Split::Train),
            reference: None,
            psnr_db: None,
            psnr_cc_db: None,
            ssim: None,
            photograph_psnr_cc_db: None,
            shake_px: None,
            is_shaken: Some(is_shaken),
            fit: None,
        };
        let before = [score("c", true), score("a", false)];
        let later = of(&["b"]).kernels(&views, Some(&before));
        assert_eq!(later, [false, false, true, false, false]);
    }
}
