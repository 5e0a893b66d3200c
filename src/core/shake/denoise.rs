//! Removes noise from a shaken photograph and keeps its shake.
//!
//! A deblurred image that is blurred back, by the kernel from it to its photograph, has the shake
//! of the photograph and hardly any noise. Where the two differ by as much as noise, it is noise;
//! where they differ by more, deblurring was wrong, and a local Wiener filter keeps the photograph
//! (Lee, "Digital Image Enhancement and Noise Filtering by Use of Local Statistics", 1980).

use super::reference::shaken_image;
use super::{Response, estimate};
use crate::image::Image;

/// Levels of brightness, each with its own noise: brightening makes dark parts the noisiest.
const LEVELS: usize = 16;
/// Fewest differences that determine the noise of a level; with fewer, that of the whole image is
/// used.
const LEAST: usize = 2_000;
/// Standard deviation of noise that is left unchanged. A scene averages it over its views, and
/// removing it would remove faint detail: of more noise, the share that stays falls with the
/// variance.
const HARMLESS: f32 = 0.035;
/// Least noise: images that do not differ divide by it.
const LEAST_NOISE: f32 = 1e-4;
/// Half of a window's side, px. A window has 147 values of three channels, in which the variance of
/// pure noise scatters by 12 %.
const REACH: usize = 3;
/// The median of the absolute values of Gaussian noise, relative to its standard deviation.
const MEDIAN: f32 = 0.6745;

/// The `photograph` with less noise and all of its shake. `deblurred` is the same photograph
/// without shake; both have one size and are encoded by `response`.
pub fn denoised(photograph: &Image, deblurred: &Image, response: &Response) -> Image {
    let kernel = estimate(deblurred, photograph, response, None);
    let mut clean = shaken_image(deblurred, &kernel, response);
    let values = photograph.data().iter().zip(clean.data());
    let rest: Vec<f32> = values.map(|(photograph, clean)| photograph - clean).collect();
    let noise = noise_by_level(&rest, &clean);
    let (width, pixels) = (clean.width(), clean.pixels());
    let mut variances = vec![0.0; pixels];
    for (at, (rest, value)) in rest.iter().zip(clean.data()).enumerate() {
        variances[at % pixels] += (rest / noise[level(*value)]).powi(2) / 3.0;
    }
    let variances = windowed(&variances, width);
    for (at, (value, rest)) in clean.data_mut().iter_mut().zip(&rest).enumerate() {
        let is_wrong = 1.0 - 1.0 / variances[at % pixels].max(1.0);
        let kept = (HARMLESS / noise[level(*value)]).powi(2).min(1.0);
        *value += is_wrong.max(kept) * rest;
    }
    clean
}

fn level(value: f32) -> usize {
    ((value.max(0.0) * LEVELS as f32) as usize).min(LEVELS - 1)
}

/// Standard deviation of the noise in `rest`, planar, by the level of `clean`, the image without
/// it. A diagonal difference of neighbours has the variance of white noise and little of edges; the
/// median ignores the edges.
fn noise_by_level(rest: &[f32], clean: &Image) -> [f32; LEVELS] {
    let (width, height) = (clean.width(), clean.height());
    let mut levels: [Vec<f32>; LEVELS] = Default::default();
    for (channel, rest) in rest.chunks_exact(width * height).enumerate() {
        let clean = clean.plane(channel);
        for row in 0..height - 1 {
            for at in row * width..(row + 1) * width - 1 {
                let below = at + width;
                let difference = 0.5 * (rest[at] - rest[at + 1] - rest[below] + rest[below + 1]);
                levels[level(clean[at])].push(difference.abs());
            }
        }
    }
    let deviation = |mut values: Vec<f32>| {
        let middle = values.len() / 2;
        let (_, median, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
        (*median / MEDIAN).max(LEAST_NOISE)
    };
    let whole = deviation(levels.concat());
    levels.map(|values| if values.len() < LEAST { whole } else { deviation(values) })
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
