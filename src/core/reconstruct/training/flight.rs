//! Steps submitted to the device whose outcome the host does not know yet.

use std::collections::VecDeque;

use fled_gpu::GpuError;

use crate::splat::rasterize::{PendingCounts, SplatCounts};

/// Steps whose count of intersections is pending.
#[derive(Default)]
pub(super) struct Flight {
    pending: VecDeque<(u32, Count)>,
}

/// The number of intersections of a step.
enum Count {
    OnItsWay(PendingCounts),
    Known(SplatCounts),
}

impl Flight {
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.pending.len()
    }

    /// Records a submitted step.
    pub(super) fn begin(&mut self, step: u32, counts: PendingCounts) {
        self.pending.push_back((step, Count::OnItsWay(counts)));
    }

    /// Removes the earliest step, after waiting for it, if more than `left` are in flight.
    pub(super) fn land(&mut self, left: usize) -> Result<Option<(u32, SplatCounts)>, GpuError> {
        if self.pending.len() <= left {
            return Ok(None);
        }
        let landed = self.pending.pop_front();
        let landed = landed.map(|(step, count)| Ok((step, count.wait()?)));
        landed.transpose()
    }

    /// Waits for all steps, keeps them in flight, and returns whether none must be repeated.
    pub(super) fn is_done(&mut self) -> Result<bool, GpuError> {
        let mut done = true;
        for (step, count) in std::mem::take(&mut self.pending) {
            let counts = count.wait()?;
            done &= !counts.overflowed();
            self.pending.push_back((step, Count::Known(counts)));
        }
        Ok(done)
    }
}

impl Count {
    fn wait(self) -> Result<SplatCounts, GpuError> {
        match self {
            Self::OnItsWay(counts) => counts.wait(),
            Self::Known(counts) => Ok(counts),
        }
    }
}
