//! Live feedback of a round in training: scores of held-out views, and a picture of one. None of it
//! affects the scene.

use std::time::{Duration, Instant};

use fled_gpu::GpuError;
use rayon::prelude::*;

use crate::camera::{Camera, Split};
use crate::enhance::spread_indices;
use crate::event::Event;
use crate::image::Image;
use crate::mask::Mask;
use crate::metrics::Scores;
use crate::pipeline::context::Context;
use crate::pipeline::pictures;
use crate::pipeline::round::Round;
use crate::pipeline::views::View;
use crate::reconstruct::Look;
use crate::reconstruct::schedule::reduced_size;
use crate::shake::{self, Response, shaken_image};

/// Steps between scores.
const SCORED: u32 = 100;
/// Most views that are scored.
const MAX_VIEWS: usize = 3;
/// Divisor of their sides: they are compared at a quarter of the pixels.
const PART: usize = 2;
/// Time between pictures.
const PICTURED: Duration = Duration::from_secs(10);
/// Longest side of a picture, px.
const PICTURE_SIDE: usize = 640;
/// Pause after a score or a picture, as a multiple of its duration: each of the two takes at most a
/// hundredth of the time, on any device.
const REST: u32 = 100;

/// The inputs of the live feedback.
#[derive(Clone, Copy)]
pub struct Watched<'a> {
    /// The round.
    pub round: &'a Round,
    /// All views.
    pub views: &'a [View],
    /// H_i, in their order.
    pub enhanced: &'a [Image],
    /// The response from light to values at the target brightness, which ground truth has.
    pub target: &'a Response,
}

/// The live feedback of one round.
pub struct Watch<'a> {
    round: &'a Round,
    target: &'a Response,
    compared: Vec<Compared>,
    /// Whether the references are ground truth.
    truth: bool,
    /// The view whose picture is made; `None` after a picture could not be written.
    pictured: Option<&'a View>,
    scores: Pace,
    pictures: Pace,
}

/// A held-out view, reduced.
struct Compared {
    camera: Camera,
    reference: Image,
    mask: Option<Mask>,
}

impl<'a> Watch<'a> {
    /// Watches a round. If some held-out views have ground truth, those are scored
    /// against it; else all are scored against their enhanced views.
    pub fn new(watched: &Watched<'a>) -> Self {
        let views = watched.views;
        let held_out: Vec<usize> =
            (0..views.len()).filter(|&view| views[view].split == Split::HeldOut).collect();
        let with_truth: Vec<usize> =
            held_out.iter().copied().filter(|&view| views[view].gt.is_some()).collect();
        let truth = !with_truth.is_empty();
        let from = if truth { &with_truth } else { &held_out };
        let compared = spread_indices(from.len(), MAX_VIEWS)
            .into_iter()
            .map(|place| {
                let view = from[place];
                let truth = views[view].gt.as_ref().filter(|_| truth);
                Compared::new(&views[view], truth.unwrap_or(&watched.enhanced[view]))
            })
            .collect();
        let pictured = held_out.first().copied().unwrap_or(views.len() / 2);
        Self {
            round: watched.round,
            target: watched.target,
            compared,
            truth,
            pictured: views.get(pictured),
            scores: Pace::new(),
            pictures: Pace::new(),
        }
    }

    /// Makes the scores and pictures that are due, and reports them to the event sink. If memory
    /// for them runs out, live feedback ends with a warning; training is the same either way.
    ///
    /// # Errors
    /// Any other device error.
    pub fn look(&mut self, look: &mut Look<'_>, context: &mut Context<'_>) -> Result<(), GpuError> {
        let error = match self.show(look, context) {
            Err(error @ GpuError::OutOfMemory { .. }) => error,
            outcome => return outcome,
        };
        self.pictured = None;
        self.compared.clear();
        let message = format!("round {}: no more live feedback: {error}", self.round.number);
        context.sink.warn("live_picture", message);
        Ok(())
    }

    fn show(&mut self, look: &mut Look<'_>, context: &mut Context<'_>) -> Result<(), GpuError> {
        let scored = look.step.is_multiple_of(SCORED) && self.scores.is_due();
        if !self.compared.is_empty() && (scored || look.is_last()) {
            let begin = Instant::now();
            self.score(look, context)?;
            self.scores.took(begin.elapsed(), Duration::ZERO);
        }
        if let Some(view) = self.pictured.filter(|_| self.pictures.is_due()) {
            let begin = Instant::now();
            self.picture(view, look, context)?;
            self.pictures.took(begin.elapsed(), PICTURED);
        }
        Ok(())
    }

