//! Lens distortion, in COLMAP's and OpenCV's parameters, and its removal.
//!
//! COLMAP's `image_undistorter` reads and writes 8-bit files and may change the size by a pixel.
//! Ours remaps `f32` images in memory, keeps the size, and handles ground truth and every working
//! size alike.

use glam::DVec2;
use serde::{Deserialize, Serialize};

use crate::camera::Intrinsics;
use crate::image::Image;

/// Number of radii at which a fraction is fitted to a polynomial.
const FRACTION_STEPS: u32 = 64;

/// Number of steps to the border when searching for a fold.
const FOLD_STEPS: u32 = 16;

/// How the lens bends the normalised image plane (x/z, y/z).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "snake_case")]
pub enum Distortion {
    /// A perfect pinhole.
    None,
    /// OpenCV's rational model; with zeros it covers COLMAP's SIMPLE_RADIAL, RADIAL, OPENCV and
    /// FULL_OPENCV.
    Perspective {
        /// k1..k6 in OpenCV's order: numerator k1, k2, k3, denominator k4, k5, k6.
        radial: [f64; 6],
        /// p1, p2.
        tangential: [f64; 2],
    },
    /// 1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8, with k1..k4 as in Metashape and nerfstudio; p1 and p2
    /// are OpenCV's.
    Polynomial {
        /// k1..k4.
        radial: [f64; 4],
        /// p1, p2.
        tangential: [f64; 2],
    },
    /// Equidistant fisheye; COLMAP's OPENCV_FISHEYE, RADIAL_FISHEYE and SIMPLE_RADIAL_FISHEYE.
    Fisheye {
        /// k1..k4.
        radial: [f64; 4],
    },
}

/// A lens with its sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Pixels of the photograph as taken.
    pub intrinsics: Intrinsics,
    /// Its distortion.
    pub distortion: Distortion,
}

impl Distortion {
    /// The distorted position of a point of the undistorted normalised plane.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        let r2 = p.length_squared();
        match *self {
            Self::None => p,
            Self::Perspective { radial: [k1, k2, k3, k4, k5, k6], tangential } => {
                let scale = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
                    / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
                p * scale + decentred(p, tangential)
            }
            Self::Polynomial { radial: [k1, k2, k3, k4], tangential } => {
                let scale = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
                p * scale + decentred(p, tangential)
            }
            Self::Fisheye { radial: [k1, k2, k3, k4] } => {
                let r = r2.sqrt();
                if r < 1e-12 {
                    return p;
                }
                let theta = r.atan();
                let t2 = theta * theta;
                let bent = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
                p * (bent / r)
            }
        }
    }

    /// Whether it moves a point back towards the centre along the way to this one.
    fn folds(&self, p: DVec2) -> bool {
        let bent = |step: u32| self.distort(p * (f64::from(step) / f64::from(FOLD_STEPS)));
        let along = (0..=FOLD_STEPS).map(|step| bent(step).dot(p));
        p != DVec2::ZERO && !along.is_sorted_by(|nearer, farther| nearer < farther)
    }

    /// Whether it changes nothing.
    pub fn is_none(&self) -> bool {
        match *self {
            Self::None => true,
            Self::Perspective { radial, tangential } => {
                radial.iter().chain(&tangential).all(|&k| k == 0.0)
            }
            Self::Polynomial { radial, tangential } => {
                radial.iter().chain(&tangential).all(|&k| k == 0.0)
            }
            Self::Fisheye { .. } => false,
        }
    }
}

/// The contribution of OpenCV's tangential terms.
fn decentred(p: DVec2, [p1, p2]: [f64; 2]) -> DVec2 {
    let (r2, cross) = (p.length_squared(), 2.0 * p.x * p.y);
    DVec2::new(p1 * cross + p2 * (r2 + 2.0 * p.x * p.x), p2 * cross + p1 * (r2 + 2.0 * p.y * p.y))
}

impl Lens {
    /// The photograph's pixel (0 is the left edge) of a point of the undistorted normalised plane.
    pub fn pixel(&self, p: DVec2) -> DVec2 {
        let d = self.distortion.distort(p);
        let k = &self.intrinsics;
        DVec2::new(k.fx * d.x + k.cx, k.fy * d.y + k.cy)
    }

