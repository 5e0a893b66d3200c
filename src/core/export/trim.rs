//! The part of a scene to export, and its unit of length.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use crate::camera::{NamedCamera, upright};
use crate::gaussians::placement::Placement;
use crate::gaussians::ply::Scene;
use crate::mesh::Detail;

/// Highest degree of the harmonics.
pub const MOST_SH_DEGREE: u32 = 3;

/// Least and largest scale: beyond them 32-bit numbers do not hold a scene.
pub const SCALE_LIMITS: [f64; 2] = [1e-6, 1e6];

/// How an export differs from the scene; by default it does not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trim {
    /// Where Gaussians are kept.
    pub crop: Option<Crop>,
    /// Degree of the harmonics, 0 to [`MOST_SH_DEGREE`]: the scene's are cut, or padded with zeros.
    pub sh_degree: Option<u32>,
    /// Units of the export, such as metres, per unit of the poses' world, if not 1.
    pub scale: Option<f64>,
    /// How fine a mesh is.
    pub mesh: Detail,
}

impl Trim {
    /// Checks a scale.
    ///
    /// # Errors
    /// The rest of a sentence if it is outside [`SCALE_LIMITS`].
    pub fn scale(wanted: f64) -> Result<f64, String> {
        let [least, most] = SCALE_LIMITS;
        if (least..=most).contains(&wanted) {
            return Ok(wanted);
        }
        Err(format!("must be from {least} to {most}, not {wanted}"))
    }

    /// Whether it changes nothing of the scene.
    pub fn is_nothing(&self) -> bool {
        self.keeps_all() && self.scale.is_none()
    }

    /// Whether it leaves nothing of the scene out, and adds nothing.
    pub(super) fn keeps_all(&self) -> bool {
        self.crop.is_none() && self.sh_degree.is_none()
    }

    /// Where the export lies, if its format has a place for it; `is_map` if the cameras' world is
    /// that of a map.
    pub(super) fn placement(&self, cameras: &[NamedCamera], is_map: bool) -> Placement {
        let cameras: Vec<_> = cameras.iter().map(NamedCamera::camera).collect();
        let up = if is_map { upright::up_of_map(&cameras) } else { upright::up(&cameras) };
        let Placement { scale, up: usual } = Placement::default();
        Placement { scale: self.scale.unwrap_or(scale), up: up.unwrap_or(usual) }
    }

    /// The rest of a scene. A Gaussian is inside a crop if its centre is. Scale and fineness of a
    /// mesh do not change the scene.
    pub(super) fn of(&self, scene: Scene) -> Scene {
        let Scene { mut gaussians, normalisation } = scene;
        if let Some(crop) = self.crop {
            let place = |index: usize| {
                normalisation.point_in_world(gaussians.means[index].map(f64::from).into())
            };
            let kept = (0..gaussians.len()).filter(|&index| crop.contains(place(index)));
            gaussians = gaussians.select(&kept.collect::<Vec<_>>());
        }
        if let Some(degree) = self.sh_degree {
            gaussians = gaussians.with_sh_degree(degree);
        }
        Scene { gaussians, normalisation }
    }
}

/// A part of space, in the world of the poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Crop {
    /// A box along the axes.
    Box {
        /// Its middle.
        centre: DVec3,
        /// Its sides along x, y and z.
        size: DVec3,
    },
    /// A sphere.
    Sphere {
        /// Its middle.
        centre: DVec3,
        /// Its radius.
        radius: f64,
    },
}

impl Crop {
    /// How it is written.
    pub const FORMS: &str = "box:X,Y,Z,WIDTH,HEIGHT,DEPTH or sphere:X,Y,Z,RADIUS";