    fn score(&self, look: &mut Look<'_>, context: &mut Context<'_>) -> Result<(), GpuError> {
        let mut renders = Vec::with_capacity(self.compared.len());
        for compared in &self.compared {
            renders.push(look.render(&compared.camera)?);
        }
        let scores: Vec<Scores> = renders
            .par_iter()
            .zip(&self.compared)
            .filter_map(|(render, compared)| self.compare(render, compared))
            .collect();
        let mean =
            |of: fn(&Scores) -> f64| scores.iter().map(of).sum::<f64>() / scores.len() as f64;
        let (psnr_cc_db, ssim) = (mean(|scores| scores.psnr_cc_db), mean(|scores| scores.ssim));
        // A diverged scene has no finite score, and JSON no other numbers.
        if psnr_cc_db.is_finite() && ssim.is_finite() {
            context.sink.event(&Event::HeldOutSeen {
                round: self.round.number,
                step: look.step,
                steps: look.steps,
                psnr_cc_db,
                ssim,
                views: scores.len() as u32,
                truth: self.truth,
            });
        }
        Ok(())
    }

    /// PSNR after a colour fit and SSIM, as in the evaluation of a round: of the render at the
    /// target brightness against ground truth, or of the shaken render against the enhanced view.
    fn compare(&self, render: &Image, compared: &Compared) -> Option<Scores> {
        let (reference, mask) = (&compared.reference, compared.mask.as_ref());
        let response = &self.round.response;
        let render = render.map(|value| value.clamp(0.0, 1.0));
        let seen = if self.truth {
            render.map(|value| self.target.value(response.light(f64::from(value))) as f32)
        } else {
            let kernel = shake::estimate(&render, reference, response, mask);
            shaken_image(&render, &kernel, response)
        };
        Scores::of(&seen, reference, mask)
    }

    fn picture(
        &mut self,
        view: &View,
        look: &mut Look<'_>,
        context: &mut Context<'_>,
    ) -> Result<(), GpuError> {
        let (width, height) = view.dark.size_at_most(PICTURE_SIDE);
        let render = look.render(&view.camera.resized(width, height))?;
        let round = self.round.number;
        let path = context.workspace.folder().work().live_picture();
        match pictures::preview(context.workspace, &path, &render) {
            Ok(()) => context.sink.event(&Event::ViewSeen {
                round,
                step: look.step,
                view: view.name.clone(),
                held_out: view.split == Split::HeldOut,
            }),
            // A failed picture ends the pictures, but not this run.
            Err(error) => {
                self.pictured = None;
                let message = format!("round {round}: no more live pictures: {error}");
                context.sink.warn("live_picture", message);
            }
        }
        Ok(())
    }
}

impl Compared {
    fn new(view: &View, reference: &Image) -> Self {
        let (width, height) = reduced_size(reference.width(), reference.height(), PART);
        Self {
            camera: view.camera.resized(width, height),
            reference: reference.resize_area(width, height),
            mask: view.mask.as_ref().map(|mask| mask.resized(width, height)),
        }
    }
}

/// The interval between looks.
struct Pace {
    since: Instant,
    rest: Duration,
}

impl Pace {
    /// The first look is due at once.
    fn new() -> Self {
        Self { since: Instant::now(), rest: Duration::ZERO }
    }

    fn is_due(&self) -> bool {
        self.since.elapsed() >= self.rest
    }

    /// Records the duration of a look. The next follows after [`REST`] times as long, at least
    /// `rest`.
    fn took(&mut self, long: Duration, rest: Duration) {
        (self.since, self.rest) = (Instant::now(), rest.max(REST * long));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_takes_a_hundredth_of_the_time_or_less() {
        let mut pace = Pace::new();
        assert!(pace.is_due());
        pace.took(Duration::from_secs(3), PICTURED);
        assert_eq!(pace.rest, Duration::from_secs(300));
        assert!(!pace.is_due());
        pace.took(Duration::from_millis(1), PICTURED);
        assert_eq!(pace.rest, PICTURED);
        pace.took(Duration::ZERO, Duration::ZERO);
        assert!(pace.is_due());
    }
}
