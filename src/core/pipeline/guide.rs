//! The guides of deblurring: each view with its render's detail where the two agree.
//!
//! Differs from the paper: it feeds the render as it is (`guide=raw`). A render has better detail
//! than a view: it averages many views, so it is sharper and less noisy than each. At scales
//! coarser than a shake the view is more accurate: a scene of few steps or views, and the curve
//! found for it, have larger errors there. Where the scene is wrong (a tree that only one view saw,
//! a floater in front of a held-out camera), the render has no useful detail either. So where the
//! two disagree at a scale that neither shake nor noise reaches, the guide is the view itself,
//! which the network interprets as "no guide". Measured in docs/decisions/guide.md.

use rayon::prelude::*;

use super::config::Guide;
use super::match_brightness::Next;
use crate::image::{Image, Srgb};

/// Side of the cells in which view and render are compared, px; above the shake, below the objects.
const CELL: usize = 4;

/// Difference of two cells, RMS over the channels, at which a render loses most of its weight.
/// Shake moves edges across cell borders: well-trained views differ by 0.01 to 0.03.
const DISAGREEMENT: f32 = 0.04;

/// Share of the render's detail in a guide; the rest comes from the view. Networks are trained with
/// all of it. At seven tenths, a guide brings nearly as much where the shake is strong (0.3 instead
/// of 0.4 dB), and does no harm where there is little to gain (0.0 to 0.1 dB above the network
/// alone instead of 0.3 below it; docs/decisions/guide.md).
const SHARE: f32 = 0.7;

/// The guides of a round, from the renders R of the round before it.
pub fn guides(how: Guide, next: &Next, renders: Vec<Image>) -> Vec<Image> {
    let of = |(index, render): (usize, Image)| {
        of_view(how, &next.enhanced[index], next.to_next.apply_to(index, &render))
    };
    renders.into_par_iter().enumerate().map(of).collect()
}

/// The guide of a view, given its render at the view's brightness.
fn of_view(how: Guide, view: &Image, render: Image) -> Image {
    match how {
        Guide::Raw => render,
        Guide::Render | Guide::None => guide(view, &render, SHARE),
    }
}

fn guide(view: &Image, render: &Image, share: f32) -> Image {
    let (width, height) = (view.width(), view.height());
    let cells = (width.div_ceil(CELL), height.div_ceil(CELL));
    let (coarse_view, coarse_render) =
        (view.resize_area(cells.0, cells.1), render.resize_area(cells.0, cells.1));
    let (mut trust, mut difference) =
        (Image::<Srgb>::new(cells.0, cells.1), Image::<Srgb>::new(cells.0, cells.1));
    for y in 0..cells.1 {
        for x in 0..cells.0 {
            let (a, b) = (coarse_view.get(x, y), coarse_render.get(x, y));
            let apart: [f32; 3] = std::array::from_fn(|c| a[c] - b[c]);
            let squared = apart.iter().map(|d| d * d).sum::<f32>() / 3.0;
            trust.set(x, y, [(-squared / (DISAGREEMENT * DISAGREEMENT)).exp(); 3]);
            difference.set(x, y, apart);
        }
    }
    let (trust, difference) =
        (trust.resize_bilinear(width, height), difference.resize_bilinear(width, height));
    let weights = trust.data().iter().zip(difference.data());
    let mixed = view.data().iter().zip(render.data()).zip(weights);
    Image::from_planar(
        width,
        height,
        mixed.map(|((v, r), (t, d))| (v + share * t * (r + d - v)).clamp(0.0, 1.0)).collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raw_guide_is_the_render_itself() {
        let view = Image::from_planar(8, 8, vec![0.5; 3 * 64]);
        let render = view.map(|v| v + 0.25);
        let of = |how| of_view(how, &view, render.clone());
        assert_eq!(of(Guide::Raw), render);
        assert_ne!(of(Guide::Render), render);
    }

    #[test]
    fn a_guide_has_render_detail_only_where_it_agrees() {
        let view = Image::from_planar(64, 32, vec![0.5; 3 * 64 * 32]);
        let mut render = view.map(|v| v + 0.01);
        for y in 0..32 {
            for x in 0..64 {
                if x < 24 {
                    render.set(x, y, [0.1, 0.2, 0.9]);
                } else if (16..24).contains(&y) && y % 2 == 0 {
                    render.set(x, y, [0.53; 3]);
                }
            }
        }
        let guide = guide(&view, &render, SHARE);
        let wrong = guide.get(4, 16)[2];
        assert!((wrong - 0.5).abs() < 0.01, "the wrong half must be the view: {wrong}");
        // A stripe is 0.01 above its cell, which is 0.02 above the view's: its weight is exp(-1/4).
        let detail = SHARE * 0.00779;
        for (y, expected) in [(6, 0.5), (18, 0.5 + detail), (19, 0.5 - detail), (20, 0.5 + detail)]
        {
            let found = guide.get(60, y)[0];
            assert!((found - expected).abs() < 1e-4, "{found} at {y}, not {expected}");
        }
    }

    /// Pixels of a guide of 37 x 26 px, by training/degrade.py.
    const GUIDES: [(usize, usize, [f32; 3]); 4] = [
        (0, 0, [0.12484, 0.22331, 0.20543]),
        (3, 1, [0.14831, 0.0437, 0.00353]),
        (18, 13, [0.0108, 0.00036, 0.088]),
        (36, 25, [0.18939, 0.142, 0.05553]),
    ];

    /// training/test_recipe.py checks the trainer's guide against the same numbers.
    #[test]
    fn guides_match_those_of_the_networks_training() {
        let waves = |height: f32, phase: f32| {
            let mut image: Image = Image::new(37, 26);
            for (x, y) in (0..37 * 26).map(|i| (i % 37, i / 37)) {
                let wave =
                    |c: f32| 0.1 + height * (0.7 * x as f32 + 0.3 * y as f32 + c + phase).sin();
                image.set(x, y, [wave(0.0), wave(1.0), wave(2.0)].map(|v| v.clamp(0.0, 1.0)));
            }
            image
        };
        let guide = guide(&waves(0.1, 0.0), &waves(0.12, 0.4), 1.0);
        for (x, y, expected) in GUIDES {
            let found = guide.get(x, y);
            let apart = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-4, "{found:?} at ({x}, {y}), not {expected:?}");
        }
        let fed = super::guide(&waves(0.1, 0.0), &waves(0.12, 0.4), SHARE).get(3, 1);
        let apart = fed
            .iter()
            .zip([0.15408, 0.05293, 0.00392])
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(apart < 1e-4, "{fed:?}");
        assert!(guide.data().iter().all(|value| (0.0..=1.0).contains(value)));
        assert!(guide.data().contains(&0.0), "cut at black");
        let tiny = Image::from_planar(2, 1, vec![0.5; 6]);
        assert_eq!(super::guide(&tiny, &tiny, SHARE), tiny);
    }

    #[test]
    fn a_faint_edge_moved_by_a_pixel_keeps_its_weight() {
        let edge = |at: usize| {
            let mut image: Image = Image::new(64, 32);
            for y in 0..32 {
                for x in 0..64 {
                    image.set(x, y, [if x < at { 0.45 } else { 0.5 }; 3]);
                }
            }
            image
        };
        let guide = guide(&edge(30), &edge(31), 1.0);
        let found = guide.get(30, 16)[0];
        assert!((found - 0.45).abs() < 0.02, "{found}: 0.45 is the render, 0.5 the view");
    }
}
