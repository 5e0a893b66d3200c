//! What a run may use.

use std::path::PathBuf;

use fled_gpu::Gpu;

use crate::deblur::{Restorer, RestorerInfo};
use crate::poses::Sfm;
use crate::poses::matching::Matching;

/// What a run may use.
pub struct Tools<'a> {
    /// The device that trains and renders.
    pub gpu: &'a Gpu,
    /// Who finds the poses.
    pub sfm: &'a dyn Sfm,
    /// Who finds matches between photographs and renders, for late views; `None`: none are found.
    pub matching: Option<&'a dyn Matching>,
    /// The deblurring network.
    pub deblurrer: &'a mut dyn Restorer,
    /// The network that brightens in place of the tone curve: a baseline.
    pub enhancer: Option<&'a mut dyn Restorer>,
    /// What was already used in place of what was asked for, one sentence each.
    pub fallbacks: Vec<String>,
    /// Folder in which poses are kept from run to run. COLMAP draws from the system's entropy,
    /// so its answer differs from run to run; a kept answer makes equal runs equal.
    pub pose_cache: Option<PathBuf>,
}

impl Tools<'_> {
    /// The networks of this run.
    pub(super) fn networks(&self) -> Networks {
        Networks {
            deblur: self.deblurrer.describe(),
            enhance: self.enhancer.as_ref().map(|enhancer| enhancer.describe()),
        }
    }
}

/// The networks of a run, by the option that chose them.
#[derive(Clone, Debug)]
pub(super) struct Networks {
    /// Restores views.
    pub deblur: RestorerInfo,
    /// Brightens in place of the tone curve.
    pub enhance: Option<RestorerInfo>,
}

impl Networks {
    /// Each network with the name of its option.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, &RestorerInfo)> {
        let enhance = self.enhance.as_ref().map(|network| ("enhance", network));
        [("deblur", &self.deblur)].into_iter().chain(enhance)
    }
}
