//! Removes noise from a shaken photograph and keeps its shake.
//!
//! A deblurred image that is blurred back, by the kernel from it to its photograph, has the shake
//! of the photograph and hardly any noise. Where the two differ by as much as noise, it is noise;
//! where they differ by more, deblurring was wrong, and a local Wiener filter keeps the photograph
//! (Lee, "Digital Image Enhancement and Noise Filtering by Use of Local Statistics", 1980).

use super::{Response, estimate, shaken_image};
use crate::image::Image;
use crate::noise_levels::NoiseLevels;

/// Standard deviation of noise that is left unchanged. A scene averages it over its views, and
/// removing it would remove faint detail: of more noise, the share that stays falls with the
/// variance.
const HARMLESS: f32 = 0.035;
/// Half of a window's side, px. A window has 147 values of three channels, in which the variance of
/// pure noise scatters by 12 %.
const REACH: usize = 3;

/// The `photograph` with less noise and all of its shake, and the noise that is left. `deblurred`
/// is the same photograph without shake; both have one size and are encoded by `response`.
pub fn denoised(
    photograph: &Image,
    deblurred: &Image,
    response: &Response,
) -> (Image, NoiseLevels) {
    let kernel = estimate(deblurred, photograph, response, None);
    let mut clean = shaken_image(deblurred, &kernel, response);
    let values = photograph.data().iter().zip(clean.data());
    let rest: Vec<f32> = values.map(|(photograph, clean)| photograph - clean).collect();
    let noise = NoiseLevels::of_residual(&rest, &clean);
    let (width, pixels) = (clean.width(), clean.pixels());
    let mut variances = vec![0.0; pixels];
    for (at, (rest, value)) in rest.iter().zip(clean.data()).enumerate() {
        variances[at % pixels] += (rest / noise.at(*value)).powi(2) / 3.0;
    }
    let variances = windowed(&variances, width);
    for (at, (value, rest)) in clean.data_mut().iter_mut().zip(&rest).enumerate() {
        let is_wrong = 1.0 - 1.0 / variances[at % pixels].max(1.0);
        *value += is_wrong.max(kept(noise.at(*value))) * rest;
    }
    (clean, NoiseLevels(noise.0.map(|deviation| kept(deviation) * deviation)))
}

/// The share that stays of noise of this deviation.
fn kept(deviation: f32) -> f32 {
    (HARMLESS / deviation).powi(2).min(1.0)
}

/// The mean of each value's window, in an image of this width.
fn windowed(values: &[f32], width: usize) -> Vec<f32> {
    let height = values.len() / width;
    let mean = |at: usize, end: usize, value: &dyn Fn(usize) -> f32| {
        let window = at.saturating_sub(REACH)..(at + REACH + 1).min(end);
        let count = window.len() as f32;
        window.map(value).sum::<f32>() / count
    };
    let places = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let rows: Vec<f32> =
        places().map(|(x, y)| mean(x, width, &|x| values[y * width + x])).collect();
    places().map(|(x, y)| mean(y, height, &|y| rows[y * width + x])).collect()
}
