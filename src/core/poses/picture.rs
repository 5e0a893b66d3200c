//! A picture of the poses: cameras and points from above.

use std::fmt::Write as _;

use glam::{DVec2, DVec3};

use super::{PoseStatus, Poses};
use crate::camera::{Camera, upright};

/// Width and height of the drawing, px.
const SIDE: f64 = 800.0;

/// Margin around it, px.
const MARGIN: f64 = 40.0;

/// Maximum number of points drawn.
const POINTS: usize = 3000;

/// Share of the points on each side that may be outside: some are far away by mistake.
const OUTLIERS: f64 = 0.03;

/// Length of a camera, px.
const CAMERA: f64 = 16.0;

/// Points, cameras and their names, seen along the up direction of the photographs, as an SVG file;
/// views without a pose are listed below.
pub fn svg(poses: &Poses) -> String {
    let cameras: Vec<&Camera> = poses.views.iter().map(|view| &view.camera).collect();
    let plan =
        Plan::new(&cameras, &poses.points.iter().map(|p| p.position.into()).collect::<Vec<_>>());
    let side = SIDE + 2.0 * MARGIN;
    let notes = notes(poses);
    let height = side + 20.0 * notes.len() as f64;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {side} {height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"{side}\" height=\"{height}\" fill=\"#fff\"/>\n\
         <path fill=\"none\" stroke=\"#888\" stroke-width=\"2\" stroke-linecap=\"round\" d=\""
    );
    let step = poses.points.len().div_ceil(POINTS).max(1);
    for point in poses.points.iter().step_by(step) {
        let DVec2 { x, y } = plan.place(point.position.into());
        if (0.0..side).contains(&x) && (0.0..side).contains(&y) {
            let _ = write!(text, "M{x:.1} {y:.1}h0");
        }
    }
    text.push_str("\"/>\n");
    for view in &poses.views {
        let at = plan.place(view.camera.centre());
        let ahead = plan.turn(view.camera.rotation().transpose() * DVec3::Z) * CAMERA;
        let aside = 0.45 * ahead.perp();
        let (left, right) = (at + ahead + aside, at + ahead - aside);
        let _ = writeln!(
            text,
            "<path fill=\"#1667c7\" fill-opacity=\".25\" stroke=\"#1667c7\" \
             d=\"M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            at.x,
            at.y,
            left.x,
            left.y,
            right.x,
            right.y,
            at.x - 0.6 * ahead.x,
            at.y - 0.6 * ahead.y,
            view.name
        );
    }
    for (line, note) in notes.iter().enumerate() {
        let y = side + 20.0 * line as f64;
        let _ = writeln!(text, "<text x=\"{MARGIN}\" y=\"{y}\">{note}</text>");
    }
    text.push_str("</svg>\n");
    text
}

/// Notes on what the picture does not show.
fn notes(poses: &Poses) -> Vec<String> {
    let named = |status: PoseStatus, words: &str| {
        let verdicts = poses.verdicts.iter().filter(|verdict| verdict.status == status);
        let names: Vec<&str> = verdicts.map(|verdict| &*verdict.name).collect();
        (!names.is_empty()).then(|| format!("{words}: {}", names.join(", ")))
    };
    let count = format!(
        "{} of {} photographs, {} points, from above",
        poses.registered,
        poses.total,
        poses.points.len()
    );
    let missing = [
        named(PoseStatus::Doubtful, "doubtful, left out"),
        named(PoseStatus::NotFound, "not placed"),
        named(PoseStatus::TakenOut, "taken out, as they did not fit the scene"),
        named(PoseStatus::Given, "as given, unchecked"),
        named(PoseStatus::Late, "placed with the scene"),
    ];
    std::iter::once(count).chain(missing.into_iter().flatten()).collect()
}

/// The ground plane in the picture.
struct Plan {
    right: DVec3,
    down: DVec3,
    /// The corner of the drawing, in world coordinates.
    corner: DVec2,
    /// px of the picture.
    scale: f64,
}