    /// Whether a point is inside.
    pub fn contains(&self, point: DVec3) -> bool {
        match *self {
            Self::Box { centre, size } => (point - centre).abs().cmple(size / 2.0).all(),
            Self::Sphere { centre, radius } => point.distance(centre) <= radius,
        }
    }
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = || format!("`{text}` must be {}", Self::FORMS);
        let (shape, numbers) = text.split_once(':').ok_or_else(form)?;
        let number = |word: &str| {
            let number = word.trim().parse().ok().filter(|number: &f64| number.is_finite());
            number.ok_or_else(|| format!("`{word}` is not a number: {}", form()))
        };
        let numbers: Vec<f64> = numbers.split(',').map(number).collect::<Result<_, _>>()?;
        let (crop, lengths) = match (shape, &numbers[..]) {
            ("box", &[x, y, z, ref size @ ..]) if size.len() == 3 => {
                let centre = DVec3::new(x, y, z);
                (Self::Box { centre, size: DVec3::from_slice(size) }, size)
            }
            ("sphere", &[x, y, z, ref radius @ ..]) if radius.len() == 1 => {
                (Self::Sphere { centre: DVec3::new(x, y, z), radius: radius[0] }, radius)
            }
            _ => return Err(form()),
        };
        match lengths.iter().find(|length| **length <= 0.0) {
            Some(length) => Err(format!("lengths must be positive, not {length}: {}", form())),
            None => Ok(crop),
        }
    }
}

/// The middle of a scene, to say where a crop should be.
#[derive(Clone, Copy, Debug)]
pub struct Middle(DVec3);

impl Middle {
    /// The median of each axis, in the world of the poses; `None` without Gaussians.
    pub(super) fn of(scene: &Scene) -> Option<Self> {
        let means = &scene.gaussians.means;
        let median = |axis: usize| {
            let mut values: Vec<f32> = means.iter().map(|mean| mean[axis]).collect();
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied().map(f64::from)
        };
        let median = DVec3::new(median(0)?, median(1)?, median(2)?);
        Some(Self(scene.normalisation.point_in_world(median)))
    }
}

impl fmt::Display for Middle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DVec3 { x, y, z } = self.0;
        write!(f, "{x:.3},{y:.3},{z:.3}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_and_a_sphere_hold_what_is_inside() {
        let one: Crop = "box:1,2,-3,2,4,6".parse().expect("a box");
        for (point, is_inside) in [
            ([1.0, 2.0, -3.0], true),
            ([2.0, 4.0, -6.0], true),
            ([2.1, 2.0, -3.0], false),
            ([1.0, 4.1, -3.0], false),
            ([1.0, 2.0, 0.1], false),
            ([f64::NAN, 2.0, -3.0], false),
        ] {
            assert_eq!(one.contains(point.into()), is_inside, "{point:?}");
        }
        let one: Crop = "sphere: 512352.5, 0, 0, 2".parse().expect("a sphere");
        assert!(one.contains(DVec3::new(512_352.5, 1.2, -1.5)));
        assert!(!one.contains(DVec3::new(512_352.5, 1.5, -1.5)));
    }

    #[test]
    fn a_crop_that_is_none_says_what_is_wrong() {
        for (text, fault) in [
            ("ball:0,0,0,1", "must be box:X,Y,Z,WIDTH,HEIGHT,DEPTH or sphere:X,Y,Z,RADIUS"),
            ("0,0,0,1", "must be box"),
            ("sphere:0,0,0", "must be box"),
            ("sphere:0,0,0,1,1", "must be box"),
            ("box:0,0,0,1,1", "must be box"),
            ("box:0,0,0,1,1,x", "`x` is not a number"),
            ("box:0,0,0,1,,1", "`` is not a number"),
            ("sphere:0,0,0,inf", "`inf` is not a number"),
            ("sphere:NaN,0,0,1", "`NaN` is not a number"),
            ("sphere:0,0,0,-1", "lengths must be positive, not -1"),
            ("box:0,0,0,1,0,1", "lengths must be positive, not 0"),
        ] {
            let error = text.parse::<Crop>().expect_err(text);
            assert!(error.contains(fault), "{error}");
        }
    }
}
