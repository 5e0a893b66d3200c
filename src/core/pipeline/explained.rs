//! Which views of a round have a kernel that explains their shake, and what each is trained on.

use super::config::{Options, ShakeModel};
use super::context::Context;
use super::views::View;
use crate::camera::Split;
use crate::image::Image;
use crate::metrics::RoundMetrics;

/// Of every view, in their order, whether a kernel explains its shake in a round. `before`: what is
/// known of the round before.
pub fn explained(
    options: &Options,
    round: u32,
    views: &[View],
    before: Option<&RoundMetrics>,
) -> Vec<bool> {
    let rows = before.map_or(&[][..], |before| &before.views);
    let tells = |view: &View| {
        let mut rows = rows.iter();
        let row = rows.find(|row| row.name == view.name);
        row.and_then(|row| row.is_shaken).unwrap_or(false)
    };
    views
        .iter()
        .map(|view| options.shake.explains(round, tells(view)))
        .collect()
}

/// Those of H and D that the views are trained on.
pub fn training_images(
    options: &Options,
    explained: &[bool],
    enhanced: &[Image],
    deblurred: &[Image],
) -> Vec<Image> {
    let pairs = enhanced.iter().zip(deblurred).zip(explained);
    pairs
        .map(|((enhanced, deblurred), &explained)| {
            if options.trains_on_enhanced(explained) {
                enhanced.clone()
            } else {
                deblurred.clone()
            }
        })
        .collect()
}

/// Tells what the views of a round are trained on, and why.
pub fn tell(
    context: &mut Context<'_>,
    options: &Options,
    round: u32,
    views: &[View],
    explained: &[bool],
) {
    let training: Vec<bool> = views
        .iter()
        .zip(explained)
        .filter(|(view, _)| view.split == Split::Train)
        .map(|(_, explained)| *explained)
        .collect();
    let (all, with) = (
        training.len(),
        training.iter().filter(|with| **with).count(),
    );
    let rest = if options.trains_on_enhanced(false) {
        "enhanced"
    } else {
        "deblurred"
    };
    let line = match (options.shake, with) {
        (ShakeModel::Late, 0) if round > 1 => {
            format!("no view is told from a still one: no kernels, {all} views trained {rest}")
        }
        (_, 0) => format!("{all} views trained {rest}"),
        _ => format!("kernels explain the shake of {with} of {all} views, the others {rest}"),
    };
    context.sink.log(format!("round {round}: {line}"));
}
