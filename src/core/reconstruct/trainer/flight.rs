//! Steps that the device has been handed and that the host does not know the outcome of.

use std::collections::VecDeque;

use fled_gpu::GpuError;

use crate::splat::rasterize::{PendingCounts, SplatCounts};

/// Steps whose count of intersections was not taken yet, and those that must be repeated.
#[derive(Default)]
pub(super) struct Flight {
    pending: VecDeque<(u32, Count)>,
    /// To be repeated, the next first.
    pub(super) redo: VecDeque<u32>,
}

/// How many intersections a step had.
enum Count {
    OnItsWay(PendingCounts),
    Known(SplatCounts),
}

impl Flight {
    /// Takes note of a step that was submitted.
    pub(super) fn begin(&mut self, step: u32, counts: PendingCounts) {
        self.pending.push_back((step, Count::OnItsWay(counts)));
    }

    /// Waits for the earliest step and takes it out, where more than `left` are in flight.
    pub(super) fn land(&mut self, left: usize) -> Result<Option<(u32, SplatCounts)>, GpuError> {
        if self.pending.len() <= left {
            return Ok(None);
        }
        let landed = self.pending.pop_front();
        let landed = landed.map(|(step, count)| Ok((step, count.wait()?)));
        landed.transpose()
    }

    /// Waits for all steps, and says whether each of them has done what it should. Only looks: the
    /// step after one that has to be repeated comes before its repetition, so whoever would repeat
    /// it earlier would train another scene.
    pub(super) fn is_done(&mut self) -> Result<bool, GpuError> {
        let mut done = self.redo.is_empty();
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
