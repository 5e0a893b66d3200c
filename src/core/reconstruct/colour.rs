//! Exposure and cast of each view, told apart from the scene.
//!
//! Cameras at night change exposure and white balance between photographs. A scene that cannot say
//! so says it with floaters before single cameras. The views' images are therefore taken to the
//! colours of the scene, an affine map a channel, which the renders of the scene tell.

use crate::image::Image;

/// Values beyond these are cut off by camera or curve, and tell nothing about a factor.
const TRUSTED: std::ops::Range<f32> = 0.01..0.98;
/// Pull towards the identity, in pixels' worth of evidence a pixel: keeps views that show one flat
/// colour where they are.
const INERTIA: f64 = 1e-3;
/// Widest factors that are believed.
const GAINS: (f64, f64) = (0.5, 2.0);

/// How the values of a photograph come from those of the scene: `gain x + offset`, a channel each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ViewColour {
    pub(super) gain: [f32; 3],
    pub(super) offset: [f32; 3],
}

impl Default for ViewColour {
    /// As the scene is.
    fn default() -> Self {
        Self {
            gain: [1.0; 3],
            offset: [0.0; 3],
        }
    }
}

impl ViewColour {
    /// The colour with which `render` comes closest to `photograph`; both of one size.
    pub(super) fn between(render: &Image, photograph: &Image) -> Self {
        let fits = [0, 1, 2].map(|c| fit(render.plane(c), photograph.plane(c)));
        Self {
            gain: fits.map(|(gain, _)| gain as f32),
            offset: fits.map(|(_, offset)| offset as f32),
        }
    }

    /// The photograph in the colours of the scene.
    pub(super) fn undone(&self, photograph: &Image) -> Image {
        if *self == Self::default() {
            return photograph.clone();
        }
        let mut out = photograph.clone();
        for c in 0..3 {
            for value in out.plane_mut(c) {
                *value = ((*value - self.offset[c]) / self.gain[c]).clamp(0.0, 1.0);
            }
        }
        out
    }

    /// Gains and offsets, for a checkpoint.
    pub(super) fn to_row(self) -> [f32; 6] {
        let ([a, b, c], [x, y, z]) = (self.gain, self.offset);
        [a, b, c, x, y, z]
    }

    /// The inverse of [`ViewColour::to_row`].
    pub(super) fn from_row([a, b, c, x, y, z]: [f32; 6]) -> Self {
        Self {
            gain: [a, b, c],
            offset: [x, y, z],
        }
    }
}

/// Takes out what all views have in common, which is the scene's own: the product of the gains is
/// one, the sum of the offsets zero.
pub(super) fn hold_gauge(colours: &mut [ViewColour]) {
    let n = colours.len().max(1) as f32;
    for c in 0..3 {
        let gain = (colours
            .iter()
            .map(|colour| colour.gain[c].ln())
            .sum::<f32>()
            / n)
            .exp();
        let offset = colours.iter().map(|colour| colour.offset[c]).sum::<f32>() / n;
        for colour in colours.iter_mut() {
            colour.gain[c] /= gain;
            colour.offset[c] -= offset;
        }
    }
}

/// Gain and offset of `from` to `to` by least squares.
fn fit(from: &[f32], to: &[f32]) -> (f64, f64) {
    let trusted = || {
        from.iter()
            .zip(to)
            .filter(|(x, y)| TRUSTED.contains(*x) && TRUSTED.contains(*y))
    };
    let [mut n, mut x, mut y, mut xx, mut xy] = [0.0_f64; 5];
    for (&a, &b) in trusted() {
        let (a, b) = (f64::from(a), f64::from(b));
        n += 1.0;
        x += a;
        y += b;
        xx += a * a;
        xy += a * b;
    }
    // The two normal equations of sum (g x + o - y)^2 + inertia ((g - 1)^2 + o^2).
    let inertia = INERTIA * from.len().max(1) as f64;
    let (gg, go, oo) = (xx + inertia, x, n + inertia);
    let determinant = gg * oo - go * go;
    let gain = ((xy + inertia) * oo - y * go) / determinant;
    let gain = gain.clamp(GAINS.0, GAINS.1);
    (gain, (y - gain * x) / oo)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Image {
        let value = |i: usize| 0.1 + 0.5 * ((i * 7) % 96) as f32 / 96.0;
        Image::from_planar(12, 8, (0..3 * 12 * 8).map(value).collect())
    }

    #[test]
    fn exposure_and_cast_are_found_and_undone() {
        let (scene, taken) = (
            ramp(),
            ViewColour {
                gain: [1.2, 0.9, 1.0],
                offset: [0.02, -0.01, 0.0],
            },
        );
        let mut photograph = scene.clone();
        for c in 0..3 {
            photograph
                .plane_mut(c)
                .iter_mut()
                .for_each(|v| *v = taken.gain[c] * *v + taken.offset[c]);
        }
        let found = ViewColour::between(&scene, &photograph);
        for (value, expected) in found.to_row().into_iter().zip(taken.to_row()) {
            assert!((value - expected).abs() < 0.01, "{found:?}");
        }
        let undone = taken.undone(&photograph);
        assert!(
            undone
                .data()
                .iter()
                .zip(scene.data())
                .all(|(a, b)| (a - b).abs() < 1e-5)
        );
        assert!(
            photograph
                .data()
                .iter()
                .zip(scene.data())
                .any(|(a, b)| (a - b).abs() > 0.05)
        );
        assert_eq!(ViewColour::from_row(taken.to_row()), taken);
    }

    #[test]
    fn a_flat_or_burnt_view_keeps_its_colours() {
        let flat = Image::from_planar(4, 4, vec![0.5; 48]);
        let lighter = Image::from_planar(4, 4, vec![0.55; 48]);
        let found = ViewColour::between(&flat, &lighter);
        assert!(
            found.gain.iter().all(|gain| (gain - 1.0).abs() < 0.1),
            "{found:?}"
        );
        let burnt = Image::from_planar(4, 4, vec![1.0; 48]);
        assert_eq!(ViewColour::between(&flat, &burnt), ViewColour::default());
    }

    #[test]
    fn what_all_views_share_is_the_scene() {
        let colour = |gain: f32, offset: f32| ViewColour {
            gain: [gain; 3],
            offset: [offset; 3],
        };
        let mut colours = [colour(1.2, 0.03), colour(0.6, 0.01)];
        hold_gauge(&mut colours);
        assert!((colours[0].gain[1] * colours[1].gain[1] - 1.0).abs() < 1e-6);
        assert!((colours[0].gain[1] / colours[1].gain[1] - 2.0).abs() < 1e-5);
        assert!(
            (colours[0].offset[2] - 0.01).abs() < 1e-7
                && (colours[1].offset[2] + 0.01).abs() < 1e-7
        );
    }
}
