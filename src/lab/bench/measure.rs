//! Measures steps per second without timestamps, then the time of every kernel with them.

use std::collections::BTreeMap;
use std::time::Instant;

use fled_gpu::Gpu;

use super::error::BenchError;
use super::options::Budget;
use super::subject::Subject;
use fled_core::cancel::CancelToken;
use fled_core::device::Device;
use fled_core::splat::rasterize::SplatCounts;

/// Steps before the measurement, which compile kernels and grow buffers.
const WARM_UP: u32 = 3;
/// Minimum number of steps, since fewer have no meaningful median. If a single step exceeds the
/// budget, it runs once.
const LEAST: u32 = 3;

/// The measurements of one case.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    /// Number of steps without timestamps.
    pub(super) steps: u32,
    /// Total seconds of these steps.
    pub(super) seconds: f64,
    /// `None` if the device has no timestamps.
    pub(super) profiled: Option<Profiled>,
    /// Counts of the step with the median number of intersections: views differ a little.
    pub(super) counts: Option<SplatCounts>,
}

/// Medians over the steps with timestamps.
#[derive(Clone, Debug)]
pub(super) struct Profiled {
    pub(super) steps: u32,
    /// Seconds per step on the host's clock.
    pub(super) wall: f64,
    /// Seconds of all kernels per step.
    pub(super) kernels: f64,
    /// Name, seconds and dispatches per step, the slowest first.
    pub(super) rows: Vec<(&'static str, f64, u64)>,
}

pub(super) fn measure(
    device: &Device,
    subject: &mut impl Subject,
    budget: Budget,
    cancel: &CancelToken,
) -> Result<Measured, BenchError> {
    let one = warm_up(subject, budget, cancel)?;
    let least = if one > budget.seconds { 1 } else { LEAST };
    let steps = ((budget.seconds / one.max(1e-9)) as u32).min(budget.steps).max(least);
    let begin = Instant::now();
    subject.repeat(steps)?;
    let seconds = begin.elapsed().as_secs_f64();
    let mut counts = Vec::from_iter(subject.counts()?);
    let mut profiled = None;
    if let Device::Gpu(gpu) = device
        && gpu.describe().timestamps
    {
        let outcome = profile(gpu, subject, (budget, least), cancel, &mut counts);
        gpu.profile(false);
        profiled = Some(outcome?);
    }
    Ok(Measured { steps, seconds, profiled, counts: middle(counts) })
}

/// Runs the first steps, at least two because the first compiles the kernels. Returns the seconds
/// of the last one.
fn warm_up(
    subject: &mut impl Subject,
    budget: Budget,
    cancel: &CancelToken,
) -> Result<f64, BenchError> {
    let all = Instant::now();
    let mut one = 0.0;
    for step in 0..=WARM_UP {
        cancel.check()?;
        if step > 1 && all.elapsed().as_secs_f64() > budget.seconds {
            break;
        }
        let begin = Instant::now();
        subject.repeat(1)?;
        one = begin.elapsed().as_secs_f64();
    }
    Ok(one)
}

fn profile(
    gpu: &Gpu,
    subject: &mut impl Subject,
    (budget, least): (Budget, u32),
    cancel: &CancelToken,
    counts: &mut Vec<SplatCounts>,
) -> Result<Profiled, BenchError> {
    let begin = Instant::now();
    let (mut walls, mut sums) = (Vec::new(), Vec::new());
    let mut kernels = BTreeMap::<&'static str, Vec<(f64, u64)>>::new();
    let mut steps = 0;
    while steps < least || (steps < budget.steps && begin.elapsed().as_secs_f64() < budget.seconds)
    {
        cancel.check()?;
        gpu.profile(true);
        let step = Instant::now();
        subject.repeat(1)?;
        walls.push(step.elapsed().as_secs_f64());
        let times = gpu.profiled();
        sums.push(times.iter().map(|(_, time)| time.total.as_secs_f64()).sum());
        for (name, time) in times {
            kernels.entry(name).or_default().push((time.total.as_secs_f64(), time.dispatches));
        }
        gpu.profile(false);
        counts.extend(subject.counts()?);
        steps += 1;
    }
    Ok(Profiled { steps, wall: median(walls), kernels: median(sums), rows: rows(kernels, steps) })
}

/// The medians of every kernel, the slowest first. A kernel that does not run in a step counts as 0
/// for that step.
fn rows(
    kernels: BTreeMap<&'static str, Vec<(f64, u64)>>,
    steps: u32,
) -> Vec<(&'static str, f64, u64)> {
    let mut rows: Vec<_> = kernels
        .into_iter()
        .map(|(name, mut times)| {
            times.resize(times.len().max(steps as usize), (0.0, 0));
            let dispatches = median(times.iter().map(|time| time.1 as f64).collect());
            (name, median(times.into_iter().map(|time| time.0).collect()), dispatches as u64)
        })
        .collect();
    rows.sort_by(|a, b| b.1.total_cmp(&a.1));
    rows
}

/// The median, the upper one of two; 0 without values.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

fn middle(mut counts: Vec<SplatCounts>) -> Option<SplatCounts> {
    counts.sort_by_key(|one| one.intersections);
    counts.get(counts.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kernel_in_one_step_of_four_has_a_median_of_zero() {
        let kernels = BTreeMap::from([("always", vec![(1.0, 2); 4]), ("once", vec![(9.0, 1)])]);
        assert_eq!(rows(kernels, 4), [("always", 1.0, 2), ("once", 0.0, 0)]);
    }

    #[test]
    fn one_long_step_does_not_move_the_median() {
        assert_eq!(median(vec![1.0, 500.0, 2.0]), 2.0);
        assert_eq!(median(Vec::new()), 0.0);
    }
}