    /// The point of the undistorted normalised plane that a photograph's pixel shows: the inverse
    /// of [`Self::pixel`], by fixed-point iteration.
    pub fn ray(&self, pixel: DVec2) -> DVec2 {
        let k = &self.intrinsics;
        let bent = DVec2::new((pixel.x - k.cx) / k.fx, (pixel.y - k.cy) / k.fy);
        let mut straight = bent;
        if !self.distortion.is_none() {
            for _ in 0..12 {
                straight += bent - self.distortion.distort(straight);
            }
        }
        straight
    }

    /// k1..k6 of OpenCV's rational model that approximates a polynomial of k1..k4, by least squares
    /// over the picture; `None` if the polynomial is absurd.
    pub(super) fn fraction(&self, [k1, k2, k3, k4]: [f64; 4]) -> Option<[f64; 6]> {
        let k = &self.intrinsics;
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
            .map(|(x, y)| self.ray(DVec2::new(x * k.width as f64, y * k.height as f64)));
        let widest = corners.map(DVec2::length_squared).into_iter().fold(0.0, f64::max);
        let (mut lower, mut right) = ([[0.0; 6]; 6], [0.0; 6]);
        for step in 1..=FRACTION_STEPS {
            // Powers relative to the widest square keep the equations well conditioned.
            let u = f64::from(step) / f64::from(FRACTION_STEPS);
            let r2 = u * widest;
            let bent = r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
            let powers = [u, u * u, u * u * u];
            let row: [f64; 6] = std::array::from_fn(|i| match i {
                0..3 => powers[i],
                _ => -(1.0 + bent) * powers[i - 3],
            });
            for i in 0..6 {
                (0..=i).for_each(|j| lower[i][j] += row[i] * row[j]);
                right[i] += row[i] * bent;
            }
        }
        // Many fractions are equally good if a term is zero: prefer a small one.
        (0..6).for_each(|i| lower[i][i] += 1e-12);
        let terms = crate::linear::solve(lower, right)?;
        Some(std::array::from_fn(|i| terms[i] / widest.powi(i as i32 % 3 + 1)))
    }

