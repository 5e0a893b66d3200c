//! Strategy F: all of them once more, on brightened and deblurred copies of the photographs.

use std::path::Path;

use super::request::ask;
use crate::camera::Camera;
use crate::capture::PreparedImage;
use crate::deblur::Restorer;
use crate::event::Event;
use crate::image::{Image, ImageError};
use crate::pipeline::config::Options;
use crate::pipeline::context::Context;
use crate::pipeline::dependencies::PosesDependencies;
use crate::pipeline::enhance;
use crate::pipeline::error::PipelineError;
use crate::pipeline::tone::Tone;
use crate::pipeline::tools::Tools;
use crate::poses::{Lens, PoseView, PosedView, Poses, PosesError};

/// Name of this strategy in results.
pub const STRATEGY: char = 'F';

/// Longest side of the copies, px: that of strategy A's.
const LONGEST_SIDE: usize = 640;

/// Poses by way of deblurred copies, as of the photographs at their own sizes. What structure from
/// motion says of the copies, even that it fails, is the value; errors are of the way there.
///
/// # Errors
/// Those of reading, brightening and restoring a photograph.
pub fn poses(
    context: &mut Context<'_>,
    tools: &mut Tools<'_>,
    views: &[PoseView],
    depends_on: &PosesDependencies,
) -> Result<Result<Poses, PosesError>, PipelineError> {
    let folder = context.workspace.folder().work().poses_of_deblurred();
    context.workspace.make_folder(&folder)?;
    let name = "deblurring all photographs".to_owned();
    context.sink.event(&Event::StrategyStarted { strategy: STRATEGY, name });
    let bright = brightened(views, depends_on.second.options())?;
    let mut copies = Vec::with_capacity(views.len());
    for (view, image) in views.iter().zip(&bright) {
        context.cancel.check()?;
        let file = folder.join(format!("{}.half", view.name));
        copies.push(copy(context, tools.deblurrer, view, image, &file)?);
    }
    let seed = depends_on.first.options().seed;
    let outer = &mut *context.sink;
    let mut sink = |event: &Event| {
        // If they fail, too, what the photographs themselves have in common is said.
        if !matches!(event, Event::OverlapFound(_)) {
            outer.event(&named(event));
        }
    };
    let mut again = Context::new(context.workspace, &mut sink, context.cancel);
    let found = match ask(&mut again, tools, &copies, &folder.join("colmap"), &[], seed) {
        Ok(found) => found,
        Err(error) => return Ok(Err(error)),
    };
    let placed = found
        .views
        .into_iter()
        .map(|posed| at_original_size(posed, views))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Ok(Poses { views: placed, strategy: Some(STRATEGY), ..found }))
}

/// The event with a strategy's name that tells it from the same one on the photographs.
fn named(event: &Event) -> Event {
    match event {
        Event::StrategyStarted { strategy, name } => Event::StrategyStarted {
            strategy: *strategy,
            name: format!("{name}, after deblurring"),
        },
        event => event.clone(),
    }
}

fn brightened(views: &[PoseView], options: &Options) -> Result<Vec<Image>, PipelineError> {
    let load = |view: &PoseView| {
        view.prepared.load_at_most(LONGEST_SIDE).map_err(|source| unreadable(view, source))
    };
    let dark = views.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    let dark: Vec<&Image> = dark.iter().collect();
    let target = enhance::target(options, &dark)?;
    Ok(Tone::fit(options.lut_scope, &dark, &[target]).apply(dark))
}

/// One photograph, deblurred, written to `file`.
fn copy(
    context: &mut Context<'_>,
    network: &mut dyn Restorer,
    view: &PoseView,
    image: &Image,
    file: &Path,
) -> Result<PoseView, PipelineError> {
    let deblurred = network.restore(image, None)?;
    for warning in network.take_warnings() {
        let message = format!("{}: {warning}", view.path);
        context.sink.warn("poses", message);
    }
    let scale = image.width() as f64 / view.original.0 as f64;
    let prepared = PreparedImage::write(&deblurred.to_linear(), file)
        .map_err(|source| PipelineError::Io { path: file.to_owned(), source })?;
    Ok(PoseView {
        name: view.name.clone(),
        path: view.path.clone(),
        original: (prepared.width, prepared.height),
        prepared,
        focal_px: view.focal_px.map(|focal| focal * scale),
        mask: view.mask.clone(),
    })
}

fn at_original_size(posed: PosedView, views: &[PoseView]) -> Result<PosedView, PipelineError> {
    let Some(view) = views.iter().find(|view| view.name == posed.name) else {
        return Ok(posed);
    };
    let (width, height) = view.original;
    let lens = Lens { intrinsics: posed.lens.intrinsics.resized(width, height), ..posed.lens };
    let camera = Camera { intrinsics: lens.pinhole(), ..posed.camera };
    Ok(PosedView { camera, lens, ..posed })
}

fn unreadable(view: &PoseView, source: ImageError) -> PipelineError {
    PipelineError::Photograph { name: view.path.to_string(), source }
}
