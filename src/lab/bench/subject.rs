//! The subjects of a benchmark: repeatable work.

use fled_gpu::{Buffer, Gpu, GpuError, Recording};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::error::BenchError;
use super::workload::Workload;
use fled_core::cancel::CancelToken;
use fled_core::device::Device;
use fled_core::image::Image;
use fled_core::reconstruct::Stepper;
use fled_core::reconstruct::loss::{GpuTarget, Loss, Noise};
use fled_core::render::{Renderer, UploadedGaussians};
use fled_core::splat::rasterize::SplatCounts;
use fled_core::splat::sort::{Counters, FIXED, RadixSort, SCAN, SortParameters};

/// Bits of the keys in the benchmark of sorting, as for depths.
const KEY_BITS: u32 = 32;

/// Work that can be repeated.
pub(super) trait Subject {
    /// Runs it `times` times and waits for the last.
    fn repeat(&mut self, times: u32) -> Result<(), BenchError>;

    /// Counts of the splats blended by the last run, if it blended any.
    fn counts(&self) -> Result<Option<SplatCounts>, BenchError> {
        Ok(None)
    }
}

/// Steps of training.
pub(super) struct Training<'a> {
    pub(super) stepper: Stepper<'a>,
    pub(super) cancel: &'a CancelToken,
}

impl Subject for Training<'_> {
    fn repeat(&mut self, times: u32) -> Result<(), BenchError> {
        Ok(self.stepper.advance(times, self.cancel)?)
    }

    fn counts(&self) -> Result<Option<SplatCounts>, BenchError> {
        Ok(Some(self.stepper.counts()?))
    }
}

/// Images of a scene, including the read-back.
pub(super) struct Rendering<'a> {
    renderer: Renderer,
    scene: UploadedGaussians,
    workload: &'a Workload,
}

impl<'a> Rendering<'a> {
    pub(super) fn new(device: &Device, workload: &'a Workload) -> Result<Self, BenchError> {
        let renderer = Renderer::new(device);
        let scene = renderer.upload(&workload.gaussians)?;
        Ok(Self { renderer, scene, workload })
    }
}

impl Subject for Rendering<'_> {
    fn repeat(&mut self, times: u32) -> Result<(), BenchError> {
        for _ in 0..times {
            self.renderer.render_scene(&self.scene, &self.workload.camera()?)?;
        }
        Ok(())
    }

    fn counts(&self) -> Result<Option<SplatCounts>, BenchError> {
        Ok(Some(self.scene.counts()?))
    }
}

/// The loss and its gradient.
pub(super) struct Similarity {
    gpu: Gpu,
    recording: Recording,
}

impl Similarity {
    pub(super) fn new(gpu: &Gpu, (width, height): (usize, usize)) -> Result<Self, BenchError> {
        let mut image = Image::new(width, height);
        for (value, i) in image.data_mut().iter_mut().zip(0_u32..) {
            *value = (i.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32;
        }
        let prediction = gpu.upload("prediction", image.data())?;
        let gradient = gpu.create("image gradient", prediction.len())?;
        let mut recorder = gpu.recorder();
        let loss = Loss::new(gpu, width, height)?;
        let target = GpuTarget::upload(gpu, &image, &Noise::NONE)?;
        loss.record(&mut recorder, &prediction, &target, &gradient)?;
        Ok(Self { gpu: gpu.clone(), recording: recorder.finish() })
    }
}

impl Subject for Similarity {
    fn repeat(&mut self, times: u32) -> Result<(), BenchError> {
        again(&self.gpu, &self.recording, times)
    }
}

/// The radix sort of random keys.
pub(super) struct Sorting {
    gpu: Gpu,
    recording: Recording,
}

impl Sorting {
    pub(super) fn new(gpu: &Gpu, keys: usize, seed: u64) -> Result<Self, BenchError> {
        let counters = Counters::new(gpu, 1)?;
        let sort = RadixSort::new(gpu, keys, KEY_BITS, 0)?;
        count(gpu, &counters, keys)?;
        let mut random = Pcg64::seed_from_u64(seed);
        let unsorted: Vec<u32> = (0..keys).map(|_| random.random()).collect();
        let unsorted: Buffer<u32> = gpu.upload("unsorted keys", &unsorted)?;
        let mut recorder = gpu.recorder();
        // The same keys each time: sorted keys would have another access pattern.
        recorder.copy(&unsorted, sort.keys(), keys)?;
        sort.record(&mut recorder, &counters)?;
        Ok(Self { gpu: gpu.clone(), recording: recorder.finish() })
    }
}

impl Subject for Sorting {
    fn repeat(&mut self, times: u32) -> Result<(), BenchError> {
        again(&self.gpu, &self.recording, times)
    }
}

/// Writes the number of keys to the sort's counter.
fn count(gpu: &Gpu, counters: &Counters, keys: usize) -> Result<(), GpuError> {
    let total = gpu.upload("total", &[keys as u32])?;
    let row = SortParameters {
        shift: 0,
        source: FIXED,
        capacity: 1,
        result: 0,
        result_capacity: keys as u32,
    };
    let row = gpu.upload("parameters", &[row])?;
    let mut recorder = gpu.recorder();
    recorder.dispatch(&SCAN, &[&row, &counters.values, &total, &counters.arguments], [1, 1, 1])?;
    recorder.submit().map(|_| ())
}

fn again(gpu: &Gpu, recording: &Recording, times: u32) -> Result<(), BenchError> {
    for _ in 0..times {
        recording.submit()?;
    }
    Ok(gpu.wait()?)
}
