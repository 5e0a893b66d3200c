//! The images that the metrics of a round compare.

use std::borrow::Cow;

use crate::image::Image;

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

/// The images of one round at the target brightness.
#[derive(Clone, Debug)]
pub struct TargetImages<'a> {
    /// H_N.
    pub enhanced: &'a [Image],
    /// D_i mapped to the target brightness.
    pub deblurred: Cow<'a, [Image]>,
    /// R_i mapped to the target brightness.
    pub renders: Cow<'a, [Image]>,
}
