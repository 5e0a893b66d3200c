//! Writes DNGs for tests.

use glam::{DMat3, DVec3};

use super::XYZ_OF_SRGB;

pub(crate) const BLACK: u16 = 512;
pub(crate) const WHITE: u16 = 15_360;

/// The camera's response to white, as shot: neutral.
const NEUTRAL: [f64; 4] = [0.5, 1.0, 0.7, 0.8];

/// Linear sRGB to the camera's balanced colours, rows summing to 1.
fn camera() -> DMat3 {
    DMat3::from_cols_array(&[0.7, 0.2, 0.05, 0.25, 0.7, 0.3, 0.05, 0.1, 0.65])
}

/// The colours of a sensor's samples, as DNG numbers them, or all three in each.
#[derive(Clone, Copy)]
pub(crate) enum Sensor {
    Bayer,
    XTrans,
    Linear,
    /// With emerald, half green and half blue, in place of each other green.
    Emerald,
}

impl Sensor {
    fn pattern(self) -> (usize, Vec<u8>) {
        match self {
            Self::Bayer => (2, vec![0, 1, 1, 2]),
            Self::XTrans => {
                let rows = ["GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG"];
                let colour = |c: char| "RGB".find(c).unwrap_or(1) as u8;
                (6, rows.iter().flat_map(|row| row.chars().map(colour)).collect())
            }
            Self::Linear => (0, Vec::new()),
            Self::Emerald => (2, vec![0, 1, 3, 2]),
        }
    }
}

/// A DNG of light (linear sRGB at `(x, y)`, white at 1), clipped at the sensor's white level and at
/// none below; `neutral` scales its recorded white balance.
pub(crate) fn written(
    sensor: Sensor,
    (width, height): (usize, usize),
    orientation: u16,
    neutral: [f64; 3],
    light: impl Fn(usize, usize) -> [f64; 3],
) -> Vec<u8> {
    let (period, pattern) = sensor.pattern();
    let mut samples = Vec::new();
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let [red, green, blue] = (camera() * DVec3::from_array(light(x, y))).to_array();
        let balanced = [red, green, blue, 0.5 * (green + blue)];
        let colours = match period {
            0 => vec![0, 1, 2],
            _ => vec![usize::from(pattern[y % period * period + x % period])],
        };
        for colour in colours {
            let value = balanced[colour] * NEUTRAL[colour];
            let code = f64::from(BLACK) + value * f64::from(WHITE - BLACK);
            samples.push(code.round().clamp(0.0, f64::from(WHITE)) as u16);
        }
    }
    let planes = if period == 0 { 3_u16 } else { 1 };
    let matrix = camera() * XYZ_OF_SRGB.inverse();
    // Rows of a matrix from XYZ; a camera's differ by its white, which balance takes out.
    let rows = [matrix.row(0), matrix.row(1), matrix.row(2), (matrix.row(1) + matrix.row(2)) / 2.0];
    let rows = (0..4).map(|colour| NEUTRAL[colour] * rows[colour]);
    let colours = if matches!(sensor, Sensor::Emerald) { 4 } else { 3 };
    let rows: Vec<f64> = rows.take(colours).flat_map(|row| row.to_array()).collect();
    let shot = [neutral[0], neutral[1], neutral[2], 1.0];
    let shot: Vec<f64> = (0..colours).map(|c| NEUTRAL[c] * shot[c]).collect();
    let mut tags = Tags::default();
    tags.long(254, &[0]);
    tags.long(256, &[width as u32]);
    tags.long(257, &[height as u32]);
    tags.short(258, &vec![16; usize::from(planes)]);
    tags.short(259, &[1]);
    tags.short(262, &[if period == 0 { 34_892 } else { 32_803 }]);
    tags.ascii(271, "Fled");
    tags.ascii(272, "Test");
    tags.long(273, &[0]);
    tags.short(274, &[orientation]);
    tags.short(277, &[planes]);
    tags.long(278, &[height as u32]);
    tags.long(279, &[2 * samples.len() as u32]);
    tags.short(284, &[1]);
    tags.rational(33_434, &[0.05]);
    tags.rational(33_437, &[2.0]);
    if period > 0 {
        tags.short(33_421, &[period as u16; 2]);
        tags.byte(33_422, &pattern);
    }
    tags.short(34_855, &[1600]);
    tags.short(41_989, &[28]);
    tags.byte(50_706, &[1, 4, 0, 0]);
    tags.ascii(50_708, "Fled Test");
    if colours == 4 {
        // Cyan comes next to it.
        tags.byte(50_710, &[0, 1, 2, 3]);
    }
    tags.long(50_714, &vec![u32::from(BLACK); usize::from(planes)]);
    tags.long(50_717, &vec![u32::from(WHITE); usize::from(planes)]);
    tags.signed_rational(50_721, &rows);
    tags.rational(50_728, &shot);
    tags.short(50_778, &[21]);
    tags.file(273, &samples)
}

