//! Benchmarks of fled on a device: training and rendering of scenes that are the same on every
//! machine, the two most expensive parts of a step on their own, and every kernel by the device's
//! clock.
//!
//! A case runs the product's own code, not a copy: training is [`Stepper`], the loop of
//! [`train`](fled_core::reconstruct::train); rendering is
//! [`Renderer`](fled_core::render::Renderer). Steps per second are measured without timestamps;
//! additional steps then have a timestamp around every dispatch. Two small kernels measure the
//! device's limits during the same minutes, so that a kernel's time relative to theirs is
//! comparable even on a shared machine.

mod error;
mod measure;
mod options;
pub mod report;
mod roofline;
mod subject;
mod table;
mod workload;

use fled_gpu::Gpu;

pub use error::BenchError;
use fled_core::cancel::CancelToken;
use fled_core::device::Device;
use fled_core::noise::NoiseMode;
use fled_core::reconstruct::{Background, Densify, Pace, Response, Stepper, TrainConfig};
pub use options::{BenchOptions, Budget, MOST_STEPS};
use report::{Case, Machine, Report};
use subject::{Rendering, Similarity, Sorting, Subject, Training};
pub use workload::Workload;

/// Number of steps in the round that the measured steps belong to, and the first measured step. In
/// the middle of a round all harmonics are active and the noise field has an effect; relocation and
/// the estimate of the shake precede the first step and every hundredth step after it.
const ROUND: u32 = 10_000;
const FIRST: u32 = ROUND / 2;

/// Receives the number of finished cases, the number of all cases, and the name of the next.
pub type Progress<'a> = &'a mut dyn FnMut(usize, usize, &str);

/// The models of a step, apart from the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extras {
    noise: NoiseMode,
    shake: bool,
}

impl Extras {
    /// None, those of the presets `preview` and `standard`, and those of `paper`.
    const ALL: [Self; 3] = [
        Self { noise: NoiseMode::Off, shake: false },
        Self { noise: NoiseMode::Off, shake: true },
        Self { noise: NoiseMode::Paper, shake: false },
    ];

    fn name(self) -> String {
        let noise = match self.noise {
            NoiseMode::Off => "off",
            NoiseMode::Paper => "paper",
        };
        format!("noise {noise}{}", if self.shake { " and shake" } else { "" })
    }
}

/// One case.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Plan {
    Train { size: (usize, usize), gaussians: usize, extras: Extras },
    Render { size: (usize, usize), gaussians: usize },
    Ssim { size: (usize, usize) },
    Sort { keys: usize },
}

impl Plan {
    /// Every case of the options on a device. The costs of noise field, shake and SSIM depend on
    /// the pixels, so the extras run only with the first number of Gaussians.
    fn all(options: &BenchOptions, device: &Device) -> Vec<Self> {
        let has_kernels = matches!(device, Device::Gpu(_));
        let mut plans = Vec::new();
        for &size in &options.sizes {
            for &gaussians in &options.gaussians {
                plans.push(Self::Train { size, gaussians, extras: Extras::ALL[0] });
                plans.push(Self::Render { size, gaussians });
            }
            if let Some(&gaussians) = options.gaussians.first() {
                plans.extend(Extras::ALL[1..].iter().map(|&extras| Self::Train {
                    size,
                    gaussians,
                    extras,
                }));
            }
            plans.extend(has_kernels.then_some(Self::Ssim { size }));
        }
        let sorted = options.gaussians.iter().filter(|_| has_kernels);
        plans.extend(sorted.map(|&keys| Self::Sort { keys }));
        plans
    }

    fn name(&self) -> String {
        match *self {
            Self::Train { size: (w, h), gaussians, extras } => {
                format!("train {w}x{h}, {} Gaussians, {}", short(gaussians), extras.name())
            }
            Self::Render { size: (w, h), gaussians } => {
                format!("render {w}x{h}, {} Gaussians", short(gaussians))
            }
            Self::Ssim { size: (w, h) } => format!("ssim {w}x{h}"),
            Self::Sort { keys } => format!("sort {} keys", short(keys)),
        }
    }

    fn measure(&self, bench: &Bench<'_>) -> Result<Case, BenchError> {
        let name = self.name();
        match *self {
            Self::Train { size, gaussians, extras } => {
                let mut workload =
                    Workload::synthetic(bench.device, size, gaussians, bench.options.seed)?;
                if extras.shake {
                    workload.shake();
                }
                bench.train(name, &workload, extras)
            }
            Self::Render { size, gaussians } => {
                let workload =
                    Workload::synthetic(bench.device, size, gaussians, bench.options.seed)?;
                bench.render(name, &workload)
            }
            Self::Ssim { size } => bench.case(name, "ssim", || Similarity::new(bench.gpu()?, size)),
            Self::Sort { keys } => {
                bench.case(name, "sort", || Sorting::new(bench.gpu()?, keys, bench.options.seed))
            }
        }
    }
}

