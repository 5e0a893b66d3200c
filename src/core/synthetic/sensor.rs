//! The dark exposure: less light, photon and read noise, clipping at black and white.

use rand::Rng;

use crate::image::{Image, Linear};
use crate::random::normal;

/// Share of the noise at white that remains in the black (read noise).
const READ_SHARE: f64 = 0.1;

/// `light` times `exposure`, with Poisson-Gaussian noise of variance
/// `(noise * exposure)^2 * (signal / white + 0.1^2)`, white being the dark exposure's. Photon
/// counts at these levels are in the hundreds and more, where the Poisson distribution approaches
/// the Gaussian of the same variance.
pub(super) fn expose(
    light: &Image<Linear>,
    exposure: f64,
    noise: f64,
    rng: &mut impl Rng,
) -> Image<Linear> {
    let mut dark = light.map(|_| 0.0);
    for (out, &value) in dark.data_mut().iter_mut().zip(light.data()) {
        let signal = f64::from(value.max(0.0));
        let deviation = noise * (signal + READ_SHARE * READ_SHARE).sqrt();
        *out = (exposure * (signal + deviation * normal(rng))).clamp(0.0, 1.0) as f32;
    }
    dark
}
