//! The row of each photograph in the metrics.

use super::records::Comparison;
use super::score::Likeness;
use crate::metrics::{Brightness, ImageKind, Reference, ViewScore};
use crate::pipeline::views::View;

/// Rows of all views, scored by their renders at the target brightness, then of the photographs
/// without a pose.
pub fn rows(
    views: &[View],
    unregistered: &[String],
    comparisons: &[Comparison],
    likenesses: &[Likeness],
) -> Vec<ViewScore> {
    let row = |(index, view): (usize, &View)| registered(view, index, comparisons, likenesses);
    let rows = views.iter().enumerate().map(row);
    rows.chain(unregistered.iter().map(|name| without_pose(name))).collect()
}

fn registered(
    view: &View,
    index: usize,
    comparisons: &[Comparison],
    likenesses: &[Likeness],
) -> ViewScore {
    let reference = match view.gt {
        Some(_) => Reference::Gt,
        None => Reference::Enhanced,
    };
    let scores_of = |image, reference| {
        let is_asked = |comparison: &&Comparison| {
            comparison.image == image
                && comparison.reference == reference
                && comparison.brightness == Brightness::Final
        };
        comparisons.iter().find(is_asked).and_then(|comparison| comparison.scores[index])
    };
    let scores = scores_of(ImageKind::Render, reference);
    let photograph = scores_of(ImageKind::Enhanced, Reference::Gt);
    ViewScore {
        name: view.name.clone(),
        registered: true,
        split: Some(view.split),
        reference: Some(reference),
        psnr_db: scores.map(|scores| scores.psnr_db),
        psnr_cc_db: scores.map(|scores| scores.psnr_cc_db),
        ssim: scores.map(|scores| scores.ssim),
        photograph_psnr_cc_db: photograph.map(|scores| scores.psnr_cc_db),
        shake_px: Some(likenesses[index].shake_px),
        is_shaken: Some(likenesses[index].is_shaken),
        fit: Some(likenesses[index].fit),
    }
}

fn without_pose(name: &str) -> ViewScore {
    ViewScore {
        name: name.to_owned(),
        registered: false,
        split: None,
        reference: None,
        psnr_db: None,
        psnr_cc_db: None,
        ssim: None,
        photograph_psnr_cc_db: None,
        shake_px: None,
        is_shaken: None,
        fit: None,
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::camera::{Camera, Intrinsics, Split};
    use crate::image::Image;
    use crate::metrics::Scores;
    use crate::photo_path::PhotoPath;

    const SIDE: usize = 8;

    fn view(name: &str, split: Split, gt: Option<Image>) -> View {
        let side = SIDE as f64;
        let intrinsics = Intrinsics {
            width: SIDE,
            height: SIDE,
            fx: side,
            fy: side,
            cx: side / 2.0,
            cy: side / 2.0,
        };
        View {
            name: name.to_owned(),
            path: PhotoPath::default(),
            camera: Camera::look_at(intrinsics, DVec3::NEG_Z, DVec3::ZERO, DVec3::Y),
            dark: Image::new(SIDE, SIDE),
            gt,
            mask: None,
            split,
            is_late: false,
        }
    }

    fn comparison(image: ImageKind, reference: Reference, psnr_db: [Option<f64>; 2]) -> Comparison {
        let scores = psnr_db.map(|psnr_db| {
            psnr_db.map(|psnr_db| Scores { psnr_db, psnr_cc_db: psnr_db + 1.0, ssim: 0.5 })
        });
        Comparison { image, reference, brightness: Brightness::Final, scores: scores.to_vec() }
    }

    #[test]
    fn views_score_against_truth_and_unposed_ones_are_listed() {
        let views = [
            view("a", Split::HeldOut, Some(Image::new(SIDE, SIDE))),
            view("b", Split::Train, None),
        ];
        let comparisons = [
            comparison(ImageKind::Render, Reference::Gt, [Some(20.0), None]),
            comparison(ImageKind::Enhanced, Reference::Gt, [Some(15.0), None]),
            comparison(ImageKind::Render, Reference::Enhanced, [Some(30.0), Some(31.0)]),
        ];
        let likenesses = [0.5, 2.0].map(|shake_px| Likeness {
            shake_px,
            is_shaken: shake_px > 1.0,
            psnr_cc_db: 20.0,
            fit: 0.8,
        });
        let rows = rows(&views, &["c".to_owned()], &comparisons, &likenesses);
        let seen: Vec<_> = rows
            .iter()
            .map(|row| (&row.name[..], row.registered, row.reference, row.psnr_db))
            .collect();
        let expected = [
            ("a", true, Some(Reference::Gt), Some(20.0)),
            ("b", true, Some(Reference::Enhanced), Some(31.0)),
            ("c", false, None, None),
        ];
        assert_eq!(seen, expected);
        let photographs: Vec<_> = rows.iter().map(|row| row.photograph_psnr_cc_db).collect();
        assert_eq!(photographs, [Some(16.0), None, None]);
        let shakes: Vec<_> = rows.iter().map(|row| row.shake_px).collect();
        assert_eq!(shakes, [Some(0.5), Some(2.0), None]);
        let fits: Vec<_> = rows.iter().map(|row| row.fit).collect();
        assert_eq!(fits, [Some(0.8), Some(0.8), None]);
    }
}
