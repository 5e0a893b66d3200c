//! The images that a round is measured by.

use crate::image::Image;

/// The images of one round, a view each, in the order of the views.
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
    /// Of H_i, D_i and R_i.
    pub fn new(enhanced: &'a [Image], deblurred: &'a [Image], renders: &'a [Image]) -> Self {
        Self {
            enhanced,
            deblurred,
            renders,
        }
    }
}

/// The images of one round at the target brightness.
#[derive(Clone, Debug)]
pub struct TargetImages<'a> {
    /// H_N.
    pub enhanced: &'a [Image],
    /// D_i mapped to the target brightness.
    pub deblurred: Vec<Image>,
    /// R_i mapped to the target brightness.
    pub renders: Vec<Image>,
}
