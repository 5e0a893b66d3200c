//! Brightening: the tone curve E(I; P), the brightness of each round, and the search for the curve
//! that maps a render to the next round's brightness.
//!
//! The default is a longer exposure: stops in linear light. In the paper's family, alpha is the
//! clip limit of contrast-limited histogram equalisation with one tile on HSV's V, and gamma an
//! exponent on all channels: together one monotone table of 256 entries. Either is a [`ToneCurve`].
//! It is always applied to the original dark images or to renders, in `f32`, never to a previous
//! result.

mod anchors;
mod curve;
mod evolution;
mod matching;
mod target;

pub use anchors::{Anchor, MAX_ALPHA, MIN_GAMMA, TargetError, anchors};
pub use curve::{BINS, Histogram, ToneCurve};
pub use matching::{Match, match_anchor, spread_indices};
pub use target::{Target, automatic, resolve_target};
