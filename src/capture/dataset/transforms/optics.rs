//! Intrinsics as written by instant-ngp, nerfstudio and converters for them.

use std::f64::consts::PI;

use serde_json::Value;

use super::json::{self, Fields};
use crate::dataset::given_view::{Focal, GivenLens};
use crate::poses::Distortion;

/// Fields for the focal length.
const FOCAL: [&str; 6] = ["fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov"];

/// Fields for the distortion.
const TERMS: [&str; 8] = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];

/// nerfstudio's alternative list of k1, k2, k3, k4, p1, p2.
const LIST: &str = "distortion_params";

/// instant-ngp's fields for unsupported lenses.
const UNREAD: [&str; 4] = ["ftheta_p0", "ftheta_p1", "latlong", "equirectangular"];

/// Advice for an unsupported lens.
const INSTEAD: &str = "make pictures of PINHOLE, OPENCV or OPENCV_FISHEYE";

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
/// Names the wrong field and the fault.
pub(super) fn lens(fields: &Fields<'_>) -> Result<GivenLens, String> {
    let distortion = distortion(fields)?;
    let size = size(fields)?;
    let growth = growth(fields, size);
    let centre = |key: &str, axis: usize| match fields.own(key) {
        Some(_) => fields.number(key),
        None => Ok(fields.number(key)?.zip(growth).map(|(c, g)| c * g[axis])),
    };
    let (focal, centre) = match matrix(fields)? {
        Some([fx, fy, cx, cy]) => (Focal::Pixels([fx, fy]), [Some(cx), Some(cy)]),
        None => {
            let focal = match (focal(&fields.together(&FOCAL))?, growth) {
                (Focal::Pixels([x, y]), Some([wider, higher])) if !fields.has_own(&FOCAL) => {
                    Focal::Pixels([x * wider, y * higher])
                }
                (focal, _) => focal,
            };
            (focal, [centre("cx", 0)?, centre("cy", 1)?])
        }
    };
    let of_photograph = GivenLens::OfPhotograph { focal, centre, distortion };
    Ok(match size {
        Some([width, height]) => {
            of_photograph.at(width.round() as usize, height.round() as usize).into()
        }
        None => of_photograph,
    })
}

/// Focal lengths and principal point from NeuS2's matrix.
fn matrix(fields: &Fields<'_>) -> Result<Option<[f64; 4]>, String> {
    let key = "intrinsic_matrix";
    let Some(rows) = fields.get(key) else {
        return Ok(None);
    };
    let cell = |row: usize, column: usize| json::number(rows.get(row)?.get(column)?);
    let cells = [cell(0, 0), cell(1, 1), cell(0, 2), cell(1, 2)];
    match cells.map(|cell| cell.filter(|number| number.is_finite())) {
        [Some(fx), Some(fy), Some(cx), Some(cy)] if fx > 0.0 && fy > 0.0 => {
            Ok(Some([fx, fy, cx, cy]))
        }
        _ => Err(format!("`{key}` is not of rows fx 0 cx, 0 fy cy, 0 0 1")),
    }
}

/// Width and height, px, if given.
fn size(fields: &Fields<'_>) -> Result<Option<[f64; 2]>, String> {
    match (fields.number("w")?, fields.number("h")?) {
        (Some(width), Some(height)) if width >= 1.0 && height >= 1.0 && width.max(height) < 1e6 => {
            Ok(Some([width, height]))
        }
        (Some(width), Some(height)) => Err(format!("`w` and `h` are {width} and {height}")),
        (None, None) => Ok(None),
        (Some(_), None) => Err("`w` without `h`".to_owned()),
        (None, Some(_)) => Err("`h` without `w`".to_owned()),
    }
}

/// Scale of a frame's picture relative to the size of the file's pixels; `None` if the shapes
/// differ.
fn growth(fields: &Fields<'_>, size: Option<[f64; 2]>) -> Option<[f64; 2]> {
    let (Some([width, height]), Ok(Some([w, h]))) = (size, self::size(&fields.of_file())) else {
        return Some([1.0; 2]);
    };
    let growth = [width / w, height / h];
    ((growth[0] / growth[1] - 1.0).abs() < 0.01).then_some(growth)
}