/// The white balance as shot, for `neutral` of 1.
pub(crate) fn balance() -> [f32; 3] {
    [2.0, 1.0, 1.0 / 0.7]
}

/// The entries of a TIFF's directory: tag, type, number of values, bytes.
#[derive(Default)]
struct Tags(Vec<(u16, u16, u32, Vec<u8>)>);

impl Tags {
    fn byte(&mut self, tag: u16, values: &[u8]) {
        self.0.push((tag, 1, values.len() as u32, values.to_vec()));
    }

    fn ascii(&mut self, tag: u16, text: &str) {
        let bytes = [text.as_bytes(), &[0]].concat();
        self.0.push((tag, 2, bytes.len() as u32, bytes));
    }

    fn short(&mut self, tag: u16, values: &[u16]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.0.push((tag, 3, values.len() as u32, bytes));
    }

    fn long(&mut self, tag: u16, values: &[u32]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.0.push((tag, 4, values.len() as u32, bytes));
    }

    fn rational(&mut self, tag: u16, values: &[f64]) {
        let of = |v: &f64| [(1e6 * v).round() as u32, 1_000_000];
        let bytes = values.iter().flat_map(of).flat_map(u32::to_le_bytes).collect();
        self.0.push((tag, 5, values.len() as u32, bytes));
    }

    fn signed_rational(&mut self, tag: u16, values: &[f64]) {
        let of = |v: &f64| [(1e6 * v).round() as i32, 1_000_000];
        let bytes = values.iter().flat_map(of).flat_map(i32::to_le_bytes).collect();
        self.0.push((tag, 10, values.len() as u32, bytes));
    }

    /// The file; the entry `offset` is pointed to the samples.
    fn file(mut self, offset: u16, samples: &[u16]) -> Vec<u8> {
        let directory = 8 + 2 + 12 * self.0.len() + 4;
        let outside: usize = self
            .0
            .iter()
            .filter(|tag| tag.3.len() > 4)
            .map(|tag| tag.3.len().next_multiple_of(2))
            .sum();
        let start = (directory + outside) as u32;
        let strips = self.0.iter_mut().find(|tag| tag.0 == offset).expect("an offset");
        strips.3 = start.to_le_bytes().to_vec();
        let mut bytes = b"II*\0\x08\0\0\0".to_vec();
        bytes.extend((self.0.len() as u16).to_le_bytes());
        let mut tail = Vec::new();
        for (tag, kind, count, mut value) in self.0 {
            bytes.extend(tag.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            bytes.extend(count.to_le_bytes());
            if value.len() > 4 {
                bytes.extend(((directory + tail.len()) as u32).to_le_bytes());
                value.resize(value.len().next_multiple_of(2), 0);
                tail.extend(value);
            } else {
                value.resize(4, 0);
                bytes.extend(value);
            }
        }
        bytes.extend([0; 4]);
        bytes.extend(tail);
        bytes.extend(samples.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }
}
