//! Tests of the rasteriser on the device against the f64 reference, from the device's own
//! projection.

mod edges;
mod times;

use fled_gpu::{AdapterInfo, Gpu};

use super::blending::WIDTH;
use super::order::{ASSIGN_SLOTS, COMPACT_VISIBLE, COUNT_SLOTS, COUNT_VISIBLE, EMIT, TILE_RANGES};
use super::slots::gradient;
use super::*;
use crate::gaussians::Gaussians;
use crate::splat::compare::{gradients_agree, mostly_within};
use crate::splat::fixtures::{self, Random};
use crate::splat::reference::{Blended, Projected, ProjectedGradient, blend, blend_backward};
use crate::splat::rows::DeviceGaussians;
use crate::splat::uniform::{CameraUniform, TILE};

/// The results of one run on the device.
struct Run {
    projected: Vec<Option<Projected>>,
    image: Vec<f32>,
    transmittance: Vec<f32>,
    counts: SplatCounts,
    tile_counts: Vec<u32>,
    spans: Vec<[u32; 2]>,
    rows: Vec<[f32; SLOT_ROW]>,
}

struct Case {
    gaussians: Gaussians,
    width: usize,
    height: usize,
    intersections: usize,
    background: [f32; 3],
    image_gradient: Vec<f32>,
}

impl Case {
    fn new(gaussians: Gaussians, width: usize, height: usize) -> Self {
        let mut random = Random::new(5);
        let image_gradient = (0..3 * width * height).map(|_| random.signed() as f32).collect();
        Self {
            gaussians,
            width,
            height,
            intersections: 40_000,
            background: [0.0; 3],
            image_gradient,
        }
    }

    fn run(&self, specialisation: Specialisation) -> Run {
        let gpu = fixtures::gpu();
        let view = fixtures::viewpoint(self.width, self.height);
        let n = self.gaussians.len();
        let device = DeviceGaussians::upload(gpu, &self.gaussians, n + 700).unwrap();
        let projection = Projection::new(gpu, n + 700).unwrap();
        let degree = self.gaussians.sh_degree;
        let camera = CameraUniform::new(&view.camera, n, degree, degree, view.near as f32)
            .before(self.background);
        projection.camera.write(&[camera]).unwrap();
        let sizes = SplatSizes {
            gaussians: n + 700,
            width: self.width,
            height: self.height,
            intersections: self.intersections,
        };
        let buffers = SplatBuffers::new(gpu, sizes, true).unwrap();
        projection.set_dropped(7).unwrap();
        let image_gradient = gpu.upload("image gradient", &self.image_gradient).unwrap();
        let mut recorder = gpu.recorder();
        projection.record(&mut recorder, &device).unwrap();
        Forward::new(specialisation).record(&mut recorder, &projection, &buffers).unwrap();
        let backward = Backward::new(specialisation);
        backward.record(&mut recorder, &projection, &buffers, &image_gradient).unwrap();
        let recording = recorder.finish();
        // Twice: no result may depend on the leftovers of the previous step.
        recording.submit().unwrap();
        recording.submit().unwrap();
        let tile_counts = projection.tile_counts(n).unwrap();
        Run {
            projected: rows(&projection.projected.read().unwrap(), &tile_counts),
            image: buffers.image.read().unwrap(),
            transmittance: buffers.transmittance.read().unwrap(),
            counts: buffers.counts().unwrap().wait().unwrap(),
            spans: projection.spans.read().unwrap(),
            rows: buffers.slots.read().unwrap(),
            tile_counts,
        }
    }

    fn reference(&self, run: &Run) -> Blended {
        blend(&run.projected, self.width, self.height).before(self.background.map(f64::from))
    }
}

fn rows(projected: &[[f32; 4]], tile_counts: &[u32]) -> Vec<Option<Projected>> {
    let row = |(i, &count): (usize, &u32)| (count > 0).then(|| fixtures::projected(projected, i));
    tile_counts.iter().enumerate().map(row).collect()
}

