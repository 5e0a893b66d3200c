//! Estimates the shake of a photograph from it and a render of the same view: non-negative least
//! squares over the derivatives of the light, as in the kernel estimation of blind deconvolution
//! (Cho and Lee, "Fast Motion Deblurring", 2009), with the render in place of a guessed sharp
//! image.

use crate::image::Image;
use crate::mask::Mask;

use super::{ALONG, CELLS, Response, ShakeKernel, Tap};

/// Half of the kernel's side, as a share of the image's longer side: 11 px at 560. COLMAP does not
/// match photographs with more shake either.
const REACH_SHARE: f64 = 0.02;
/// Least reach, px.
const LEAST_REACH: usize = 2;
/// Longer side above which an image is halved first, px: at 1,120 px, a third of the time for a
/// kernel that is as near to the true one.
const LARGEST_SIDE: usize = 640;
/// Weight of the squared taps, in units of the mean squared derivative: keeps noise out of the
/// kernel.
const RIDGE: f64 = 0.01;
/// Weight of the squared centroid, in the same units and per px^2. Poses refer to the mean of the
/// shake; a kernel that moves its image would only hide the error of a pose, and all of them could
/// drift together.
const CENTRED: f64 = 0.3;
/// Price of a tap, in the same units and per px^2 of its distance, for images up to [`FAR_SIDE`];
/// larger images shake by more pixels. Errors of the render act as noise of the regressor and widen
/// every kernel; a render then trained through that kernel becomes sharper than the scene, with
/// halos, and less accurate. At four times the price, kernels are a third too narrow, and the blur
/// that they miss enters the scene.
const FAR: f64 = 0.002;
/// Longer side at which [`FAR`] was chosen, px.
const FAR_SIDE: f64 = 560.0;
/// Share of the largest tap below which taps only show such widening.
const SMALLEST_TAP: f32 = 0.1;
/// Iterations of the solver. They end before it converges, which regularises: at 420 px, half of
/// them leave taps all around the kernel, and with four times as many it falls apart into few heavy
/// taps. Larger images converge later; the thresholds of docs/decisions/shake.md are for this
/// number.
const ITERATIONS: usize = 200;

/// Approximate number of pixels in the estimate of one kernel for the whole image: its elongation
/// is less certain from fewer (docs/decisions/shake.md). Larger images contribute every n-th row.
const PIXELS: usize = 60_000;
/// The same for the kernels of all cells.
const CELLS_PIXELS: usize = 120_000;
/// Share of the whole image in the evidence for a cell, which may have few edges of its own.
const SHARED: f64 = 0.25;

/// Reach of a kernel from its centre, px, for images with this longer side.
fn reach(longer_side: usize) -> usize {
    ((REACH_SHARE * longer_side as f64).round() as usize).max(LEAST_REACH)
}

/// The kernel that turns `render` into `photograph`, both encoded by `response` and of one size,
/// with taps up to 2 % of the longer side from its centre; the same in all cells. Pixels that are
/// not `kept` do not count. Still if the images are too small or too flat for an estimate.
pub fn estimate(
    render: &Image,
    photograph: &Image,
    response: &Response,
    kept: Option<&Mask>,
) -> ShakeKernel {
    estimated([render, photograph], kept, response, &[Part::WHOLE], PIXELS)
}

/// [`estimate`], but with a kernel for each cell: when the camera rotates about its line of sight,
/// every corner of the image moves in its own direction.
pub fn estimate_by_cells(
    render: &Image,
    photograph: &Image,
    response: &Response,
    kept: Option<&Mask>,
) -> ShakeKernel {
    let is_wide = render.width() >= render.height();
    let cells: [Part; CELLS] = std::array::from_fn(|cell| Part::of_cell(cell, is_wide));
    estimated([render, photograph], kept, response, &cells, CELLS_PIXELS)
}

/// The kernel with one estimate for all cells, or with one for each.
fn estimated(
    [render, photograph]: [&Image; 2],
    kept: Option<&Mask>,
    response: &Response,
    parts: &[Part],
    pixels: usize,
) -> ShakeKernel {
    if render.width().max(render.height()) > LARGEST_SIDE {
        let [render, photograph] = [render, photograph].map(halved);
        let kept = kept.map(|kept| kept.resized(render.width(), render.height()));
        let kernel = estimated([&render, &photograph], kept.as_ref(), response, parts, pixels);
        return without_faint_taps(&kernel.doubled());
    }
    let [from, to] = [render, photograph].map(|image| Light::of(image, response));
    solved([&from, &to], kept, parts, pixels)
}

