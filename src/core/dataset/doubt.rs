//! Given poses that can be used, and are unlikely to be right.

use super::given_view::GivenView;
use super::upright::Upright;
use crate::poses::{Distortion, Lens, PosedView, SparsePoint};

/// Shortest focal length of a lens that is no fisheye, in long sides: it sees 136 degrees.
const SHORTEST: f64 = 0.2;

/// Longest focal length, in long sides.
const LONGEST: f64 = 20.0;

/// By how much of a side the principal point may lie beside the middle: a lens that is shifted as
/// far as those for buildings are has less.
const ASIDE: f64 = 0.3;

/// How much of the width a distortion leaves at least.
const LEAST_SHARE: f64 = 0.6;

/// By how much a picture of a pose may be larger or smaller than the photograph, so that it may be
/// another cut of it: photographs that are made smaller on purpose become much smaller.
const NEAR: f64 = std::f64::consts::SQRT_2;

/// Rounding of sides, px, over several changes of size.
const ROUNDING: usize = 2;

/// Fewer points do not show where a view looks.
const LEAST_POINTS: usize = 50;

/// Mean error of triangulated points, px of the pose copies, over which matches do not fit the
/// poses if most points have two views, the fewest that a point can have. On two real captures with
/// right poses, bright and dark, 0.10 to 0.21 of the points have two and the error is 0.65 to 1.04;
/// of three views all have two, and it is 0.33 to 0.71. With inverted poses, x y z w for w x y z or
/// a principal point in the corner 0.53 or more have two, and it is 1.24 or more.
const WORST_FIT: f64 = 1.15;

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

/// Doubts about the size of the picture that a pose was computed on.
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

/// Doubts about a view, by the points that came with the poses.
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

/// Doubts about poses at which matches were triangulated.
pub(super) fn doubt_of_fit(points: &[SparsePoint]) -> Option<String> {
    let count = points.len();
    let of_two = points.iter().filter(|point| point.track <= 2).count();
    let error = points.iter().map(|point| point.error).sum::<f64>() / count as f64;
    (2 * of_two > count && error > WORST_FIT).then(|| {
        format!(
            "matches between the photographs fit the poses badly: {of_two} of {count} points are \
             seen by two photographs only, and they are off by {error:.1} px; are axes and focal \
             lengths those of the format, and the photographs those of the poses?"
        )
    })
}
