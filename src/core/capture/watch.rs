//! Who watches while photographs are looked at.

use std::path::Path;

use super::budget::DecodeBudget;
use crate::image::{Image, Srgb};

/// What a photograph goes through.
#[derive(Clone, Copy, Debug)]
pub enum Look<'a> {
    /// Its header is read, or it is decoded.
    Begins(&'a str),
    /// It was decoded from this file: this is it, upright and small. Not told of ground truth.
    Seen(&'a str, &'a Path, &'a Image<Srgb>),
    /// That is over, however it ended.
    Ended(&'a str),
}

/// Who lends the memory in which photographs are decoded, and who is told which one is looked at:
/// where a decoder takes its process with it, nobody else knows.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Told once, before the first photograph is decoded, what the largest that are decoded at a
    /// time take, bytes; says how much may be.
    pub lend: &'a dyn Fn(u64) -> DecodeBudget,
    /// Told the names of photographs, from several threads.
    pub tell: &'a (dyn Fn(Look<'_>) + Sync),
}

impl Watch<'_> {
    /// Nobody is told anything, and the budget is the usual one.
    pub fn nobody() -> Self {
        Self { lend: &|_| DecodeBudget::default(), tell: &|_| () }
    }
}