/// The means of four pixels each, without an odd last row or column. Of encoded values: the means
/// of their light would take a third of the time of an estimate.
fn halved(image: &Image) -> Image {
    let (wide, width, height) = (image.width(), image.width() / 2, image.height() / 2);
    let mut half = Image::new(width, height);
    for channel in 0..3 {
        let (from, to) = (image.plane(channel), half.plane_mut(channel));
        for (row, rows) in to.chunks_exact_mut(width.max(1)).zip(from.chunks_exact(2 * wide)) {
            let (above, below) = rows.split_at(wide);
            let pairs = above.chunks_exact(2).zip(below.chunks_exact(2));
            for (mean, (a, b)) in row.iter_mut().zip(pairs) {
                *mean = 0.25 * (a[0] + a[1] + b[0] + b[1]);
            }
        }
    }
    half
}

fn without_faint_taps(kernel: &ShakeKernel) -> ShakeKernel {
    let least = SMALLEST_TAP * kernel.taps().first().map_or(0.0, Tap::most);
    let taps = kernel.taps().iter().filter(|tap| tap.most() >= least);
    ShakeKernel::new(taps.copied().collect())
}

/// The kernel from the light of a render to that of its photograph, from about `pixels` pixels.
fn solved(
    [from, to]: [&Light; 2],
    kept: Option<&Mask>,
    parts: &[Part],
    pixels: usize,
) -> ShakeKernel {
    let reach = reach(from.longer_side());
    if from.width.min(from.height) <= 4 * reach + 2 {
        return ShakeKernel::still();
    }
    let price = FAR * (FAR_SIDE / from.longer_side() as f64).min(1.0).powi(2);
    let (from, to) = (from.derivatives(kept), to.derivatives(kept));
    let of_part = |part: &Part| Evidence {
        own: Correlation::new(&from, &from, 2 * reach, pixels, part),
        wanted: Correlation::new(&to, &from, reach, pixels, part),
    };
    let evidence: Vec<Evidence> = parts.iter().map(of_part).collect();
    let whole = Evidence::mean(&evidence);
    let scale = whole.own.at(0, 0);
    if !(scale.is_finite() && scale > 1e-12) {
        return ShakeKernel::still();
    }
    let weights: Vec<Vec<f32>> =
        evidence.iter().map(|own| own.with_share_of(&whole).weights(price)).collect();
    let tap = |at: usize| Tap {
        offset: offset(at, reach),
        weights: std::array::from_fn(|cell| weights[cell % weights.len()][at]),
    };
    ShakeKernel::new((0..weights[0].len()).map(tap).collect())
}

/// The offset of a tap, px, in a kernel of this reach.
fn offset(tap: usize, reach: usize) -> [i32; 2] {
    let (x, y) = (tap % (2 * reach + 1), tap / (2 * reach + 1));
    [x as i32 - reach as i32, y as i32 - reach as i32]
}

/// A part of an image, in shares of its sides.
struct Part {
    x: [f64; 2],
    y: [f64; 2],
}

impl Part {
    const WHOLE: Self = Self { x: [0.0, 1.0], y: [0.0, 1.0] };

    fn of_cell(cell: usize, is_wide: bool) -> Self {
        let part = |at: usize, cells: usize| [at, at + 1].map(|at| at as f64 / cells as f64);
        let (along, across) = (part(cell % ALONG, ALONG), part(cell / ALONG, CELLS / ALONG));
        let (x, y) = if is_wide { (along, across) } else { (across, along) };
        Self { x, y }
    }
}

/// The statistics that determine the kernel of a part: the derivatives of the render correlated
/// with themselves, and those of the photograph correlated with them.
struct Evidence {
    own: Correlation,
    wanted: Correlation,
}

impl Evidence {
    fn mean(all: &[Self]) -> Self {
        let mean = |of: fn(&Self) -> &Correlation| {
            let mut mean = of(&all[0]).clone();
            for (at, value) in mean.values.iter_mut().enumerate() {
                let sum: f64 = all.iter().map(|one| of(one).values[at]).sum();
                *value = sum / all.len() as f64;
            }
            mean
        };
        Self { own: mean(|one| &one.own), wanted: mean(|one| &one.wanted) }
    }

    fn with_share_of(&self, whole: &Self) -> Self {
        let mixed = |own: &Correlation, whole: &Correlation| Correlation {
            values: { own.values.iter().zip(&whole.values) }
                .map(|(own, whole)| own + SHARED * (whole - own))
                .collect(),
            ..*own
        };
        Self { own: mixed(&self.own, &whole.own), wanted: mixed(&self.wanted, &whole.wanted) }
    }