impl Run {
    /// The summed rows of each Gaussian, as in the projection's backward pass.
    fn gradients(&self) -> Vec<[f64; SLOT_ROW]> {
        let sum = |g: usize| {
            let mut sum = [0.0; SLOT_ROW];
            for k in 0..self.tile_counts[g] as usize {
                let row = &self.rows[self.spans[1 + g][0] as usize + k];
                (0..SLOT_ROW).for_each(|i| sum[i] += f64::from(row[i]));
            }
            self.projected[g]
                .as_ref()
                .map_or([0.0; SLOT_ROW], |p| flat(&gradient(&sum, p.conic, p.opacity)))
        };
        (0..self.tile_counts.len()).map(sum).collect()
    }
}

fn flat(g: &ProjectedGradient) -> [f64; SLOT_ROW] {
    let ([x, y], [a, b, c], [red, green, blue]) = (g.mean, g.conic, g.colour);
    [x, y, a, b, c, red, green, blue, g.opacity]
}

/// All specialisations that this adapter can run.
fn specialisations() -> Vec<Specialisation> {
    let generic = Specialisation { subgroup: None };
    let reducing = Some(chosen()).filter(|chosen| *chosen != generic);
    [generic].into_iter().chain(reducing).collect()
}

#[test]
fn every_adapter_gets_kernels_that_fit_its_subgroups() {
    let chosen = |subgroup| {
        let info = AdapterInfo { subgroup, ..fixtures::gpu().describe().clone() };
        Specialisation::for_adapter(&info).subgroup
    };
    for size in [8, 32, 64] {
        assert_eq!(chosen(Some((size, size))), Some(size));
    }
    // Too narrow, too wide, and of a size that varies from kernel to kernel.
    for subgroup in [(4, 4), (128, 128), (8, 32)] {
        assert_eq!(chosen(Some(subgroup)), None);
    }
    assert_eq!(chosen(None), None);
}

fn chosen() -> Specialisation {
    Specialisation::for_adapter(fixtures::gpu().describe())
}

#[test]
fn image_and_transmittance_match_the_reference_at_odd_sizes() {
    let scene = Case::new(fixtures::gaussians(1500, 1, 3), 141, 93);
    let run = scene.run(chosen());
    assert!(run.counts.visible > 500 && !run.counts.overflowed(), "{:?}", run.counts);
    assert_eq!(run.counts.intersections, run.tile_counts.iter().sum::<u32>() as usize);
    // An image leaves the number of dropped gradients as it is.
    assert_eq!(run.spans[0], [run.counts.intersections as u32, 7]);
    let expected = scene.reference(&run);
    mostly_within(&run.image, &expected.image, 1e-4, 1e-3).unwrap();
    mostly_within(&run.transmittance, &expected.transmittance, 1e-4, 1e-3).unwrap();
}

#[test]
fn gradients_match_the_reference_in_every_column() {
    let scene = Case::new(fixtures::gaussians(1500, 1, 3), 141, 93);
    let run = scene.run(chosen());
    let upstream: Vec<_> = scene.image_gradient.iter().map(|&v| f64::from(v)).collect();
    let expected = blend_backward(&run.projected, &scene.reference(&run), &upstream);
    let (found, expected): (Vec<_>, Vec<_>) =
        (run.gradients(), expected.iter().map(flat).collect());
    for column in 0..SLOT_ROW {
        let of = |rows: &[[f64; SLOT_ROW]]| rows.iter().map(|r| r[column]).collect::<Vec<_>>();
        gradients_agree(&of(&found), &of(&expected))
            .unwrap_or_else(|why| panic!("column {column}: {why}"));
    }
}

