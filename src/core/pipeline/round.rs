//! The properties of a round that are known before it begins.

use super::tone::Tone;
use crate::enhance::Anchor;
use crate::shake::Response;

/// One round: its brightness, and how the photographs reach it.
#[derive(Clone, Debug)]
pub struct Round {
    /// i, 1-based.
    pub number: u32,
    /// P_i.
    pub anchor: Anchor,
    /// From the dark views to the round's brightness.
    pub tone: Tone,
    /// The response from light to values of the round's views: the camera's sRGB, then the curve.
    pub response: Response,
}

impl Round {
    pub fn new(number: u32, anchor: Anchor, tone: Tone) -> Self {
        let response = Response::through(|v| tone.scene().apply_colour([v; 3])[0]);
        Self { number, anchor, tone, response }
    }
}