    /// The weights of the taps, without faint ones.
    fn weights(&self, price: f64) -> Vec<f32> {
        let (reach, scale) = (self.wanted.reach, self.own.at(0, 0));
        let count = (2 * reach + 1).pow(2);
        let mut matrix = vec![0.0_f32; count * count];
        for (row, values) in matrix.chunks_exact_mut(count).enumerate() {
            let u = offset(row, reach);
            for (column, value) in values.iter_mut().enumerate() {
                let v = offset(column, reach);
                let centred = CENTRED * f64::from(u[0] * v[0] + u[1] * v[1]);
                let ridge = if row == column { RIDGE } else { 0.0 };
                *value = (self.own.at(u[0] - v[0], u[1] - v[1]) / scale + centred + ridge) as f32;
            }
        }
        let right: Vec<f32> = (0..count)
            .map(|tap| {
                let [x, y] = offset(tap, reach);
                let far = price * f64::from(x * x + y * y);
                (self.wanted.at(x, y) / scale - far) as f32
            })
            .collect();
        let mut weights = non_negative_least_squares(&matrix, &right);
        let least = SMALLEST_TAP * weights.iter().copied().fold(0.0, f32::max);
        weights.iter_mut().filter(|weight| **weight < least).for_each(|weight| *weight = 0.0);
        weights
    }
}

/// The mean light of the three channels.
struct Light {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Light {
    fn of(image: &Image, response: &Response) -> Self {
        let (pixels, data) = (image.pixels(), image.data());
        let light = |i: usize| {
            let of = |c: usize| response.light(f64::from(data[c * pixels + i])) as f32;
            (0..3).map(of).sum::<f32>() / 3.0
        };
        let values = (0..pixels).map(light).collect();
        Self { width: image.width(), height: image.height(), values }
    }

    fn longer_side(&self) -> usize {
        self.width.max(self.height)
    }

    /// 0 if one of the two pixels is not `kept`: a flat place has no information.
    fn derivatives(&self, kept: Option<&Mask>) -> Derivatives {
        let (light, pixels) = (&self.values, self.values.len());
        let difference = |step: usize| -> Vec<f32> {
            let next = |i: usize| (i + step).min(pixels - 1);
            let mut all: Vec<f32> = (0..pixels).map(|i| light[next(i)] - light[i]).collect();
            if let Some(kept) = kept.map(Mask::pixels) {
                (0..pixels).filter(|&i| !kept[i] || !kept[next(i)]).for_each(|i| all[i] = 0.0);
            }
            all
        };
        let planes = [difference(1), difference(self.width)];
        Derivatives { width: self.width, height: self.height, planes }
    }
}

/// Horizontal and vertical differences of the mean light.
struct Derivatives {
    width: usize,
    height: usize,
    planes: [Vec<f32>; 2],
}

/// `mean over p of a(p) b(p - u)` for every |u| <= reach, over the pixels of a part where all terms
/// exist.
#[derive(Clone)]
struct Correlation {
    reach: usize,
    values: Vec<f64>,
}

impl Correlation {
    fn new(a: &Derivatives, b: &Derivatives, reach: usize, most: usize, part: &Part) -> Self {
        // The last row and column have no differences.
        let place = |share: f64, side: usize| {
            ((share * side as f64).round() as usize).clamp(reach, side - 1 - reach)
        };
        let [left, right] = part.x.map(|x| place(x, a.width));
        let [top, bottom] = part.y.map(|y| place(y, a.height));
        let square = 2 * reach + 1;
        let mut values = vec![0.0; square * square];
        let stride = (a.width * a.height).div_ceil(most);
        let pixels = 2 * (right - left) * (bottom - top).div_ceil(stride);
        // A correlation with itself is symmetric: half of it suffices.
        let alike = std::ptr::eq(a, b);
        let needed = if alike { square * square / 2 + 1 } else { square * square };
        // All offsets of a row come before the next row: few rows at a time stay in the cache.
        for (one, other) in a.planes.iter().zip(&b.planes) {
            for y in (top..bottom).step_by(stride) {
                let row = &one[y * a.width + left..y * a.width + right];
                for (at, value) in values.iter_mut().enumerate().take(needed) {
                    // u = at - reach, so p - u = p + reach - at.
                    let (ux, uy) = (at % square, at / square);
                    let from = (y + reach - uy) * a.width + left + reach - ux;
                    *value += f64::from(dot(row, &other[from..from + row.len()]));
                }
            }
        }
        values.iter_mut().take(needed).for_each(|value| *value /= pixels as f64);
        for at in needed..square * square {
            values[at] = values[square * square - 1 - at];
        }
        Self { reach, values }
    }

