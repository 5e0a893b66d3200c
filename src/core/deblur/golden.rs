//! The image of the self-test, and a network's known output for it.

use crate::image::Image;

/// Side of the image, px.
pub const SIDE: usize = 64;

/// Largest difference between a network's actual and known output, in units of 0..=1. Providers
/// round differently; a faulty one differs by far more (0.003 and above in the mean).
pub const TOLERANCE: f32 = 2e-3;

/// The known output of a network for [`view`], guided by [`guide`] if it takes one: [3, [`SIDE`],
/// [`SIDE`]], sRGB, not clipped.
#[derive(Clone, Debug, PartialEq)]
pub struct Golden(Vec<f32>);

impl Golden {
    /// Values in the order of planes, rows, columns.
    ///
    /// # Errors
    /// A sentence when there are not `3 SIDE SIDE` values or one is not finite.
    pub fn new(values: Vec<f32>) -> Result<Self, String> {
        if values.len() != 3 * SIDE * SIDE {
            return Err(format!(
                "its output for the self-test has {} values instead of {}",
                values.len(),
                3 * SIDE * SIDE
            ));
        }
        if values.iter().any(|value| !value.is_finite()) {
            return Err("its output for the self-test has a value that is not finite".to_owned());
        }
        Ok(Self(values))
    }

    /// Parses the content of a file: little-endian f32.
    ///
    /// # Errors
    /// As [`Golden::new`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let (values, rest) = bytes.as_chunks::<4>();
        if !rest.is_empty() {
            return Err(format!("its output for the self-test has {} bytes", bytes.len()));
        }
        Self::new(values.iter().map(|value| f32::from_le_bytes(*value)).collect())
    }

    /// The values in the order of planes, rows, columns.
    pub fn values(&self) -> &[f32] {
        &self.0
    }

    /// The largest difference from `values`; a value that is not finite counts as infinite.
    pub fn difference(&self, values: &[f32]) -> f32 {
        let far = |(a, b): (&f32, &f32)| {
            if b.is_finite() { (a - b).abs() } else { f32::INFINITY }
        };
        let short = if values.len() == self.0.len() { 0.0 } else { f32::INFINITY };
        self.0.iter().zip(values).map(far).fold(short, f32::max)
    }
}

/// Smooth colours with an edge, the kind of image that networks are made for.
pub fn view() -> Image {
    pattern(|x, y| (x, y))
}

/// The same, turned on its side, so that a network with swapped inputs returns other values.
pub fn guide() -> Image {
    pattern(|x, y| (y, x))
}

fn pattern(turn: impl Fn(usize, usize) -> (usize, usize)) -> Image {
    let mut image = Image::new(SIDE, SIDE);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let (column, row) = turn(x, y);
            let (u, v) = (column as f32 / SIDE as f32, row as f32 / SIDE as f32);
            let edge = if column / 16 % 2 == row / 16 % 2 { 0.2 } else { 0.0 };
            image.set(x, y, [0.2 + 0.5 * u + edge, 0.2 + 0.5 * v + edge, 0.7 - 0.5 * u * v]);
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_golden_file_has_exactly_all_values() {
        let bytes = 0.5_f32.to_le_bytes().repeat(3 * SIDE * SIDE);
        let golden = Golden::from_bytes(&bytes).expect("whole");
        assert!(golden.values().iter().all(|value| *value == 0.5));
        assert!(Golden::from_bytes(&bytes[4..]).is_err() && Golden::from_bytes(&[0; 7]).is_err());
    }

    #[test]
    fn every_kind_of_wrong_output_is_detected() {
        let golden = Golden::new(view().data().to_vec()).expect("of the right size");
        assert!(golden.difference(view().data()) <= TOLERANCE);
        assert!(golden.difference(guide().data()) > TOLERANCE, "view and guide mixed up");
        let mut one = view().data().to_vec();
        one[5] += 0.01;
        assert!(golden.difference(&one) > TOLERANCE);
        one[5] = f32::NAN;
        assert!(golden.difference(&one) > TOLERANCE && golden.difference(&one[1..]) > TOLERANCE);
    }
}
