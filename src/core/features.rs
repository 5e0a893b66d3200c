//! Key points that tolerate noise and shake, and their matches: XFeat (CVPR 2024) finds and
//! describes them, LighterGlue matches them. Both run in ONNX Runtime; their weights are a separate
//! package ([`weights`]).

mod detect;
mod extractor;
mod kept;
mod key_points;
mod matcher;
mod nearest;
mod pairs;
mod search;
mod self_test;
pub mod weights;

pub use extractor::Extractor;
pub use key_points::KeyPoints;
pub use matcher::{Match, Matcher};
pub use search::{FeatureError, LearnedMatching, SearchOptions};

#[cfg(test)]
mod tests;
