//! What EXIF says about the lens, and which way the camera was held.

use exif::{Exif, In, Reader, Tag, Value};
use image::metadata::Orientation;

/// What begins a block in a JPEG, and is no part of it.
const PREFIX: &[u8] = b"Exif\0\0";

/// Diagonal of a 36 x 24 mm frame, mm: what "35 mm equivalent" refers to (CIPA DCG-001).
const FRAME_DIAGONAL_MM: f64 = 43.266_615;

/// Shares of the long side outside which a focal length is taken for a fault of the file: a
/// 12 mm fisheye and a 600 mm telephoto lie inside.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.2..=20.0;

/// Reads a raw EXIF block, as far as it can be read. WebP and PNG may repeat the name that begins
/// it in a JPEG.
pub(super) fn read(mut block: Vec<u8>) -> Option<Exif> {
    if block.starts_with(PREFIX) {
        block.drain(..PREFIX.len());
    }
    let mut reader = Reader::new();
    let exif = reader.continue_on_error(true).read_raw(block);
    exif.or_else(|error| error.distill_partial_result(drop)).ok()
}

/// How the picture is to be turned; of whichever integer type, as programs write it.
pub(super) fn orientation(exif: &Exif) -> Option<Orientation> {
    let value = &exif.get_field(Tag::Orientation, In::PRIMARY)?.value;
    let number = match value {
        Value::SByte(values) => u8::try_from(*values.first()?).ok()?,
        Value::SShort(values) => u8::try_from(*values.first()?).ok()?,
        Value::SLong(values) => u8::try_from(*values.first()?).ok()?,
        value => u8::try_from(value.get_uint(0)?).ok()?,
    };
    Orientation::from_exif(number)
}

/// The focal length in px of a `width` x `height` image. `None` where the block gives millimetres
/// without any measure of the sensor.
pub(super) fn focal_px(exif: &Exif, width: usize, height: usize) -> Option<f64> {
    let focal =
        equivalent(exif, width, height).or_else(|| by_sensor_resolution(exif, width, height))?;
    PLAUSIBLE.contains(&(focal / width.max(height) as f64)).then_some(focal)
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
    let (taken_width, taken_height) =
        (positive(exif, Tag::PixelXDimension)?, positive(exif, Tag::PixelYDimension)?);
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
        ordered_block(fields, false)
    }

    fn ordered_block(fields: &[(Tag, Value)], little_endian: bool) -> Vec<u8> {
        let fields: Vec<Field> = fields
            .iter()
            .map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() })
            .collect();
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut bytes = std::io::Cursor::new(Vec::new());
        writer.write(&mut bytes, little_endian).expect("EXIF written");
        bytes.into_inner()
    }

    /// From the block itself.
    fn focal_px(block: Vec<u8>, width: usize, height: usize) -> Option<f64> {
        super::focal_px(&read(block)?, width, height)
    }

    fn rational(num: u32, denom: u32) -> Value {
        Value::Rational(vec![Rational { num, denom }])
    }

    #[test]
    fn orientation_of_every_integer_type_and_byte_order_is_read_behind_the_prefix_too() {
        let values = [
            Value::Byte(vec![6]),
            Value::Short(vec![6]),
            Value::Long(vec![6]),
            Value::SByte(vec![6]),
            Value::SShort(vec![6]),
            Value::SLong(vec![6]),
        ];
        for value in values {
            for little_endian in [false, true] {
                let block = ordered_block(&[(Tag::Orientation, value.clone())], little_endian);
                for block in [block.clone(), [PREFIX, &block].concat()] {
                    let exif = read(block).expect("EXIF");
                    assert_eq!(orientation(&exif), Some(Orientation::Rotate90), "{value:?}");
                }
            }
        }
        for wrong in [Value::Short(vec![0]), Value::Long(vec![262]), Value::SLong(vec![-1])] {
            let exif = read(block(&[(Tag::Orientation, wrong)])).expect("EXIF");
            assert_eq!(orientation(&exif), None);
        }
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
        assert_eq!(focal_px(block(&[(Tag::FocalLength, rational(50, 1))]), 4000, 3000), None);
        assert_eq!(
            focal_px(block(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![0]))]), 4000, 3000),
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
