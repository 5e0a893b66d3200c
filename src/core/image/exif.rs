//! What EXIF says about the lens.

use exif::{Exif, In, Reader, Tag, Value};

/// Diagonal of a 36 x 24 mm frame, mm: what "35 mm equivalent" refers to (CIPA DCG-001).
const FRAME_DIAGONAL_MM: f64 = 43.266_615;

/// Shares of the long side outside which a focal length is taken for a fault of the file: a
/// 12 mm fisheye and a 600 mm telephoto lie inside.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.2..=20.0;

/// The focal length in px of a `width` x `height` image, from a raw EXIF block. `None` where the
/// block is absent, broken, or gives millimetres without any measure of the sensor.
pub(super) fn focal_px(exif: Vec<u8>, width: usize, height: usize) -> Option<f64> {
    let exif = Reader::new().read_raw(exif).ok()?;
    let focal =
        equivalent(&exif, width, height).or_else(|| by_sensor_resolution(&exif, width, height))?;
    PLAUSIBLE
        .contains(&(focal / width.max(height) as f64))
        .then_some(focal)
}

/// From the 35 mm equivalent: the diagonals correspond.
fn equivalent(exif: &Exif, width: usize, height: usize) -> Option<f64> {
    let millimetres = positive(exif, Tag::FocalLengthIn35mmFilm)?;
    Some(millimetres / FRAME_DIAGONAL_MM * (width as f64).hypot(height as f64))
}

/// From the millimetres and the sensor's pixels per length, corrected for a later resize.
fn by_sensor_resolution(exif: &Exif, width: usize, height: usize) -> Option<f64> {
    let millimetres = positive(exif, Tag::FocalLength)?;
    let per_unit = positive(exif, Tag::FocalPlaneXResolution)?;
    let unit_mm = match positive(exif, Tag::FocalPlaneResolutionUnit).map_or(2, |unit| unit as u32)
    {
        2 => 25.4,
        3 => 10.0,
        4 => 1.0,
        5 => 0.001,
        _ => return None,
    };
    let (taken_width, taken_height) = (
        positive(exif, Tag::PixelXDimension)?,
        positive(exif, Tag::PixelYDimension)?,
    );
    // The long sides are compared: a rotated picture keeps its EXIF numbers.
    let resized = width.max(height) as f64 / taken_width.max(taken_height);
    Some(millimetres * per_unit / unit_mm * resized)
}

fn positive(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first()?.to_f64(),
        value => f64::from(value.get_uint(0)?),
    };
    (value.is_finite() && value > 0.0).then_some(value)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use exif::experimental::Writer;
    use exif::{Field, Rational};

    pub(crate) fn block(fields: &[(Tag, Value)]) -> Vec<u8> {
        let fields: Vec<Field> = fields
            .iter()
            .map(|(tag, value)| Field {
                tag: *tag,
                ifd_num: In::PRIMARY,
                value: value.clone(),
            })
            .collect();
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut bytes = std::io::Cursor::new(Vec::new());
        writer.write(&mut bytes, false).expect("EXIF written");
        bytes.into_inner()
    }

    fn rational(num: u32, denom: u32) -> Value {
        Value::Rational(vec![Rational { num, denom }])
    }

    #[test]
    fn the_35_mm_equivalent_maps_diagonal_to_diagonal() {
        let exif = block(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![50]))]);
        let focal = focal_px(exif, 3600, 2400).expect("a focal length");
        assert!((focal - 5000.0).abs() < 0.1, "{focal}");
    }

    #[test]
    fn sensor_resolution_gives_px_also_after_a_resize_and_a_rotation() {
        let exif = block(&[
            (Tag::FocalLength, rational(50, 1)),
            (Tag::FocalPlaneXResolution, rational(2540, 1)),
            (Tag::FocalPlaneResolutionUnit, Value::Short(vec![2])),
            (Tag::PixelXDimension, Value::Long(vec![4000])),
            (Tag::PixelYDimension, Value::Long(vec![3000])),
        ]);
        assert!((focal_px(exif.clone(), 4000, 3000).expect("px") - 5000.0).abs() < 1e-6);
        assert!((focal_px(exif, 1500, 2000).expect("px") - 2500.0).abs() < 1e-6);
    }

    #[test]
    fn millimetres_alone_zeros_and_nonsense_give_nothing() {
        assert_eq!(
            focal_px(block(&[(Tag::FocalLength, rational(50, 1))]), 4000, 3000),
            None
        );
        assert_eq!(
            focal_px(
                block(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![0]))]),
                4000,
                3000
            ),
            None
        );
        assert_eq!(
            focal_px(
                block(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![60_000]))]),
                4000,
                3000
            ),
            None
        );
        assert_eq!(focal_px(b"not EXIF at all".to_vec(), 4000, 3000), None);
    }
}
