//! The scores of a round against each of its references.

use std::borrow::Cow;

use rayon::prelude::*;

use super::images::TargetImages;
use crate::camera::Split;
use crate::image::Image;
use crate::metrics::{Brightness, ImageKind, Record, Reference, Scores};
use crate::pipeline::views::View;

/// One kind of image against one kind of reference, at one brightness.
#[derive(Clone, Debug)]
pub struct Comparison {
    pub image: ImageKind,
    pub reference: Reference,
    pub brightness: Brightness,
    /// Scores by view; `None` where a view has no such reference, or no pixel of it counts.
    pub scores: Vec<Option<Scores>>,
}

/// Every comparison of a round: with ground truth where the capture has it, and of the renders with
/// their training images.
pub fn comparisons(views: &[View], target: &TargetImages<'_>) -> Vec<Comparison> {
    use Brightness::{Final, Native};
    let compare = |image, reference, brightness, of: &Images<'_>, against: &References<'_>| {
        let scores = (0..views.len()).into_par_iter().map(|view| {
            let reference = against(view)?;
            Scores::of(&of(view), reference, views[view].mask.as_ref())
        });
        Comparison { image, reference, brightness, scores: scores.collect() }
    };
    let images = &target.images;
    let truth: &References<'_> = &|view| views[view].gt.as_ref();
    let deblurred: &References<'_> = &|view| Some(&images.deblurred[view]);
    let enhanced: &References<'_> = &|view| Some(&images.enhanced[view]);
    let bright: &References<'_> = &|view| Some(&target.enhanced[view]);
    let native: &Images<'_> = &|view| Cow::Borrowed(&images.renders[view]);
    let render_at_target: &Images<'_> = &|view| target.render(view);
    let deblurred_at_target: &Images<'_> = &|view| target.deblurred(view);
    let enhanced_at_target: &Images<'_> = &|view| Cow::Borrowed(&target.enhanced[view]);
    let (gt, render) = (Reference::Gt, ImageKind::Render);
    vec![
        compare(render, gt, Final, render_at_target, truth),
        compare(ImageKind::Deblurred, gt, Final, deblurred_at_target, truth),
        compare(ImageKind::Enhanced, gt, Final, enhanced_at_target, truth),
        compare(render, Reference::Deblurred, Native, native, deblurred),
        compare(render, Reference::Enhanced, Native, native, enhanced),
        compare(render, Reference::Enhanced, Final, render_at_target, bright),
    ]
}

/// Returns the image of a view.
type Images<'a> = dyn Fn(usize) -> Cow<'a, Image> + Sync + 'a;
/// Returns the reference of a view.
type References<'a> = dyn Fn(usize) -> Option<&'a Image> + Sync + 'a;

/// The means of each comparison by split.
pub fn records(views: &[View], comparisons: &[Comparison]) -> Vec<Record> {
    let mean = |split: Split| {
        let of = move |comparison| mean_record(views, split, comparison);
        comparisons.iter().filter_map(of)
    };
    [Split::HeldOut, Split::Train].into_iter().flat_map(mean).collect()
}

fn mean_record(views: &[View], split: Split, comparison: &Comparison) -> Option<Record> {
    let members = views.iter().zip(&comparison.scores);
    let scores: Vec<Scores> =
        members.filter(|(view, _)| view.split == split).filter_map(|(_, scores)| *scores).collect();
    if scores.is_empty() {
        return None;
    }
    let mean = |of: fn(&Scores) -> f64| scores.iter().map(of).sum::<f64>() / scores.len() as f64;
    Some(Record {
        split,
        image: comparison.image,
        reference: comparison.reference,
        brightness: comparison.brightness,
        views: scores.len() as u32,
        psnr_db: mean(|scores| scores.psnr_db),
        psnr_cc_db: mean(|scores| scores.psnr_cc_db),
        ssim: mean(|scores| scores.ssim),
        lpips_squeeze: None,
    })
}
