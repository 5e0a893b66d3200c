//! Converts pictures with a brightness range larger than sRGB to sRGB.

use std::fmt;

use super::transfer::linear_to_srgb;

/// Brightness of white in such a picture, nits (ITU-R BT.2408): sRGB white, before compression.
pub(crate) const WHITE: f64 = 203.0;

/// Peak brightness of such a picture, nits: the display that HLG is designed for.
pub(crate) const PEAK: f64 = 1000.0;

/// Below this share of [`WHITE`] light is unchanged; above it is compressed, so that [`PEAK`]
/// becomes sRGB white. The dark range matters here.
const BEND: f32 = 0.3;

/// How a picture codes a larger range (ITU-R BT.2100).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HdrTransfer {
    /// Hybrid log-gamma: scene light.
    Hlg,
    /// Perceptual quantizer: display light.
    Pq,
}

impl fmt::Display for HdrTransfer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Hlg => "HLG",
            Self::Pq => "PQ",
        })
    }
}

impl HdrTransfer {
    /// The transfer function for a code point of ITU-T H.273; `None` for those of normal range.
    pub(in crate::image) fn of_code(transfer: u16) -> Option<Self> {
        match transfer {
            16 => Some(Self::Pq),
            18 => Some(Self::Hlg),
            _ => None,
        }
    }

    /// The light for a coded value in 0..=1: for PQ in units of [`WHITE`], for HLG scene light in
    /// 0..=1.
    pub(super) fn light(self, value: f32) -> f32 {
        let value = f64::from(value);
        let light = match self {
            Self::Pq => {
                const M: [f64; 2] = [2610.0 / 16_384.0, 2523.0 / 32.0];
                const C: [f64; 3] = [3424.0 / 4096.0, 2413.0 / 128.0, 2392.0 / 128.0];
                let root = value.powf(1.0 / M[1]);
                let share = ((root - C[0]).max(0.0) / (C[1] - C[2] * root)).powf(1.0 / M[0]);
                share * 10_000.0 / WHITE
            }
            Self::Hlg => {
                const A: f64 = 0.178_832_77;
                const B: f64 = 1.0 - 4.0 * A;
                const C: f64 = 0.559_910_73;
                if value <= 0.5 {
                    value * value / 3.0
                } else {
                    (((value - C) / A).exp() + B) / 12.0
                }
            }
        };
        light as f32
    }

    /// The sRGB values, in 0..=1, for a pixel's [`HdrTransfer::light`] in the primaries of
    /// `to_srgb`'s columns.
    pub(super) fn srgb(self, light: [f32; 3], to_srgb: &[[f32; 3]; 3]) -> [f32; 3] {
        let gain = match self {
            Self::Pq => 1.0,
            // The 1,000 nit display adds contrast, by BT.2020 luminance.
            Self::Hlg => {
                let luminance = 0.2627 * light[0] + 0.6780 * light[1] + 0.0593 * light[2];
                luminance.powf(0.2) * (PEAK / WHITE) as f32
            }
        };
        let light = to_srgb.map(|row| gain * (0..3).map(|c| row[c] * light[c]).sum::<f32>());
        let brightest = light.into_iter().fold(1e-6, f32::max);
        let scale = bent(brightest) / brightest;
        light.map(|value| linear_to_srgb((scale * value).clamp(0.0, 1.0)))
    }
}

/// The curve of ffmpeg's `tonemap=mobius`: linear up to [`BEND`], then a hyperbola with the same
/// slope there that maps [`PEAK`] to 1.
fn bent(light: f32) -> f32 {
    if light <= BEND {
        return light;
    }
    let peak = (PEAK / WHITE) as f32;
    let square = BEND * BEND;
    let a = -square * (peak - 1.0) / (square - 2.0 * BEND + peak);
    let b = (square - 2.0 * BEND * peak + peak) / (peak - 1.0);
    (b + BEND) * (b + BEND) / (b - a) * (light + a) / (light + b)
}

/// The matrix from linear light in the primaries of a code point of ITU-T H.273 to sRGB's.
/// Unspecified primaries are BT.2020's, as every player assumes.
pub(super) fn primaries_to_srgb(code: u16) -> &'static [[f32; 3]; 3] {
    match code {
        2 | 9 => &[
            [1.660_491, -0.587_641, -0.072_850],
            [-0.124_550, 1.132_9, -0.008_349],
            [-0.018_151, -0.100_579, 1.118_73],
        ],
        // Display P3.
        12 => &[
            [1.224_94, -0.224_940, 0.0],
            [-0.042_057, 1.042_057, 0.0],
            [-0.019_638, -0.078_636, 1.098_274],
        ],
        _ => &[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_of_bt_2408_have_their_light() {
        // Signal, and nits of a grey on a display of 1,000 nits.
        for (transfer, value, nits) in [
            (HdrTransfer::Pq, 0.581, 203.0),
            (HdrTransfer::Pq, 0.751_83, 1000.0),
            (HdrTransfer::Pq, 0.380, 26.0),
            (HdrTransfer::Hlg, 0.75, 203.0),
            (HdrTransfer::Hlg, 0.38, 26.0),
            (HdrTransfer::Hlg, 1.0, 1000.0),
        ] {
            let light = transfer.light(value);
            let srgb = transfer.srgb([light; 3], primaries_to_srgb(9));
            let expected = linear_to_srgb(bent((nits / WHITE) as f32));
            for value in srgb {
                assert!((value - expected).abs() < 0.003, "{transfer} {nits}: {value} {expected}");
            }
        }
    }

    #[test]
    fn light_is_linear_in_the_dark_and_compressed_to_white_at_the_peak() {
        assert_eq!(bent(0.2), 0.2);
        assert!((bent(1.0) - 0.679).abs() < 0.001);
        assert!((bent((PEAK / WHITE) as f32) - 1.0).abs() < 1e-5);
        assert!((bent(0.301) - 0.301).abs() < 1e-4, "without a step");
    }

    #[test]
    fn white_stays_white_in_other_primaries() {
        for code in [1, 2, 9, 12] {
            for row in primaries_to_srgb(code) {
                assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{code}: {row:?}");
            }
        }
    }
}