impl Plan {
    fn new(cameras: &[&Camera], points: &[DVec3]) -> Self {
        let all: Vec<Camera> = cameras.iter().map(|camera| **camera).collect();
        let up = upright::up(&all).unwrap_or(DVec3::NEG_Y);
        let right = up.any_orthonormal_vector();
        let mut plan = Self { right, down: right.cross(up), corner: DVec2::ZERO, scale: 1.0 };
        let centres: Vec<DVec3> = cameras.iter().map(|camera| camera.centre()).collect();
        let range = |axis: DVec3| {
            let along = |places: &[DVec3]| -> Vec<f64> {
                let mut along: Vec<f64> = places.iter().map(|place| place.dot(axis)).collect();
                along.retain(|value| value.is_finite());
                along.sort_by(f64::total_cmp);
                along
            };
            let (points, cameras) = (along(points), along(&centres));
            let outside = (OUTLIERS * points.len() as f64) as usize;
            let inner = &points[outside..points.len() - outside];
            let both = inner.iter().chain(&cameras).copied();
            (both.clone().fold(f64::MAX, f64::min), both.fold(f64::MIN, f64::max))
        };
        let ((left, rightmost), (top, bottom)) = (range(plan.right), range(plan.down));
        let longest = (rightmost - left).max(bottom - top);
        if longest.is_finite() && longest > 0.0 {
            let middle = DVec2::new(left + rightmost, top + bottom) / 2.0;
            plan.scale = SIDE / longest;
            plan.corner = middle - DVec2::splat(longest / 2.0);
        }
        plan
    }

    fn place(&self, place: DVec3) -> DVec2 {
        let flat = DVec2::new(place.dot(self.right), place.dot(self.down));
        (flat - self.corner) * self.scale + DVec2::splat(MARGIN)
    }

    /// A direction, shortened by its slope.
    fn turn(&self, direction: DVec3) -> DVec2 {
        DVec2::new(direction.dot(self.right), direction.dot(self.down))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::poses::{Distortion, Lens, PoseVerdict, PosedView, SparsePoint};

    fn ring(count: usize) -> Poses {
        let intrinsics =
            Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        let view = |index: usize| {
            let angle = std::f64::consts::TAU * index as f64 / count as f64;
            let eye = DVec3::new(4.0 * angle.cos(), -1.0, 4.0 * angle.sin());
            PosedView {
                name: format!("view{index}"),
                camera: Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y),
                lens: Lens { intrinsics, distortion: Distortion::None },
            }
        };
        let point = |index: usize| SparsePoint {
            position: [(index % 7) as f64 / 7.0, 0.0, (index % 11) as f64 / 11.0],
            colour: [0; 3],
            error: 0.1,
            track: 3,
        };
        let verdict = |name: &str, status| PoseVerdict {
            name: name.to_owned(),
            status,
            matches: 0,
            fitting: 0,
            error_px: None,
            fit: None,
        };
        Poses {
            views: (0..count).map(view).collect(),
            points: (0..10_000).map(point).collect(),
            registered: count,
            total: count + 2,
            source: "made up".to_owned(),
            strategy: Some('L'),
            verdicts: vec![
                verdict("odd", PoseStatus::Doubtful),
                verdict("lost", PoseStatus::NotFound),
            ],
            parts: Vec::new(),
            mean_reprojection_error: None,
            mean_track: None,
            low_confidence: false,
            network: None,
            seconds: 1.0,
            ..Poses::default()
        }
    }

    #[test]
    fn every_camera_is_drawn_with_its_name_and_missing_ones_are_listed() {
        let text = svg(&ring(12));
        assert_eq!(text.matches("<text").count(), 12 + 3);
        assert!(text.contains(">view11</text>"));
        assert!(text.contains("12 of 14 photographs, 10000 points"));
        assert!(text.contains("doubtful, left out: odd") && text.contains("not placed: lost"));
        let dots = text.matches("h0").count();
        assert!((2000..=POINTS).contains(&dots), "{dots}");
    }

    #[test]
    fn a_ring_is_drawn_as_a_ring_whose_cameras_look_inwards() {
        let poses = ring(12);
        let cameras: Vec<&Camera> = poses.views.iter().map(|view| &view.camera).collect();
        let plan = Plan::new(&cameras, &[]);
        let middle = DVec2::splat(MARGIN + SIDE / 2.0);
        for camera in cameras {
            let at = plan.place(camera.centre());
            assert!((at.distance(middle) - SIDE / 2.0).abs() < 1.0, "{at}");
            let ahead = plan.turn(camera.rotation().transpose() * DVec3::Z);
            assert!(ahead.dot(middle - at) > 0.0);
        }
    }

    #[test]
    fn poses_without_points_or_views_are_drawn_too() {
        let mut poses = ring(3);
        poses.points.clear();
        assert!(!svg(&poses).contains("NaN"));
        poses.views.clear();
        let text = svg(&poses);
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }
}
