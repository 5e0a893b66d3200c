//! The tools of a run.

use std::path::PathBuf;

use crate::device::Device;

use crate::deblur::{Restorer, RestorerInfo};
use crate::poses::Sfm;
use crate::poses::matching::Matching;

pub struct Tools<'a> {
    /// The device that trains and renders.
    pub device: &'a Device,
    /// Structure from motion.
    pub sfm: &'a dyn Sfm,
    /// Matches photographs with renders to find late views; without it, none are found.
    pub matching: Option<&'a dyn Matching>,
    /// The deblurring network.
    pub deblurrer: &'a mut dyn Restorer,
    /// The network that brightens in place of the tone curve: a baseline.
    pub enhancer: Option<&'a mut dyn Restorer>,
    /// The substitutes already in use for tools that were requested, one sentence each.
    pub fallbacks: Vec<String>,
    /// Folder that keeps poses and the costs of stages between runs. COLMAP draws from the system's
    /// entropy, so its answer differs from run to run; the cache makes equal runs equal.
    pub cache: Option<PathBuf>,
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
