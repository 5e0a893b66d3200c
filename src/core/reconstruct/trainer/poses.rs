//! Between steps: where each view was taken from, judged by its render as the scene stands.

use fled_gpu::GpuError;
use rayon::prelude::*;

use super::Trainer;
use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::image::Image;
use crate::reconstruct::ReconstructError;
use crate::register::{self, Motion};

/// Views whose seven renders are held at once.
const AT_ONCE: usize = 4;

/// What is known of a view before its camera is corrected.
struct Probed {
    photograph: Image,
    render: Image,
    probed: [Image; 6],
    probes: [[f64; 6]; 6],
}

impl Trainer<'_> {
    pub(super) fn refines_poses(&self, step: u32) -> bool {
        self.config.refine_poses.is_some() && self.schedule.refines_poses(step)
    }

    /// One Gauss-Newton step of every camera.
    pub(super) fn refine_poses(
        &mut self,
        step: u32,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        self.correct_cameras(step, cancel)?;
        let given: Vec<Camera> = self.views.iter().map(|view| view.camera).collect();
        register::hold_gauge(&given, &mut self.motions);
        self.place_cameras();
        Ok(())
    }

    /// A camera stays where it is if the images agree less well after its step.
    fn correct_cameras(&mut self, step: u32, cancel: &CancelToken) -> Result<(), ReconstructError> {
        let Some(depth) = self.config.refine_poses else {
            return Ok(());
        };
        let all: Vec<usize> = (0..self.views.len()).collect();
        for some in all.chunks(AT_ONCE) {
            cancel.check()?;
            let seen = some
                .iter()
                .map(|&view| self.probe(view, step, depth))
                .collect::<Result<Vec<_>, _>>()?;
            let corrections: Vec<Option<[f64; 6]>> = seen
                .par_iter()
                .map(|s| register::correction(&s.photograph, &s.render, &s.probed, &s.probes))
                .collect();
            for ((&view, seen), correction) in some.iter().zip(&seen).zip(corrections) {
                let Some(correction) = correction else {
                    continue;
                };
                let motion = self.motions[view].plus(&correction);
                let after =
                    self.render_from(&self.camera_after(view, &motion), step, Some(view))?;
                let improved = register::difference(&seen.photograph, &after)
                    < register::difference(&seen.photograph, &seen.render);
                if improved {
                    self.motions[view] = motion;
                }
            }
        }
        self.place_cameras();
        Ok(())
    }

    fn probe(&mut self, view: usize, step: u32, depth: f64) -> Result<Probed, GpuError> {
        let camera = self.level.views[view].camera;
        let render = self.render_from(&camera, step, Some(view))?;
        let probes = register::probes(&camera, depth);
        let mut probed = Vec::with_capacity(6);
        for probe in &probes {
            let moved = self.camera_after(view, &self.motions[view].plus(probe));
            probed.push(self.render_from(&moved, step, Some(view))?);
        }
        let probed = probed
            .try_into()
            .map_err(|_| GpuError::Validation("six probes".to_owned()))?;
        let photograph = self.photograph(view, render.width(), render.height());
        Ok(Probed {
            photograph,
            render,
            probed,
            probes,
        })
    }

    /// The camera of `view` at the level's resolution after `motion`.
    fn camera_after(&self, view: usize, motion: &Motion) -> Camera {
        let k = &self.level.views[view].camera.intrinsics;
        motion
            .moved(&self.views[view].camera)
            .resized(k.width, k.height)
    }

    /// Sets the level's cameras by the motions.
    pub(super) fn place_cameras(&mut self) {
        for view in 0..self.views.len() {
            self.level.views[view].camera = self.camera_after(view, &self.motions[view]);
        }
    }

    /// Takes up the motions of a checkpoint.
    pub(super) fn restore_motions(&mut self, state: &[f32]) -> Result<(), ReconstructError> {
        let (rows, rest) = state.as_chunks::<6>();
        if rows.len() != self.views.len() || !rest.is_empty() {
            return Err(ReconstructError::OtherRound);
        }
        self.motions = rows.iter().map(|&twist| Motion { twist }).collect();
        self.place_cameras();
        Ok(())
    }

    /// Kernels, colours and cameras of the views with the scene as it is: rounds of both, at full
    /// resolution.
    pub(in crate::reconstruct) fn register(
        mut self,
        rounds: u32,
        cancel: &CancelToken,
    ) -> Result<Vec<Camera>, ReconstructError> {
        let last = self.config.steps;
        for _ in 0..rounds {
            if self.config.view_colour {
                self.fit_colours(last, cancel)?;
            }
            self.estimate_shake(last, cancel)?;
            self.correct_cameras(last, cancel)?;
        }
        Ok(self.cameras())
    }

    /// The views' cameras, at the size of their images, as they stand now.
    pub(super) fn cameras(&self) -> Vec<Camera> {
        self.views
            .iter()
            .zip(&self.motions)
            .map(|(view, motion)| motion.moved(&view.camera))
            .collect()
    }
}
