//! Intrinsics as instant-ngp, nerfstudio and those who convert to them write them.

use std::f64::consts::PI;

use serde_json::Value;

use super::json::Fields;
use crate::dataset::given_view::{Focal, GivenLens};
use crate::poses::Distortion;

/// Fields that tell the focal length.
const FOCAL: [&str; 4] = ["fl_x", "fl_y", "camera_angle_x", "camera_angle_y"];

/// Fields that tell the distortion.
const TERMS: [&str; 8] = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];

/// How a lens maps directions.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Projection {
    /// OpenCV's k1, k2, k3 in the numerator, then k4 as its fourth term.
    Polynomial,
    /// OpenCV's k1..k6.
    Rational,
    /// OpenCV's k1..k4 of the angle.
    Fisheye,
}

/// The lens of a frame.
///
/// # Errors
/// Which field is wrong, and how.
pub(super) fn lens(fields: &Fields<'_>) -> Result<GivenLens, String> {
    let distortion = distortion(fields)?;
    let focal = focal(&fields.together(&FOCAL))?;
    let centre = [fields.number("cx")?, fields.number("cy")?];
    match (fields.number("w")?, fields.number("h")?) {
        (Some(width), Some(height)) => {
            if !(width >= 1.0 && height >= 1.0 && width.max(height) < 1e6) {
                return Err(format!("`w` and `h` are {width} and {height}"));
            }
            let size = (width.round() as usize, height.round() as usize);
            let unsized_lens = GivenLens::OfPhotograph {
                focal,
                centre,
                distortion,
            };
            Ok(unsized_lens.at(size.0, size.1).into())
        }
        (None, None) => Ok(GivenLens::OfPhotograph {
            focal,
            centre,
            distortion,
        }),
        (Some(_), None) => Err("`w` without `h`".to_owned()),
        (None, Some(_)) => Err("`h` without `w`".to_owned()),
    }
}

fn focal(fields: &Fields<'_>) -> Result<Focal, String> {
    let positive = |key: &str, below: f64| match fields.number(key)? {
        Some(value) if !(value > 0.0 && value < below) => Err(format!("`{key}` is {value}")),
        value => Ok(value),
    };
    let pixels = (
        positive("fl_x", f64::INFINITY)?,
        positive("fl_y", f64::INFINITY)?,
    );
    let angles = (
        positive("camera_angle_x", PI)?,
        positive("camera_angle_y", PI)?,
    );
    match (pixels, angles) {
        ((Some(fx), fy), _) => Ok(Focal::Pixels([fx, fy.unwrap_or(fx)])),
        ((None, Some(fy)), _) => Ok(Focal::Pixels([fy, fy])),
        (_, (None, None)) => Err("neither `fl_x` nor `camera_angle_x` is told".to_owned()),
        (_, (x, y)) => Ok(Focal::Angles([x, y])),
    }
}

/// The projection of a frame, by its own `camera_model` or else the file's.
fn projection(fields: &Fields<'_>) -> Result<Projection, String> {
    if let Some(key) = ["ftheta_p0", "ftheta_p1"]
        .iter()
        .find(|key| fields.get(key).is_some())
    {
        return Err(format!("`{key}`: f-theta lenses are not read"));
    }
    let model = fields.get("camera_model");
    let name = model.map_or(Some(""), Value::as_str).unwrap_or("?");
    match &*name.to_ascii_uppercase() {
        _ if fields.get("is_fisheye") == Some(&Value::Bool(true)) => Ok(Projection::Fisheye),
        "" | "SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV"
        | "PERSPECTIVE" => Ok(Projection::Polynomial),
        "FULL_OPENCV" => Ok(Projection::Rational),
        "OPENCV_FISHEYE" | "RADIAL_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "FISHEYE" => {
            Ok(Projection::Fisheye)
        }
        _ => Err(format!(
            "`camera_model` is {name}, which is not read: make pictures of PINHOLE, OPENCV or \
             OPENCV_FISHEYE of it"
        )),
    }
}

/// The terms of a frame: its own together, or else the file's if they are of the same projection.
fn terms<'a>(fields: &Fields<'a>, projection: Projection) -> Option<Fields<'a>> {
    let own = fields.together(&TERMS);
    let is_own = TERMS.iter().any(|key| fields.own(key).is_some());
    let of_file = fields.of_file();
    let is_same = || self::projection(&of_file).is_ok_and(|shared| shared == projection);
    (is_own || is_same()).then_some(own)
}

fn distortion(fields: &Fields<'_>) -> Result<Distortion, String> {
    let projection = projection(fields)?;
    let terms = match terms(fields, projection) {
        Some(terms) => terms.numbers(TERMS)?,
        None => [0.0; 8],
    };
    let [k1, k2, k3, k4, k5, k6, p1, p2] = terms;
    if projection != Projection::Rational && (k5 != 0.0 || k6 != 0.0) {
        return Err("`k5` and `k6` are read with `camera_model` FULL_OPENCV only".to_owned());
    }
    let tangential = [p1, p2];
    Ok(match projection {
        Projection::Fisheye => Distortion::Fisheye {
            radial: [k1, k2, k3, k4],
        },
        Projection::Polynomial if k4 != 0.0 => Distortion::Polynomial {
            radial: [k1, k2, k3, k4],
            tangential,
        },
        Projection::Polynomial => Distortion::Perspective {
            radial: [k1, k2, k3, 0.0, 0.0, 0.0],
            tangential,
        },
        Projection::Rational => Distortion::Perspective {
            radial: [k1, k2, k3, k4, k5, k6],
            tangential,
        },
    })
}

/// Whether it is a fisheye lens with tangential terms.
pub(super) fn has_unused_terms(fields: &Fields<'_>) -> bool {
    let is_told = |key| matches!(fields.number(key), Ok(Some(term)) if term != 0.0);
    matches!(projection(fields), Ok(Projection::Fisheye)) && (is_told("p1") || is_told("p2"))
}
