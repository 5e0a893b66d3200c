//! The response from light to the values of a round's images: sRGB, then the round's tone curve.

use crate::image::srgb_to_linear;

/// Number of knots of the table.
pub(super) const KNOTS: usize = 256;
/// Number of samples of the curve from which the table is made.
const SAMPLES: usize = 4_096;
/// Least slope assumed for the curve, as a share of its mean slope below one half. Equalisation is
/// nearly flat where there are few pixels; small differences of such values would become huge
/// differences of light.
const LEAST_SLOPE: f32 = 0.25;

/// The camera's response together with the tone curve of a round: the light, in any unit, of each
/// encoded value. Strictly increasing; the same for all channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    light: Vec<f32>,
}

impl Response {
    /// sRGB alone.
    pub fn srgb() -> Self {
        Self::through(|v| v)
    }

    /// sRGB, then `curve`, a rising map of 0..=1 onto itself.
    pub fn through(curve: impl Fn(f32) -> f32) -> Self {
        let at = |n: usize| n as f32 / (SAMPLES - 1) as f32;
        let values: Vec<f32> = (0..SAMPLES).map(|n| curve(at(n))).collect();
        let half =
            (1..SAMPLES).find(|&n| values[n] >= 0.5 * values[SAMPLES - 1]).unwrap_or(SAMPLES - 1);
        let least = LEAST_SLOPE * (values[half] - values[0]) / half as f32;
        let mut risen = vec![values[0]; SAMPLES];
        for n in 1..SAMPLES {
            risen[n] = risen[n - 1] + (values[n] - values[n - 1]).max(least).max(1e-7);
        }
        let mut below = 0;
        let light = (0..KNOTS).map(|knot| {
            let value = knot as f32 / (KNOTS - 1) as f32;
            while below + 2 < SAMPLES && risen[below + 1] < value {
                below += 1;
            }
            let part = (value - risen[below]) / (risen[below + 1] - risen[below]);
            srgb_to_linear((at(below) + part * (at(1) - at(0))).max(0.0))
        });
        let mut light: Vec<f32> = light.collect();
        let scale = 1.0 / light[KNOTS - 1].max(1e-12);
        light.iter_mut().for_each(|l| *l *= scale);
        // Knots below the curve's first value share one light; the table must not be flat.
        for knot in 1..KNOTS {
            light[knot] = light[knot].max(light[knot - 1] + 1e-6);
        }
        Self { light }
    }

    /// The table: light of the values 0, 1/255 .. 1.
    pub(super) fn knots(&self) -> &[f32] {
        &self.light
    }

    /// Light of an encoded value; negative values count as 0.
    pub fn light(&self, value: f64) -> f64 {
        let place = value.max(0.0) * (KNOTS - 1) as f64;
        let knot = (place as usize).min(KNOTS - 2);
        let (low, high) = (f64::from(self.light[knot]), f64::from(self.light[knot + 1]));
        low + (place - knot as f64) * (high - low)
    }

    /// The encoded value of light: the inverse of [`Response::light`].
    pub fn value(&self, light: f64) -> f64 {
        let knot =
            self.light.partition_point(|&l| f64::from(l) <= light).saturating_sub(1).min(KNOTS - 2);
        let (low, high) = (f64::from(self.light[knot]), f64::from(self.light[knot + 1]));
        (knot as f64 + (light - low) / (high - low)) / (KNOTS - 1) as f64
    }

    /// Derivative of [`Response::light`]; at a knot, the one to the right.
    pub fn light_slope(&self, value: f64) -> f64 {
        let knot = ((value.max(0.0) * (KNOTS - 1) as f64) as usize).min(KNOTS - 2);
        (KNOTS - 1) as f64 * (f64::from(self.light[knot + 1]) - f64::from(self.light[knot]))
    }

    /// Derivative of [`Response::value`].
    pub fn value_slope(&self, light: f64) -> f64 {
        let knot =
            self.light.partition_point(|&l| f64::from(l) <= light).saturating_sub(1).min(KNOTS - 2);
        1.0 / ((KNOTS - 1) as f64 * (f64::from(self.light[knot + 1]) - f64::from(self.light[knot])))
    }
}
