//! Lens, exposure and orientation from EXIF.

use exif::{Exif, In, Reader, Tag, Value};
use image::metadata::Orientation;
use serde::{Deserialize, Serialize};

/// Prefix of a block in a JPEG, not part of it.
const PREFIX: &[u8] = b"Exif\0\0";

/// Diagonal of a 36 x 24 mm frame, mm: what "35 mm equivalent" refers to (CIPA DCG-001).
const FRAME_DIAGONAL_MM: f64 = 43.266_615;

/// Range of plausible focal lengths, as shares of the long side; others are errors in the file: a
/// 12 mm fisheye and a 600 mm telephoto are inside.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.2..=20.0;

/// Reads the readable part of a raw EXIF block. WebP and PNG may repeat the JPEG prefix.
pub(super) fn read(mut block: Vec<u8>) -> Option<Exif> {
    if block.starts_with(PREFIX) {
        block.drain(..PREFIX.len());
    }
    let mut reader = Reader::new();
    let exif = reader.continue_on_error(true).read_raw(block);
    exif.or_else(|error| error.distill_partial_result(drop)).ok()
}

/// The orientation; programs write it with any integer type.
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

/// The focal length in px of a `width` x `height` image. `None` if the block gives millimetres
/// without a sensor size.
pub(super) fn focal_px(exif: &Exif, width: usize, height: usize) -> Option<f64> {
    let focal = match positive(exif, Tag::FocalLengthIn35mmFilm) {
        Some(millimetres) => of_diagonals(millimetres, width, height),
        None => by_sensor_resolution(exif, width, height)?,
    };
    plausible(focal, width, height)
}

/// The focal length in px for a 35 mm equivalent.
pub(super) fn of_equivalent(millimetres: f64, width: usize, height: usize) -> Option<f64> {
    plausible(of_diagonals(millimetres, width, height), width, height)
}

fn plausible(focal: f64, width: usize, height: usize) -> Option<f64> {
    PLAUSIBLE.contains(&(focal / width.max(height) as f64)).then_some(focal)
}

/// From the 35 mm equivalent: the diagonals correspond.
fn of_diagonals(millimetres: f64, width: usize, height: usize) -> f64 {
    millimetres / FRAME_DIAGONAL_MM * (width as f64).hypot(height as f64)
}

/// From the focal length in millimetres and the sensor's resolution, corrected for a later resize.
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
    // Compare the long sides: a rotated picture keeps its EXIF numbers.
    let resized = width.max(height) as f64 / taken_width.max(taken_height);
    Some(millimetres * per_unit / unit_mm * resized)
}

/// The exposure of a photograph.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shot {
    /// Exposure time, s.
    pub seconds: f64,
    /// Sensitivity, ISO.
    pub iso: f64,
    /// Aperture; often missing on phones, where it is fixed.
    pub f_number: Option<f64>,
}

impl Shot {
    /// The exposure in stops above 1 s at ISO 1, and at f/1 if the aperture is included.
    pub fn stops(&self, has_aperture: bool) -> f64 {
        let aperture = self.f_number.filter(|_| has_aperture).map_or(0.0, |f| 2.0 * f.log2());
        self.seconds.log2() + self.iso.log2() - aperture
    }
}

/// The recorded exposure: as numbers, or else in APEX units (EXIF 2.32, annex C). `None` without a
/// time and a sensitivity.
pub(super) fn shot(exif: &Exif) -> Option<Shot> {
    let seconds = positive(exif, Tag::ExposureTime)
        .or_else(|| Some(number(exif, Tag::ShutterSpeedValue)?.exp2().recip()));
    let iso = [
        Tag::PhotographicSensitivity,
        Tag::ISOSpeed,
        Tag::RecommendedExposureIndex,
        Tag::StandardOutputSensitivity,
    ];
    // 65535 in the first tag means a sensitivity that does not fit it.
    let iso = iso.into_iter().filter_map(|tag| positive(exif, tag)).find(|iso| *iso != 65_535.0);
    let f_number = positive(exif, Tag::FNumber)
        .or_else(|| Some((0.5 * number(exif, Tag::ApertureValue)?).exp2()));
    let plausible = |value: &f64| value.is_finite() && *value > 0.0;
    Some(Shot {
        seconds: seconds.filter(plausible)?,
        iso: iso?,
        f_number: f_number.filter(plausible),
    })
}

/// The first rational of a field, of either sign.
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first()?.to_f64(),
        Value::SRational(values) => values.first()?.to_f64(),
        _ => return None,
    };
    value.is_finite().then_some(value)
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
    fn orientation_of_every_integer_type_and_byte_order_is_read_also_after_the_prefix() {
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
    fn the_exposure_is_read_as_numbers_or_in_apex_units() {
        let of = |fields: &[(Tag, Value)]| shot(&read(block(fields)).expect("EXIF"));
        let iso = |iso| Value::Short(vec![iso]);
        let apex = |num, denom| Value::SRational(vec![exif::SRational { num, denom }]);
        let written = [
            (Tag::ExposureTime, rational(1, 16)),
            (Tag::FNumber, rational(2, 1)),
            (Tag::PhotographicSensitivity, iso(1600)),
        ];
        let wanted = Shot { seconds: 1.0 / 16.0, iso: 1600.0, f_number: Some(2.0) };
        assert_eq!(of(&written), Some(wanted));
        let in_apex = [
            (Tag::ShutterSpeedValue, apex(4, 1)),
            (Tag::ApertureValue, rational(2, 1)),
            (Tag::PhotographicSensitivity, iso(1600)),
        ];
        assert_eq!(of(&in_apex), Some(wanted));
        let long =
            [(Tag::ShutterSpeedValue, apex(-2, 1)), (Tag::PhotographicSensitivity, iso(100))];
        let found = of(&long).expect("an exposure");
        assert_eq!((found.seconds, found.f_number), (4.0, None));
        let high = [
            (Tag::ExposureTime, rational(1, 2)),
            (Tag::PhotographicSensitivity, iso(65_535)),
            (Tag::RecommendedExposureIndex, Value::Long(vec![102_400])),
        ];
        assert_eq!(of(&high).map(|shot| shot.iso), Some(102_400.0));
        assert_eq!(of(&written[..2]), None, "no sensitivity");
        assert_eq!(of(&[(Tag::ExposureTime, rational(0, 1)), written[2].clone()]), None);
        assert!((wanted.stops(true) - (1600.0_f64 / 64.0).log2()).abs() < 1e-12);
        assert!((wanted.stops(false) - 100.0_f64.log2()).abs() < 1e-12);
    }

    #[test]
    fn the_35_mm_equivalent_maps_diagonal_to_diagonal() {
        let exif = block(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![50]))]);
        let focal = focal_px(exif, 3600, 2400).expect("a focal length");
        assert!((focal - 5000.0).abs() < 0.1, "{focal}");
    }

    #[test]
    fn sensor_resolution_gives_px_even_after_a_resize_and_a_rotation() {
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
