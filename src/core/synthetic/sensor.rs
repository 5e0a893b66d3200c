//! The dark exposure: less light, the noise of photons and electronics, the cut at black and white.

use rand::Rng;

use crate::image::{Image, Linear};
use crate::random::normal;

/// The part of the noise at white that is there in the black too (read noise).
const READ_SHARE: f64 = 0.1;

/// `light` times `exposure`, with Poisson-Gaussian noise: variance `(noise * exposure)^2 *
/// (signal / white + 0.1^2)`, with white the dark exposure's. Photon counts at these levels are in
/// the hundreds and more, where the Poisson distribution is the Gaussian of the same variance.
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
