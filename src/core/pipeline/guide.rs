//! Which parts of a render may guide the deblurring of its view.
//!
//! Differs from the paper: it feeds the render as it is. A network that trusts its guide then paints
//! what the scene has wrong (a tree that only one view saw, a floater in front of a held-out camera)
//! over what the photograph shows. Where the two disagree at a scale that neither shake nor noise
//! reaches, the guide is the view itself, which the network knows as "no guide".

use rayon::prelude::*;

use crate::image::Image;

/// Side of the cells in which view and render are compared, px: above the shake, below the objects.
const CELL: usize = 4;

/// Difference of two cells, RMS over the channels, at which a render has lost most of its say. Shake
/// moves edges over cell borders: well-trained views differ by 0.01 to 0.03.
const DISAGREEMENT: f32 = 0.04;

/// The guides of all views: each render where it agrees with its view, the view elsewhere.
pub fn trusted(views: &[Image], renders: &[Image]) -> Vec<Image> {
    views.par_iter().zip(renders).map(|(view, render)| guide(view, render)).collect()
}

fn guide(view: &Image, render: &Image) -> Image {
    let (width, height) = (view.width(), view.height());
    let cells = (width.div_ceil(CELL), height.div_ceil(CELL));
    let (coarse_view, coarse_render) =
        (view.resize_area(cells.0, cells.1), render.resize_area(cells.0, cells.1));
    let mut trust: Image = Image::new(cells.0, cells.1);
    for y in 0..cells.1 {
        for x in 0..cells.0 {
            let (a, b) = (coarse_view.get(x, y), coarse_render.get(x, y));
            let squared = (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f32>() / 3.0;
            trust.set(x, y, [(-squared / (DISAGREEMENT * DISAGREEMENT)).exp(); 3]);
        }
    }
    let trust = trust.resize_bilinear(width, height);
    let mixed = view.data().iter().zip(render.data()).zip(trust.data());
    Image::from_planar(width, height, mixed.map(|((v, r), t)| v + t * (r - v)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_render_guides_where_it_agrees_and_only_there() {
        let view = Image::from_planar(64, 32, vec![0.5; 3 * 64 * 32]);
        let mut render = view.map(|v| v + 0.01);
        for y in 0..32 {
            for x in 0..24 {
                render.set(x, y, [0.1, 0.2, 0.9]);
            }
        }
        let guide = trusted(std::slice::from_ref(&view), std::slice::from_ref(&render)).remove(0);
        assert!(
            (guide.get(4, 16)[2] - 0.5).abs() < 0.01,
            "the wrong half must be the view: {:?}",
            guide.get(4, 16)
        );
        assert!(
            (guide.get(60, 16)[0] - 0.51).abs() < 1e-3,
            "the right half must be the render: {:?}",
            guide.get(60, 16)
        );
    }

    #[test]
    fn a_faint_edge_that_shake_moved_by_a_pixel_stays_trusted() {
        let edge = |at: usize| {
            let mut image: Image = Image::new(64, 32);
            for y in 0..32 {
                for x in 0..64 {
                    image.set(x, y, [if x < at { 0.45 } else { 0.5 }; 3]);
                }
            }
            image
        };
        let guide = trusted(&[edge(30)], &[edge(31)]).remove(0);
        assert!((guide.get(30, 16)[0] - 0.45).abs() < 0.01, "{:?}", guide.get(30, 16));
    }
}
