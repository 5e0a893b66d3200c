//! Given poses that are usable but unlikely to be right.

use super::given_view::GivenView;
use super::upright::Upright;
use crate::poses::{Distortion, Lens, PosedView, SparsePoint};

/// Shortest focal length of a lens that is not a fisheye, in long sides: a view of 136 degrees.
const SHORTEST: f64 = 0.2;

/// Longest focal length, in long sides.
const LONGEST: f64 = 20.0;

/// Largest offset of the principal point from the centre, as a share of a side: even shift lenses
/// for architecture stay below it.
const ASIDE: f64 = 0.3;

/// Smallest share of the width that a distortion may leave.
const LEAST_SHARE: f64 = 0.6;

/// Largest size ratio of a pose's picture and the photograph at which it may be another crop:
/// photographs that are downscaled on purpose become much smaller.
const NEAR: f64 = std::f64::consts::SQRT_2;

/// Rounding of sides, px, over several resizes.
const ROUNDING: usize = 2;

/// With fewer points, they do not show where a view looks.
const LEAST_POINTS: usize = 50;

/// Doubts about a lens.
pub(super) fn doubt_of_lens(lens: &Lens) -> Option<String> {
    let k = &lens.intrinsics;
    let (width, height) = (k.width as f64, k.height as f64);
    let is_fisheye = matches!(lens.distortion, Distortion::Fisheye { .. });
    let shortest = if is_fisheye { 0.1 } else { SHORTEST };
    let of_side = k.fx.min(k.fy) / width.max(height);
    if !(shortest..=LONGEST).contains(&of_side) {
        return Some(format!(
            "a focal length of {:.4} px for a picture of {width} x {height} px is unlikely: is it \
             in other units, or of another size?",
            k.fx.min(k.fy)
        ));
    }
    let aside = (k.cx / width - 0.5).abs().max((k.cy / height - 0.5).abs());
    if aside > ASIDE {
        return Some(format!(
            "a principal point of {:.4}, {:.4} px is far from the middle of a picture of {width} \
             x {height} px: is it in other units, from the middle, or of another size?",
            k.cx, k.cy
        ));
    }
    let share = lens.straight_share();
    (share < LEAST_SHARE).then(|| {
        format!(
            "a distortion that leaves {:.0} % of the picture's width is unlikely: are its terms \
             right?",
            100.0 * share
        )
    })
}

/// Doubts about the picture size for which a pose was computed.
pub(super) fn doubt_of_size(given: &GivenView, upright: &Upright) -> Option<String> {
    let k = &upright.lens.intrinsics;
    let (given, stored) = (given.lens.size()?, upright.turn.size((k.width, k.height)));
    let ratio = given.0 as f64 / stored.0 as f64;
    let is_other = given.0.abs_diff(stored.0).max(given.1.abs_diff(stored.1)) > ROUNDING;
    let is_near = (1.0 / NEAR..NEAR).contains(&ratio);
    (is_other && is_near).then(|| {
        format!(
            "the pose is of a picture of {} x {} px, and the photograph of {} x {} px is taken for \
             the same picture at another size: if it was cropped, or one of them undistorted, \
             give the photographs that the poses were computed on",
            given.0, given.1, stored.0, stored.1
        )
    })
}

/// Doubts about a view, based on the points supplied with the poses.
pub(super) fn doubt_of_points(view: &PosedView, points: &[SparsePoint]) -> Option<String> {
    let mut shown = points.iter();
    let is_blind = points.len() >= LEAST_POINTS
        && shown.all(|point| view.camera.shows(point.position.into()).is_none());
    is_blind.then(|| {
        "none of the points lies before the camera and in its picture: a pose must go from the \
         world to a camera with x to the right, y down and z forward, its quaternion begin with w"
            .to_owned()
    })
}
