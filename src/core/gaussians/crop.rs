//! A part of a scene to keep.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::ply::Scene;

impl Scene {
    /// The Gaussians whose centres are inside `crop`; all of them without one.
    ///
    /// # Errors
    /// [`EmptyCrop`] if none of them can be drawn.
    pub fn within(self, crop: Option<Crop>) -> Result<Self, EmptyCrop> {
        let Some(crop) = crop else {
            return Ok(self);
        };
        let Self { gaussians, normalisation } = self;
        let is_inside = |&index: &usize| {
            let centre = gaussians.means[index].map(f64::from);
            crop.contains(normalisation.point_in_world(centre.into()))
        };
        let kept: Vec<_> = (0..gaussians.len()).filter(is_inside).collect();
        if !kept.iter().any(|&index| gaussians.is_usable(index)) {
            let median = |axis: usize| {
                let mut values: Vec<f32> = gaussians.means.iter().map(|mean| mean[axis]).collect();
                values.sort_by(f32::total_cmp);
                values.get(values.len() / 2).copied().map_or(0.0, f64::from)
            };
            let middle = DVec3::new(median(0), median(1), median(2));
            return Err(EmptyCrop { middle: normalisation.point_in_world(middle) });
        }
        Ok(Self { gaussians: gaussians.select(&kept), normalisation })
    }
}

/// Nothing is inside a crop.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "no Gaussian's centre is inside the crop; the middle of the scene is at {:.3},{:.3},{:.3}",
    .middle.x, .middle.y, .middle.z
)]
pub struct EmptyCrop {
    /// The median of each axis, in the world of the poses.
    pub middle: DVec3,
}

/// A part of space, in the world of the poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
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

impl fmt::Display for Crop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Box { centre, size } => {
                let ([x, y, z], [width, height, depth]) = (centre.to_array(), size.to_array());
                write!(f, "box:{x},{y},{z},{width},{height},{depth}")
            }
            Self::Sphere { centre: DVec3 { x, y, z }, radius } => {
                write!(f, "sphere:{x},{y},{z},{radius}")
            }
        }
    }
}

impl From<Crop> for String {
    fn from(crop: Crop) -> Self {
        crop.to_string()
    }
}

impl TryFrom<String> for Crop {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
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
    fn a_crop_is_written_as_it_is_read() {
        for text in ["box:1,2,-3.25,2,4,0.1", "sphere:512352.0625,-5412352.1,0,2"] {
            let crop: Crop = text.parse().expect("a crop");
            assert_eq!(crop.to_string(), text);
            let json = serde_json::to_string(&crop).expect("written");
            assert_eq!(
                (json.trim_matches('"'), serde_json::from_str(&json).ok()),
                (text, Some(crop))
            );
        }
        serde_json::from_str::<Crop>("\"sphere:0,0,0\"").expect_err("no radius");
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
