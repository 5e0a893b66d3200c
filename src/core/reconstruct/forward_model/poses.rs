//! Correction of the views' cameras by renders of the current scene.

use fled_gpu::GpuError;
use rayon::prelude::*;

use super::ForwardModel;
use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::device::{Scene, Shaken};
use crate::image::Image;
use crate::mask::Mask;
use crate::reconstruct::ReconstructError;
use crate::reconstruct::observed::Observed;
use crate::reconstruct::schedule::reduced_size;
use crate::register::{self, Motion};

/// Number of views whose seven renders are held at once.
const AT_ONCE: usize = 4;
/// Longer side above which the renders have half the size, px.
const LARGEST_SIDE: usize = 640;

/// A view's photograph and renders before its camera is corrected.
struct Probed {
    photograph: Image,
    /// The pixels that count.
    kept: Option<Mask>,
    render: Image,
    probed: [Image; 6],
    probes: [[f64; 6]; 6],
}

impl Probed {
    fn correction(&self) -> Option<[f64; 6]> {
        let Self { photograph, kept, render, probed, probes } = self;
        register::correction(photograph, render, probed, probes, kept.as_ref())
    }

    /// Whether `render` is nearer to the photograph.
    fn is_worse_than(&self, render: &Image) -> bool {
        let to = |render| register::difference(&self.photograph, render, self.kept.as_ref());
        to(render) < to(&self.render)
    }
}

/// One correction of the cameras.
#[derive(Clone, Copy)]
pub(in crate::reconstruct) struct Correction {
    /// Approximate distance of the scene, world units.
    pub(in crate::reconstruct) depth: f64,
    /// Degree of the harmonics.
    pub(in crate::reconstruct) degree: u32,
    /// Whether renders of any size have half of that in training, for a quarter of the work:
    /// precise enough if another correction follows.
    pub(in crate::reconstruct) is_coarse: bool,
}

impl Correction {
    /// The size of the renders of a view with this size in training.
    fn size(&self, view: [usize; 2]) -> [usize; 2] {
        reduced_size(view[0], view[1], 1 + usize::from(self.halves(view))).into()
    }

    fn halves(&self, view: [usize; 2]) -> bool {
        self.is_coarse || view[0].max(view[1]) > LARGEST_SIDE
    }
}

impl ForwardModel<'_> {
    /// Takes one Gauss-Newton step of every camera; their common motion is that of the world and is
    /// removed.
    pub(in crate::reconstruct) fn refine_poses(
        &mut self,
        scene: &mut dyn Scene,
        how: Correction,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        self.correct_cameras(scene, how, cancel)?;
        let given: Vec<Camera> = self.views.iter().map(|view| view.given().camera).collect();
        let mut motions: Vec<Motion> = self.views.iter().map(Observed::motion).collect();
        register::hold_gauge(&given, &mut motions);
        self.set_motions(motions);
        Ok(())
    }

    /// Takes one Gauss-Newton step of every camera. A camera stays in place if the step makes its
    /// render fit worse.
    pub(in crate::reconstruct) fn correct_cameras(
        &mut self,
        scene: &mut dyn Scene,
        how: Correction,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        let all: Vec<usize> = (0..self.views.len()).collect();
        for some in all.chunks(AT_ONCE) {
            cancel.check()?;
            let seen = some.iter().map(|&view| self.probe(scene, view, how));
            let seen = seen.collect::<Result<Vec<_>, _>>()?;
            let corrections: Vec<_> = seen.par_iter().map(Probed::correction).collect();
            for ((&view, seen), correction) in some.iter().zip(&seen).zip(corrections) {
                let Some(correction) = correction else {
                    continue;
                };
                let motion = self.views[view].motion().plus(&correction);
                let size = how.size(self.views[view].size());
                let camera = self.views[view].camera_after(&motion, size);
                let after = self.render(scene, view, &camera, how)?;
                if seen.is_worse_than(&after) {
                    self.views[view].move_to(motion);
                }
            }
        }
        Ok(())
    }

    /// Renders the scene with the shake of `view` applied.
    fn render(
        &self,
        scene: &mut dyn Scene,
        view: usize,
        camera: &Camera,
        how: Correction,
    ) -> Result<Image, GpuError> {
        let Some(response) = &self.response else {
            return scene.render(camera, how.degree);
        };
        let view = &self.views[view];
        let halved = how.halves(view.size()).then(|| view.kernel.halved());
        let kernel = halved.as_ref().unwrap_or(&view.kernel);
        scene.render_shaken(camera, how.degree, Shaken { kernel, response })
    }

    fn probe(
        &self,
        scene: &mut dyn Scene,
        view: usize,
        how: Correction,
    ) -> Result<Probed, GpuError> {
        let size = how.size(self.views[view].size());
        let motion = self.views[view].motion();
        let camera = self.views[view].camera_after(&motion, size);
        let render = self.render(scene, view, &camera, how)?;
        let probes = register::probes(&camera, how.depth);
        let mut probed = Vec::with_capacity(probes.len());
        for probe in &probes {
            let moved = self.views[view].camera_after(&motion.plus(probe), size);
            probed.push(self.render(scene, view, &moved, how)?);
        }
        let probed =
            probed.try_into().map_err(|_| GpuError::Validation("six probes".to_owned()))?;
        let view = &self.views[view];
        let (photograph, kept) = (view.photograph(size), view.mask(size));
        Ok(Probed { photograph, kept, render, probed, probes })
    }

    fn set_motions(&mut self, motions: impl IntoIterator<Item = Motion>) {
        for (view, motion) in self.views.iter_mut().zip(motions) {
            view.move_to(motion);
        }
    }

    /// The motions as numbers, for a checkpoint.
    pub(in crate::reconstruct) fn save_motions(&self) -> Vec<f32> {
        let twists = self.views.iter().map(|view| view.motion().twist);
        twists.flatten().collect()
    }

    /// Restores the motions of a checkpoint.
    pub(in crate::reconstruct) fn restore_motions(
        &mut self,
        state: &[f32],
    ) -> Result<(), ReconstructError> {
        let (twists, rest) = state.as_chunks();
        if twists.len() != self.views.len() || !rest.is_empty() {
            return Err(ReconstructError::OtherRound);
        }
        self.set_motions(twists.iter().map(|&twist| Motion { twist }));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn renders_of_large_views_have_half_the_size() {
        let how = |is_coarse| Correction { depth: 1.0, degree: 0, is_coarse };
        assert_eq!(how(false).size([560, 373]), [560, 373]);
        assert_eq!(how(true).size([560, 373]), [280, 187]);
        assert_eq!(how(false).size([747, 1120]), [374, 560]);
        assert_eq!(how(true).size([747, 1120]), [374, 560]);
    }
}
