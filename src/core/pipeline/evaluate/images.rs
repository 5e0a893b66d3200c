//! The images that the metrics of a round compare.

use std::borrow::Cow;

use crate::image::Image;
use crate::pipeline::tone::Tone;

/// The images of one round, one per view, in the order of the views.
#[derive(Clone, Copy, Debug)]
pub struct RoundImages<'a> {
    /// H_i.
    pub enhanced: &'a [Image],
    /// D_i.
    pub deblurred: &'a [Image],
    /// R_i.
    pub renders: &'a [Image],
}

impl<'a> RoundImages<'a> {
    pub fn new(enhanced: &'a [Image], deblurred: &'a [Image], renders: &'a [Image]) -> Self {
        Self { enhanced, deblurred, renders }
    }
}

/// The images of one round at the target brightness, each made when it is asked for: all of them
/// at once are two pictures a view.
#[derive(Clone, Copy, Debug)]
pub struct TargetImages<'a> {
    /// H_N.
    pub enhanced: &'a [Image],
    /// Those of the round.
    pub images: RoundImages<'a>,
    /// From the round's brightness to the target's; `None` where they are the same.
    pub tone: Option<&'a Tone>,
}

impl<'a> TargetImages<'a> {
    /// D_i of a view.
    pub fn deblurred(&self, view: usize) -> Cow<'a, Image> {
        self.at_target(view, &self.images.deblurred[view])
    }

    /// R_i of a view.
    pub fn render(&self, view: usize) -> Cow<'a, Image> {
        self.at_target(view, &self.images.renders[view])
    }

    fn at_target(&self, view: usize, image: &'a Image) -> Cow<'a, Image> {
        match self.tone {
            Some(tone) => Cow::Owned(tone.apply_to(view, image)),
            None => Cow::Borrowed(image),
        }
    }
}