#[test]
fn image_and_gradients_over_a_background_match_the_reference() {
    let black = Case::new(fixtures::gaussians(60, 0, 3), 96, 64);
    let scene =
        Case { background: [0.9, 0.2, 0.6], ..Case::new(fixtures::gaussians(60, 0, 3), 96, 64) };
    let run = scene.run(chosen());
    let expected = scene.reference(&run);
    mostly_within(&run.image, &expected.image, 1e-4, 1e-3).unwrap();
    mostly_within(&run.image, &black.reference(&run).image, 1e-2, 0.1)
        .expect_err("it shines through");
    let upstream: Vec<_> = scene.image_gradient.iter().map(|&v| f64::from(v)).collect();
    let expected = blend_backward(&run.projected, &expected, &upstream);
    let opacity =
        |of: &dyn Fn(usize) -> f64| (0..run.tile_counts.len()).map(of).collect::<Vec<_>>();
    let found = run.gradients();
    gradients_agree(&opacity(&|i| found[i][8]), &opacity(&|i| expected[i].opacity)).unwrap();
}

#[test]
fn all_specialisations_agree() {
    let scene = Case::new(fixtures::gaussians(600, 0, 11), 77, 50);
    let first = scene.run(chosen());
    let image: Vec<_> = first.image.iter().map(|&v| f64::from(v)).collect();
    let gradients = first.gradients();
    let largest = gradients.iter().flatten().fold(0.0_f64, |a, &v| a.max(v.abs()));
    for specialisation in specialisations() {
        let run = scene.run(specialisation);
        mostly_within(&run.image, &image, 1e-5, 0.0)
            .unwrap_or_else(|why| panic!("{specialisation:?}: {why}"));
        let found: Vec<_> =
            run.gradients().iter().flatten().map(|&v| (v / largest) as f32).collect();
        let expected: Vec<_> = gradients.iter().flatten().map(|&v| v / largest).collect();
        mostly_within(&found, &expected, 1e-5, 0.0)
            .unwrap_or_else(|why| panic!("{specialisation:?}: {why}"));
    }
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let scene = Case::new(fixtures::gaussians(900, 1, 7), 96, 64);
    let (a, b) = (scene.run(chosen()), scene.run(chosen()));
    let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let used = a.counts.intersections;
    assert!(bits(&a.image) == bits(&b.image));
    assert!(bits(a.rows[..used].as_flattened()) == bits(b.rows[..used].as_flattened()));
    assert!(
        bits(&a.image)
            != bits(&Case::new(fixtures::gaussians(900, 1, 8), 96, 64).run(chosen()).image)
    );
}

#[test]
fn an_image_takes_at_most_six_passes_of_sorting() {
    let gpu = Gpu::new("auto").unwrap();
    assert!(gpu.describe().timestamps, "the adapter counts no dispatches");
    // The last image has 2^16 - 1 tiles, as many as fit keys of 16 bits with one past the last.
    for (width, height, passes) in [(96, 64, 5), (1120, 640, 6), (1, 16 * 65_535, 6)] {
        let projection = Projection::new(&gpu, 8).unwrap();
        let sizes = SplatSizes { gaussians: 8, width, height, intersections: 64 };
        let buffers = SplatBuffers::new(&gpu, sizes, false).unwrap();
        let mut recorder = gpu.recorder();
        Forward::new(chosen()).record(&mut recorder, &projection, &buffers).unwrap();
        gpu.profile(true);
        recorder.submit().unwrap();
        let times = gpu.profiled();
        let scatters = times.iter().find(|(name, _)| *name == "sort/radix_scatter").unwrap();
        assert_eq!(scatters.1.dispatches, passes, "{width}x{height}");
    }
}

#[test]
fn every_row_of_the_kernel_table_agrees_with_its_shader() {
    let rows = [COUNT_VISIBLE, COMPACT_VISIBLE, COUNT_SLOTS, ASSIGN_SLOTS, EMIT, TILE_RANGES];
    for kernel in rows {
        kernel.reflect().unwrap();
    }
    for specialisation in specialisations() {
        specialisation.forward().reflect().unwrap();
        let (_, found) = specialisation.backward().reflect().unwrap();
        assert_eq!(found.constant("SUMS"), Some(SLOT_ROW as f64));
        assert_eq!(found.workgroup, [WIDTH, 1, 1]);
        assert_eq!(found.constant("TILE"), Some(f64::from(TILE)));
    }
}
