//! Solids and their intersection with rays.

use glam::{DMat3, DVec2, DVec3};

/// A solid.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    /// An axis-aligned box in its own frame, rotated about the vertical; made by [`Shape::block`].
    Block {
        centre: DVec3,
        half: DVec3,
        turn: f64,
        /// From its own frame to the world.
        frame: DMat3,
    },
    /// A ball.
    Ball { centre: DVec3, radius: f64 },
    /// A ball stretched along the axes of its own frame; `frame` maps to the world.
    Ellipsoid { centre: DVec3, half: DVec3, frame: DMat3 },
    /// The inside of a box: the room's walls.
    Walls { centre: DVec3, half: DVec3 },
}

/// The point at which a ray meets a surface.
pub(super) struct Hit {
    /// Distance in lengths of the ray.
    pub distance: f64,
    /// Outward normal of unit length, world.
    pub normal: DVec3,
    /// Surface coordinates, world units.
    pub surface: DVec2,
    /// The point in the solid's own frame, relative to its centre, world units.
    pub local: DVec3,
    /// Number of the face within the solid: twice the axis, plus one on the positive side.
    pub face: u32,
}

impl Shape {
    /// A box with these `half` sides, rotated about the vertical.
    pub fn block(centre: DVec3, half: DVec3, turn: f64) -> Self {
        Self::Block { centre, half, turn, frame: DMat3::from_rotation_y(turn) }
    }

    /// The first hit in front of the origin.
    pub fn meet(&self, origin: DVec3, ray: DVec3) -> Option<Hit> {
        match *self {
            Self::Ball { centre, radius } => meet_ball(origin - centre, ray, radius),
            Self::Ellipsoid { centre, half, frame } => {
                let inside = frame.transpose();
                let hit = meet_ellipsoid(inside * (origin - centre), inside * ray, half)?;
                Some(Hit { normal: frame * hit.normal, ..hit })
            }
            Self::Walls { centre, half } => {
                let (_, (far, axis)) = slabs(origin - centre, ray, half)?;
                let mut hit = face(origin - centre, ray, far, axis);
                hit.normal = -hit.normal;
                Some(hit)
            }
            Self::Block { centre, half, frame, .. } => {
                let (origin, ray) =
                    (frame.transpose() * (origin - centre), frame.transpose() * ray);
                let ((near, axis), (far, _)) = slabs(origin, ray, half)?;
                if near <= 1e-6 || near > far {
                    return None;
                }
                let hit = face(origin, ray, near, axis);
                Some(Hit { normal: frame * hit.normal, ..hit })
            }
        }
    }

    /// Half of its sides, in its own frame.
    pub fn half(&self) -> DVec3 {
        match *self {
            Self::Ball { radius, .. } => DVec3::splat(radius),
            Self::Block { half, .. } | Self::Ellipsoid { half, .. } | Self::Walls { half, .. } => {
                half
            }
        }
    }

    pub fn centre(&self) -> DVec3 {
        match *self {
            Self::Ball { centre, .. }
            | Self::Block { centre, .. }
            | Self::Ellipsoid { centre, .. }
            | Self::Walls { centre, .. } => centre,
        }
    }
}

/// Entry and exit of a box around the origin: distance and axis; `None` when it is behind.
fn slabs(origin: DVec3, ray: DVec3, half: DVec3) -> Option<((f64, usize), (f64, usize))> {
    let (mut near, mut far) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
    for axis in 0..3 {
        let inverse = 1.0 / ray[axis];
        let a = (-half[axis] - origin[axis]) * inverse;
        let b = (half[axis] - origin[axis]) * inverse;
        if a.min(b) > near.0 {
            near = (a.min(b), axis);
        }
        if a.max(b) < far.0 {
            far = (a.max(b), axis);
        }
    }
    (far.0 > 1e-6).then_some((near, far))
}

/// The hit on the outside of a box's face at a distance along the ray.
fn face(origin: DVec3, ray: DVec3, distance: f64, axis: usize) -> Hit {
    let point = origin + ray * distance;
    let mut normal = DVec3::ZERO;
    normal[axis] = point[axis].signum();
    let surface = DVec2::new(point[(axis + 1) % 3], point[(axis + 2) % 3]);
    Hit {
        distance,
        normal,
        surface,
        local: point,
        face: 2 * axis as u32 + u32::from(point[axis] > 0.0),
    }
}

fn meet_ball(origin: DVec3, ray: DVec3, radius: f64) -> Option<Hit> {
    let (a, b) = (ray.length_squared(), origin.dot(ray));
    let discriminant = b * b - a * (origin.length_squared() - radius * radius);
    if discriminant <= 0.0 {
        return None;
    }
    let distance = (-b - discriminant.sqrt()) / a;
    let normal = (origin + ray * distance) / radius;
    let surface = DVec2::new(normal.z.atan2(normal.x), normal.y.clamp(-1.0, 1.0).asin()) * radius;
    (distance > 1e-6).then_some(Hit { distance, normal, surface, local: normal * radius, face: 0 })
}

fn meet_ellipsoid(origin: DVec3, ray: DVec3, half: DVec3) -> Option<Hit> {
    // In a frame where the ellipsoid is the unit ball; distances along the ray stay the same.
    let hit = meet_ball(origin / half, ray / half, 1.0)?;
    let local = hit.local * half;
    Some(Hit {
        normal: (hit.local / half).normalize(),
        surface: DVec2::new(local.x, local.y),
        local,
        ..hit
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ellipsoids_hits_and_normals_follow_its_surface() {
        let frame = DMat3::from_rotation_z(0.7) * DMat3::from_rotation_y(-0.4);
        let (centre, half) = (DVec3::new(0.3, -0.2, 2.0), DVec3::new(0.5, 0.2, 0.9));
        let shape = Shape::Ellipsoid { centre, half, frame };
        let level = |point: DVec3| (frame.transpose() * (point - centre) / half).length();
        let (mut met, step) = (0, 1e-5);
        for aside in -4..=4 {
            let ray = DVec3::new(0.08 * f64::from(aside), -0.1, 1.0);
            let Some(hit) = shape.meet(DVec3::ZERO, ray) else {
                continue;
            };
            let point = ray * hit.distance;
            assert!((level(point) - 1.0).abs() < 1e-9);
            assert!(hit.normal.dot(ray) < 0.0 && (hit.normal.length() - 1.0).abs() < 1e-9);
            let along = |axis: DVec3| level(point + step * axis) - level(point - step * axis);
            let gradient = DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z));
            assert!(gradient.normalize().distance(hit.normal) < 1e-6);
            met += 1;
        }
        assert!((3..9).contains(&met), "{met} of 9 rays");
        assert!(shape.meet(DVec3::ZERO, -DVec3::Z).is_none());
    }
}
