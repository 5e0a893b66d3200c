//! Callbacks during the assessment of photographs.

use std::path::Path;

use super::budget::DecodeBudget;
use crate::image::{Image, Srgb};

/// A step in the assessment of a photograph.
#[derive(Clone, Copy, Debug)]
pub enum Look<'a> {
    /// Its header is being read, or it is being decoded.
    Begins(&'a str),
    /// It was decoded from this file: the picture, upright and small. Not reported for ground
    /// truth.
    Seen(&'a str, &'a Path, &'a Image<Srgb>),
    /// The work has ended, successfully or not.
    Ended(&'a str),
}

/// Supplies the decoding budget, and receives the name of the photograph in work: if a decoder
/// takes its process down, this is the only record of it.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Called once, before the first photograph is decoded, with the memory that the largest
    /// photographs decoded at a time take, bytes; returns the budget.
    pub lend: &'a dyn Fn(u64) -> DecodeBudget,
    /// Called with the names of photographs, from several threads.
    pub tell: &'a (dyn Fn(Look<'_>) + Sync),
}

impl Watch<'_> {
    /// Reports nothing, and uses the default budget.
    pub fn silent() -> Self {
        Self { lend: &|_| DecodeBudget::default(), tell: &|_| () }
    }
}
