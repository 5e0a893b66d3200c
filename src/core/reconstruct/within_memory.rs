//! Training that goes on with fewer Gaussians when a device runs out of memory.

use fled_gpu::GpuError;

use super::{Checkpoint, ReconstructError, TrainConfig, TrainStart, Trained};
use crate::device::Device;
use crate::gaussians::Gaussians;

/// Number of Gaussians below which none are taken away: something else needs the memory.
const LEAST_CAP: usize = 10_000;

/// Trains with `attempt`. Each time the device runs out of memory, halves the cap of `config` and
/// goes on from the last checkpoint, with its most visible Gaussians, or from `start`. `resume`
/// receives the reason as a sentence for users and returns that checkpoint, if there is one.
///
/// # Errors
/// Those of `attempt`; [`GpuError::OutOfMemory`] or [`GpuError::TooLarge`] if fewer Gaussians are
/// of no help.
pub fn within_memory(
    device: &Device,
    start: TrainStart,
    config: &mut TrainConfig,
    attempt: &mut dyn FnMut(TrainStart, &TrainConfig) -> Result<Trained, ReconstructError>,
    resume: &mut dyn FnMut(String) -> Option<Checkpoint>,
) -> Result<Trained, ReconstructError> {
    // A processor reports no lack of memory, and a resumed round has its checkpoint.
    let spare = match (device, &start) {
        (Device::Gpu(_), TrainStart::Fresh(gaussians)) => Some(gaussians.clone()),
        _ => None,
    };
    let mut next = start;
    loop {
        let error = match attempt(next, config) {
            Err(ReconstructError::Gpu(
                error @ (GpuError::OutOfMemory { .. } | GpuError::TooLarge { .. }),
            )) => error,
            outcome => return outcome,
        };
        // A fault that lasts is reported here.
        device.wait()?;
        let fewer = config.cap / 2;
        if fewer < LEAST_CAP {
            return Err(error.into());
        }
        let why = format!(
            "{error}: training goes on with at most {fewer} Gaussians instead of {}",
            config.cap
        );
        config.cap = fewer;
        let from = match (resume(why), &spare) {
            (Some(checkpoint), _) => TrainStart::Resume(checkpoint),
            (None, Some(gaussians)) => TrainStart::Fresh(gaussians.clone()),
            (None, None) => return Err(error.into()),
        };
        next = with_at_most(from, fewer);
    }
}

/// The start with its `most` most visible Gaussians.
fn with_at_most(start: TrainStart, most: usize) -> TrainStart {
    match start {
        TrainStart::Fresh(gaussians) => {
            TrainStart::Fresh(gaussians.select(&most_visible(&gaussians, most)))
        }
        TrainStart::Resume(checkpoint) => {
            let kept = most_visible(&checkpoint.state.gaussians(), most);
            let state = checkpoint.state.select(&kept);
            TrainStart::Resume(Checkpoint { state, cap: most as u64, ..checkpoint })
        }
    }
}

/// The `most` Gaussians whose opacity times area is largest, in their order.
fn most_visible(gaussians: &Gaussians, most: usize) -> Vec<usize> {
    let visibility = |i: usize| {
        if !gaussians.is_usable(i) {
            return 0.0;
        }
        let mut scales = gaussians.log_scales[i].map(f64::from);
        scales.sort_by(f64::total_cmp);
        (scales[1] + scales[2]).exp() * gaussians.opacity(i)
    };
    let mut all: Vec<(f64, usize)> = (0..gaussians.len()).map(|i| (visibility(i), i)).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<usize> = all.into_iter().take(most).map(|(_, index)| index).collect();
    kept.sort_unstable();
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::fixtures;

    #[test]
    fn large_and_opaque_gaussians_stay_in_their_order() {
        let mut scene = fixtures::gaussians(4, 1, 1);
        scene.opacity_logits = vec![0.0, -6.0, 0.0, 3.0];
        scene.log_scales = vec![[-3.0, -3.0, -9.0], [-3.0; 3], [-1.0, -9.0, -1.0], [-3.0; 3]];
        assert_eq!(most_visible(&scene, 3), [0, 2, 3]);
        assert_eq!(most_visible(&scene, 1), [2]);
        assert_eq!(most_visible(&scene, 9), [0, 1, 2, 3]);
        scene.means[2][0] = f32::NAN;
        assert_eq!(most_visible(&scene, 1), [3], "not one that cannot be drawn");
    }
}