    /// The pinhole of the same size and principal point with the smallest focal length at which
    /// every pixel has a source in the photograph: no black borders for training to learn.
    pub fn pinhole(&self) -> Intrinsics {
        if self.distortion.is_none() {
            return self.intrinsics;
        }
        let covered = |zoom: f64| self.covers(&self.zoomed(zoom));
        let (mut low, mut high) = (0.5, 4.0);
        if covered(low) || !covered(high) {
            return self.intrinsics;
        }
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if covered(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        self.zoomed(high)
    }

    fn zoomed(&self, zoom: f64) -> Intrinsics {
        Intrinsics {
            fx: self.intrinsics.fx * zoom,
            fy: self.intrinsics.fy * zoom,
            ..self.intrinsics
        }
    }

    /// The share of the width that [`Self::pinhole`] shows; 0 if the distortion leaves no part of
    /// the photograph that a pinhole could show.
    pub fn straight_share(&self) -> f64 {
        let pinhole = self.pinhole();
        match self.distortion.is_none() || self.covers(&pinhole) {
            true => self.intrinsics.fx / pinhole.fx,
            false => 0.0,
        }
    }

    /// Whether the border of `pinhole`'s image is inside the photograph, before a distortion
    /// outside its valid range folds the picture back.
    fn covers(&self, pinhole: &Intrinsics) -> bool {
        let (w, h) = (pinhole.width as f64, pinhole.height as f64);
        let inside = |u: f64, v: f64| {
            let ray = DVec2::new((u - pinhole.cx) / pinhole.fx, (v - pinhole.cy) / pinhole.fy);
            let p = self.pixel(ray);
            let is_inside = p.x >= 0.0 && p.y >= 0.0 && p.x <= w && p.y <= h;
            is_inside && !self.distortion.folds(ray)
        };
        let steps = 32;
        (0..=steps).map(|i| f64::from(i) / f64::from(steps)).all(|t| {
            inside(t * w, 0.0) && inside(t * w, h) && inside(0.0, t * h) && inside(w, t * h)
        })
    }
}

/// `image` as seen by `pinhole`: bilinear, border repeated, same size. `lens` and `pinhole` are
/// given for one common size and scaled to the image's, so every working size is supported.
pub fn undistort<E>(image: &Image<E>, lens: &Lens, pinhole: &Intrinsics) -> Image<E> {
    let (width, height) = (image.width(), image.height());
    if lens.distortion.is_none() && lens.intrinsics == *pinhole {
        return Image::from_planar(width, height, image.data().to_vec());
    }
    let lens = Lens { intrinsics: lens.intrinsics.resized(width, height), ..*lens };
    let k = pinhole.resized(width, height);
    let mut out = Image::new(width, height);
    for y in 0..height {
        for x in 0..width {
            let p = DVec2::new((x as f64 + 0.5 - k.cx) / k.fx, (y as f64 + 0.5 - k.cy) / k.fy);
            let source = lens.pixel(p) - 0.5;
            out.set(x, y, sample(image, source.x, source.y));
        }
    }
    out
}

/// Bilinear value at a position, with pixel centres at whole numbers and the border repeated.
fn sample<E>(image: &Image<E>, x: f64, y: f64) -> [f32; 3] {
    let x = x.clamp(0.0, (image.width() - 1) as f64);
    let y = y.clamp(0.0, (image.height() - 1) as f64);
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(image.width() - 1), (y0 + 1).min(image.height() - 1));
    let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
    let (a, b) = (image.get(x0, y0), image.get(x1, y0));
    let (c, d) = (image.get(x0, y1), image.get(x1, y1));
    std::array::from_fn(|i| {
        let top = a[i] + (b[i] - a[i]) * fx;
        let bottom = c[i] + (d[i] - c[i]) * fx;
        top + (bottom - top) * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Srgb;

    /// training/test_recipe.py has the same numbers.
    #[test]
    fn rays_invert_pixels() {
        let mut ramps = Image::<Srgb>::new(160, 120);
        for (x, y) in (0..160 * 120).map(|i| (i % 160, i / 160)) {
            ramps.set(x, y, [0.2 + 0.004 * x as f32, 0.2 + 0.004 * y as f32, 0.0]);
        }
        let pinhole = Intrinsics { fx: 140.0, fy: 140.0, ..lens(0.0).intrinsics };
        let found = undistort(&ramps, &lens(-0.1), &pinhole).get(10, 20);
        for (found, expected) in found.into_iter().zip([0.22985, 0.27423, 0.0]) {
            assert!((found - expected).abs() < 1e-4, "{found}, not {expected}");
        }
    }

    fn lens(k1: f64) -> Lens {
        let intrinsics =
            Intrinsics { width: 160, height: 120, fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0 };
        Lens {
            intrinsics,
            distortion: Distortion::Perspective {
                radial: [k1, 0.0, 0.0, 0.0, 0.0, 0.0],
                tangential: [0.0; 2],
            },
        }
    }

    /// A smooth scene on the undistorted normalised plane.
    fn scene(p: DVec2) -> [f32; 3] {
        let v = |a: f64, b: f64| (0.5 + 0.4 * (a * p.x + b * p.y).sin()) as f32;
        [v(9.0, 2.0), v(-3.0, 8.0), v(6.0, 6.0)]
    }

    fn image_of(k: &Intrinsics, f: impl Fn(DVec2) -> [f32; 3]) -> Image<Srgb> {
        let mut image = Image::new(k.width, k.height);
        for y in 0..k.height {
            for x in 0..k.width {
                image.set(
                    x,
                    y,
                    f(DVec2::new((x as f64 + 0.5 - k.cx) / k.fx, (y as f64 + 0.5 - k.cy) / k.fy)),
                );
            }
        }
        image
    }

    /// Inverse of `distort` by fixed-point iteration: independent of the code under test's remap.
    fn straighten(distortion: &Distortion, d: DVec2) -> DVec2 {
        (0..100).fold(d, |p, _| p + (d - distortion.distort(p)))
    }

    fn worst(a: &Image<Srgb>, b: &Image<Srgb>) -> f32 {
        a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn an_undistorted_photograph_matches_the_pinholes() {
        for k1 in [-0.15, 0.12] {
            let lens = lens(k1);
            let taken = image_of(&lens.intrinsics, |d| scene(straighten(&lens.distortion, d)));
            let pinhole = lens.pinhole();
            let expected = image_of(&pinhole, scene);
            let got = undistort(&taken, &lens, &pinhole);
            assert!(worst(&got, &expected) < 4e-3, "k1 {k1}: {}", worst(&got, &expected));
            let wrong = Lens { distortion: self::lens(-k1).distortion, ..lens };
            assert!(
                worst(&undistort(&taken, &wrong, &pinhole), &expected) > 0.05,
                "a wrong sign goes unseen"
            );
        }
    }

    #[test]
    fn the_pinhole_covers_exactly_the_whole_frame() {
        for k1 in [-0.15, 0.12] {
            let lens = lens(k1);
            let pinhole = lens.pinhole();
            assert!(lens.covers(&pinhole));
            assert!(!lens.covers(&Intrinsics {
                fx: pinhole.fx * 0.99,
                fy: pinhole.fy * 0.99,
                ..pinhole
            }));
        }
    }

    #[test]
    fn the_pinhole_ends_before_a_distortion_folds_the_picture_back() {
        // r - 9 r^3 turns at the root of 1 / 27, and is equally small again farther out.
        let (absurd, turn) = (lens(-9.0), (1.0f64 / 27.0).sqrt());
        let k = absurd.pinhole();
        let corner = DVec2::new(k.cx / k.fx, k.cy / k.fy).length();
        // The search has discrete steps.
        let step = 1.0 / f64::from(FOLD_STEPS);
        assert!(corner < (1.0 + step) * turn, "{corner}");
        assert!((absurd.straight_share() - absurd.intrinsics.fx / k.fx).abs() < 1e-12);
        assert!((lens(0.0).straight_share() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_working_size_is_undistorted_like_the_original() {
        let lens = lens(0.12);
        let half = Lens { intrinsics: lens.intrinsics.resized(80, 60), ..lens };
        let taken = image_of(&half.intrinsics, |d| scene(straighten(&lens.distortion, d)));
        let expected = image_of(&lens.pinhole().resized(80, 60), scene);
        assert!(worst(&undistort(&taken, &lens, &lens.pinhole()), &expected) < 1.5e-2);
    }

    #[test]
    fn no_distortion_is_a_copy() {
        let lens = Lens { distortion: Distortion::None, ..lens(0.0) };
        let image = image_of(&lens.intrinsics, scene);
        assert_eq!(undistort(&image, &lens, &lens.pinhole()), image);
    }

    #[test]
    fn opencv_tangential_terms_bend_the_right_way() {
        // cv::projectPoints for (0.3, -0.2), k = (0.1, -0.05), p = (0.01, -0.02) by hand from
        // OpenCV's formula.
        let d = Distortion::Perspective {
            radial: [0.1, -0.05, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.01, -0.02],
        };
        let got = d.distort(DVec2::new(0.3, -0.2));
        let r2: f64 = 0.13;
        let s = 1.0 + 0.1 * r2 - 0.05 * r2 * r2;
        let expected = DVec2::new(
            0.3 * s + 2.0 * 0.01 * 0.3 * -0.2 - 0.02 * (r2 + 2.0 * 0.09),
            -0.2 * s + 0.01 * (r2 + 2.0 * 0.04) + 2.0 * -0.02 * 0.3 * -0.2,
        );
        assert!((got - expected).length() < 1e-15);
    }

    #[test]
    fn a_polynomial_of_four_terms_is_a_fraction_for_colmap() {
        let intrinsics = lens(0.0).intrinsics;
        for radial in [
            [0.0, 0.0, 0.0, -0.2],
            [-0.15, 0.03, 0.01, 0.05],
            [0.08, 0.0, 0.0, 0.3],
            [0.1, -0.05, 0.0, 0.0],
        ] {
            let polynomial = Lens {
                intrinsics,
                distortion: Distortion::Polynomial { radial, tangential: [0.01, -0.02] },
            };
            let fraction = crate::poses::model::ModelCamera::of_lens(1, &polynomial).lens();
            let pixels = (0..=8)
                .flat_map(|x| (0..=6).map(move |y| (20.0 * f64::from(x), 20.0 * f64::from(y))));
            let off = pixels.map(|(x, y)| {
                let ray = polynomial.ray(DVec2::new(x, y));
                polynomial.pixel(ray).distance(fraction.pixel(ray))
            });
            let worst = off.fold(0.0, f64::max);
            assert!(worst < 0.05, "{radial:?}: {worst} px");
        }
    }
}