    fn at(&self, x: i32, y: i32) -> f64 {
        let reach = self.reach as i32;
        self.values[((y + reach) * (2 * reach + 1) + x + reach) as usize]
    }
}

/// Eight parallel sums: the compiler may not reorder a sum of floats itself.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a8, a_rest) = a.as_chunks::<8>();
    let (b8, b_rest) = b.as_chunks::<8>();
    let mut sums = [0.0_f32; 8];
    for (a, b) in a8.iter().zip(b8) {
        add_products(&mut sums, a, b);
    }
    sums.iter().sum::<f32>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f32>()
}

fn add_products(sums: &mut [f32; 8], a: &[f32; 8], b: &[f32; 8]) {
    for lane in 0..8 {
        sums[lane] += a[lane] * b[lane];
    }
}

/// `argmin over x >= 0 of x'Ax / 2 - b'x` by accelerated projected gradients (Beck and Teboulle
/// 2009).
fn non_negative_least_squares(matrix: &[f32], right: &[f32]) -> Vec<f32> {
    let count = right.len();
    // Most of a kernel soon becomes zero; blocks of eight zeros are skipped, as they add nothing.
    let product = |x: &[f32]| -> Vec<f32> {
        let (eights, rest) = x.as_chunks::<8>();
        let places: Vec<usize> =
            (0..eights.len()).filter(|&at| eights[at].iter().any(|&v| v != 0.0)).collect();
        let of_row = |row: &[f32]| {
            let (row_eights, row_rest) = row.as_chunks::<8>();
            let mut sums = [0.0_f32; 8];
            for &at in &places {
                add_products(&mut sums, &row_eights[at], &eights[at]);
            }
            sums.iter().sum::<f32>() + row_rest.iter().zip(rest).map(|(a, b)| a * b).sum::<f32>()
        };
        matrix.chunks_exact(count).map(of_row).collect()
    };
    let step = 1.0 / largest_eigenvalue(&product, count);
    let mut x = vec![0.0_f32; count];
    let mut ahead = x.clone();
    let mut momentum = 1.0_f32;
    for _ in 0..ITERATIONS {
        let gradient = product(&ahead);
        let next: Vec<f32> =
            (0..count).map(|i| (ahead[i] - step * (gradient[i] - right[i])).max(0.0)).collect();
        let following = (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt()) / 2.0;
        let push = (momentum - 1.0) / following;
        ahead = next.iter().zip(&x).map(|(new, old)| new + push * (new - old)).collect();
        (x, momentum) = (next, following);
    }
    x
}

fn largest_eigenvalue(product: &impl Fn(&[f32]) -> Vec<f32>, count: usize) -> f32 {
    let mut x: Vec<f32> = (0..count).map(|i| 1.0 + 0.1 * (i as f32).sin()).collect();
    let mut length = 1.0;
    for _ in 0..20 {
        x = product(&x);
        length = x.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-20);
        x.iter_mut().for_each(|v| *v /= length);
    }
    // Power iteration converges from below.
    1.05 * length
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn the_solution_is_optimal_and_nowhere_negative() {
        // Not a multiple of eight.
        const COUNT: usize = 43;
        let mut random = Pcg64Mcg::seed_from_u64(5);
        let mut draw =
            |count: usize| (0..count).map(|_| random.random::<f32>() - 0.5).collect::<Vec<_>>();
        let (factor, right) = (draw(COUNT * COUNT), draw(COUNT));
        let row = |i: usize| &factor[i * COUNT..(i + 1) * COUNT];
        let entry = |at: usize| {
            let (i, j) = (at / COUNT, at % COUNT);
            dot(row(i), row(j)) + if i == j { 1.0 } else { 0.0 }
        };
        let matrix: Vec<f32> = (0..COUNT * COUNT).map(entry).collect();
        let x = non_negative_least_squares(&matrix, &right);
        for (i, row) in matrix.chunks_exact(COUNT).enumerate() {
            let slope = row.iter().zip(&x).map(|(a, x)| a * x).sum::<f32>() - right[i];
            assert!(x[i] >= 0.0 && slope > -1e-4, "{i}: {}, slope {slope}", x[i]);
            assert!(x[i] == 0.0 || slope < 1e-4, "{i}: {}, slope {slope}", x[i]);
        }
        let zeros = x.iter().filter(|v| **v == 0.0).count();
        assert!((8..35).contains(&zeros), "{zeros} zeros");
    }
}