fn focal(fields: &Fields<'_>) -> Result<Focal, String> {
    let positive = |key: &str, below: f64, unit: &str| match fields.number(key)? {
        Some(value) if !(value > 0.0 && value < below) => {
            Err(format!("`{key}` is {value}, but must be {unit}"))
        }
        value => Ok(value),
    };
    let pixels = |key| positive(key, f64::INFINITY, "a number of pixels above 0");
    let angle = |radians, degrees| {
        let in_radians = positive(radians, PI, "in radians, between 0 and pi")?;
        let in_degrees = positive(degrees, 180.0, "in degrees, between 0 and 180")?;
        Ok::<_, String>(in_radians.or(in_degrees.map(f64::to_radians)))
    };
    let angles = (angle("camera_angle_x", "x_fov")?, angle("camera_angle_y", "y_fov")?);
    match ((pixels("fl_x")?, pixels("fl_y")?), angles) {
        ((Some(fx), fy), _) => Ok(Focal::Pixels([fx, fy.unwrap_or(fx)])),
        ((None, Some(fy)), _) => Ok(Focal::Pixels([fy, fy])),
        (_, (None, None)) => Err("neither `fl_x` nor `camera_angle_x` is in_radians".to_owned()),
        (_, (x, y)) => Ok(Focal::Angles([x, y])),
    }
}

/// The projection of a frame, from its own `camera_model` or else the file's.
fn projection(fields: &Fields<'_>) -> Result<Projection, String> {
    if let Some(key) = UNREAD.iter().find(|key| fields.is_set(key)) {
        return Err(format!("`{key}` is of a lens that is not read: {INSTEAD} of it"));
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
        _ => Err(format!("`camera_model` is {name}, which is not read: {INSTEAD} of it")),
    }
}

/// The terms of a frame in the order of [`TERMS`]: all its own, or else the file's if the
/// projection is the same.
fn terms(fields: &Fields<'_>, projection: Projection) -> Result<[f64; 8], String> {
    let keys = [&TERMS[..], &[LIST]].concat();
    let of_file = fields.of_file();
    let is_same = || self::projection(&of_file).is_ok_and(|shared| shared == projection);
    if !fields.has_own(&keys) && !is_same() {
        return Ok([0.0; 8]);
    }
    let fields = fields.together(&keys);
    let Some(list) = fields.get(LIST) else {
        return fields.numbers(TERMS);
    };
    let numbers = |list: &Vec<Value>| -> Option<Vec<f64>> {
        let finite = |value| json::number(value).filter(|number| number.is_finite());
        list.iter().map(finite).collect()
    };
    match list.as_array().and_then(numbers).as_deref() {
        Some(&[k1, k2, k3, k4, p1, p2]) => Ok([k1, k2, k3, k4, 0.0, 0.0, p1, p2]),
        _ => Err(format!("`{LIST}` is not of 6 numbers: k1, k2, k3, k4, p1, p2")),
    }
}

fn distortion(fields: &Fields<'_>) -> Result<Distortion, String> {
    let projection = projection(fields)?;
    let [k1, k2, k3, k4, k5, k6, p1, p2] = terms(fields, projection)?;
    if projection != Projection::Rational && (k5 != 0.0 || k6 != 0.0) {
        return Err("`k5` and `k6` are read with `camera_model` FULL_OPENCV only".to_owned());
    }
    let tangential = [p1, p2];
    Ok(match projection {
        Projection::Fisheye => Distortion::Fisheye { radial: [k1, k2, k3, k4] },
        Projection::Polynomial if k4 != 0.0 => {
            Distortion::Polynomial { radial: [k1, k2, k3, k4], tangential }
        }
        Projection::Polynomial => {
            Distortion::Perspective { radial: [k1, k2, k3, 0.0, 0.0, 0.0], tangential }
        }
        Projection::Rational => {
            Distortion::Perspective { radial: [k1, k2, k3, k4, k5, k6], tangential }
        }
    })
}

/// Whether it is a fisheye lens with tangential terms.
pub(super) fn has_unused_terms(fields: &Fields<'_>) -> bool {
    let is_known = |key| matches!(fields.number(key), Ok(Some(term)) if term != 0.0);
    matches!(projection(fields), Ok(Projection::Fisheye)) && (is_known("p1") || is_known("p2"))
}
