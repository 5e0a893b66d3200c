//! The scores of a round: method.md section 7.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::views::View;
use crate::camera::Split;
use crate::image::Image;
use crate::metrics::{self, Brightness, ImageKind, Record, Reference};

/// The images of one round, a view each, in the order of the views.
#[derive(Clone, Copy, Debug)]
pub struct RoundImages<'a> {
    /// H_i.
    pub enhanced: &'a [Image],
    /// D_i.
    pub deblurred: &'a [Image],
    /// R_i.
    pub renders: &'a [Image],
    /// H_N: the views at the target brightness.
    pub final_enhanced: &'a [Image],
    /// D_i mapped to the target brightness.
    pub final_deblurred: &'a [Image],
    /// R_i mapped to the target brightness.
    pub final_renders: &'a [Image],
}

/// Every record of the round: both splits, with ground truth where the capture has it.
pub fn records(views: &[View], images: &RoundImages<'_>) -> Vec<Record> {
    let mut records = Vec::new();
    for split in [Split::HeldOut, Split::Train] {
        let members: Vec<usize> = (0..views.len())
            .filter(|&i| views[i].split == split)
            .collect();
        if members.is_empty() {
            continue;
        }
        let with_gt: Vec<usize> = members
            .iter()
            .copied()
            .filter(|&i| views[i].gt.is_some())
            .collect();
        let gt = |i: usize| views[i].gt.as_ref();
        for (image, set) in [
            (ImageKind::Render, images.final_renders),
            (ImageKind::Deblurred, images.final_deblurred),
            (ImageKind::Enhanced, images.final_enhanced),
        ] {
            let pairs: Vec<_> = with_gt
                .iter()
                .filter_map(|&i| Some((&set[i], gt(i)?)))
                .collect();
            records.extend(mean_record(
                (split, image, Reference::Gt, Brightness::Final),
                &pairs,
            ));
        }
        for (reference, brightness, set, against) in [
            (
                Reference::Deblurred,
                Brightness::Native,
                images.renders,
                images.deblurred,
            ),
            (
                Reference::Enhanced,
                Brightness::Native,
                images.renders,
                images.enhanced,
            ),
            (
                Reference::Enhanced,
                Brightness::Final,
                images.final_renders,
                images.final_enhanced,
            ),
        ] {
            let pairs: Vec<_> = members.iter().map(|&i| (&set[i], &against[i])).collect();
            records.extend(mean_record(
                (split, ImageKind::Render, reference, brightness),
                &pairs,
            ));
        }
    }
    records
}

type What = (Split, ImageKind, Reference, Brightness);

fn mean_record(what: What, pairs: &[(&Image, &Image)]) -> Option<Record> {
    if pairs.is_empty() {
        return None;
    }
    let scores: Vec<[f64; 3]> = pairs
        .par_iter()
        .map(|(image, reference)| {
            [
                metrics::psnr(image, reference),
                metrics::psnr_colour_corrected(image, reference),
                metrics::ssim(image, reference),
            ]
        })
        .collect();
    let mean = |k: usize| scores.iter().map(|score| score[k]).sum::<f64>() / scores.len() as f64;
    let (split, image, reference, brightness) = what;
    Some(Record {
        split,
        image,
        reference,
        brightness,
        views: pairs.len() as u32,
        psnr_db: mean(0),
        psnr_cc_db: mean(1),
        ssim: mean(2),
        lpips_squeeze: None,
    })
}

/// Means of a measure over the enhanced views, the deblurred views and the renders.
pub fn means(
    images: &RoundImages<'_>,
    measure: impl Fn(&Image) -> f64 + Sync + Send + Copy,
) -> BTreeMap<String, f64> {
    [
        ("enhanced", images.enhanced),
        ("deblurred", images.deblurred),
        ("render", images.renders),
    ]
    .into_iter()
    .map(|(name, set)| (name.to_owned(), mean(set, measure)))
    .collect()
}

/// Mean of a measure over images.
pub fn mean(images: &[Image], measure: impl Fn(&Image) -> f64 + Sync + Send) -> f64 {
    images
        .par_iter()
        .map(measure)
        .collect::<Vec<_>>()
        .iter()
        .sum::<f64>()
        / images.len() as f64
}