/// The context of all cases.
struct Bench<'a> {
    device: &'a Device,
    options: &'a BenchOptions,
    cancel: &'a CancelToken,
}

impl Bench<'_> {
    fn gpu(&self) -> Result<&Gpu, BenchError> {
        match self.device {
            Device::Gpu(gpu) => Ok(gpu),
            Device::Processor => Err(BenchError::Empty("GPU")),
        }
    }

    fn train(&self, name: String, workload: &Workload, extras: Extras) -> Result<Case, BenchError> {
        let config = config(workload, extras);
        let gaussians = workload.gaussians.clone();
        let case = self.case(name, "train", || {
            let stepper = Stepper::new(self.device, &workload.views, gaussians, &config, FIRST)?;
            let cancel = self.cancel;
            Ok(Training { stepper, cancel })
        })?;
        Ok(Case { noise: Some(extras.noise), shake: Some(extras.shake), ..case })
    }

    fn render(&self, name: String, workload: &Workload) -> Result<Case, BenchError> {
        self.case(name, "render", || Rendering::new(self.device, workload))
    }

    /// Measures the subject that `make` creates; its buffers are the case's memory.
    fn case<S: Subject>(
        &self,
        name: String,
        task: &'static str,
        make: impl FnOnce() -> Result<S, BenchError>,
    ) -> Result<Case, BenchError> {
        let mut before = None;
        if let Device::Gpu(gpu) = self.device {
            gpu.wait()?;
            before = Some(gpu.memory().now);
            gpu.forget_peak();
        }
        let mut subject = make()?;
        let (budget, cancel) = (self.options.budget, self.cancel);
        let measured = measure::measure(self.device, &mut subject, budget, cancel)?;
        let peak = self.device.peak_bytes().zip(before).map(|(peak, before)| peak - before);
        Ok(Case::new(name, task, &measured, peak))
    }
}

/// Training as in the middle of a round of the paper's length, with the maximum number of
/// Gaussians.
fn config(workload: &Workload, extras: Extras) -> TrainConfig {
    TrainConfig {
        steps: ROUND,
        refine_poses: None,
        shake: extras.shake.then(Response::srgb),
        cap: workload.gaussians.len(),
        sh_degree: workload.gaussians.sh_degree,
        noise: extras.noise,
        resolution_schedule: false,
        pace: Pace::Adapted,
        warm: true,
        background: Background::Black,
        densify: Densify::Mcmc,
        seed: 0,
        extent: workload.extent,
    }
}

/// Measures all cases of `options` on synthetic scenes. Profiling and counting of memory cover the
/// whole device, so no other work may use it meanwhile.
///
/// # Errors
/// [`BenchError`].
pub fn run(
    device: &Device,
    options: &BenchOptions,
    progress: Progress<'_>,
    cancel: &CancelToken,
) -> Result<Report, BenchError> {
    if options.sizes.is_empty() {
        return Err(BenchError::Empty("size"));
    }
    if options.gaussians.is_empty() {
        return Err(BenchError::Empty("number of Gaussians"));
    }
    if options.budget.steps > MOST_STEPS {
        return Err(BenchError::Steps(options.budget.steps));
    }
    let bench = Bench { device, options, cancel };
    let plans = Plan::all(options, device);
    let mut report = Report::new(Machine::of(device), options);
    report.roofline.add(roofline::measure(device)?);
    for (done, plan) in plans.iter().enumerate() {
        cancel.check()?;
        progress(done, plans.len(), &plan.name());
        report.cases.push(plan.measure(&bench)?);
    }
    report.roofline.add(roofline::measure(device)?);
    report.relate();
    Ok(report)
}

/// Adds the cases of a real scene, that of a finished run: training with and without extras, and
/// rendering.
///
/// # Errors
/// [`BenchError`], in particular when `workload` has no views.
pub fn run_scene(
    device: &Device,
    workload: &Workload,
    report: &mut Report,
    progress: Progress<'_>,
    cancel: &CancelToken,
) -> Result<(), BenchError> {
    let options = report.options.clone();
    let bench = Bench { device, options: &options, cancel };
    let total = Extras::ALL.len() + 1;
    for (done, extras) in Extras::ALL.into_iter().enumerate() {
        cancel.check()?;
        let name = format!("train {}, {}", workload.name, extras.name());
        progress(done, total, &name);
        report.cases.push(bench.train(name, workload, extras)?);
    }
    let name = format!("render {}", workload.name);
    progress(total - 1, total, &name);
    report.cases.push(bench.render(name, workload)?);
    report.roofline.add(roofline::measure(device)?);
    report.relate();
    Ok(())
}

/// `10k` for 10,000.
fn short(count: usize) -> String {
    if count >= 1000 && count.is_multiple_of(1000) {
        format!("{}k", count / 1000)
    } else {
        count.to_string()
    }
}

#[cfg(test)]
mod tests;
