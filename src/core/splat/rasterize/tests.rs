//! The rasteriser on the device against the f64 reference, from the device's own projection.

use super::slots::gradient;
use super::*;
use crate::gaussians::Gaussians;
use crate::splat::compare::{gradients_agree, mostly_within};
use crate::splat::fixtures::{self, Random};
use crate::splat::project::DeviceGaussians;
use crate::splat::reference::{Blended, Projected, ProjectedGradient, blend, blend_backward};
use crate::splat::uniform::CameraUniform;

/// What one run left on the device.
struct Run {
    projected: Vec<Option<Projected>>,
    image: Vec<f32>,
    transmittance: Vec<f32>,
    counts: SplatCounts,
    tile_counts: Vec<u32>,
    slot_offsets: Vec<u32>,
    rows: Vec<[f32; SLOT_ROW]>,
}

struct Scene {
    gaussians: Gaussians,
    width: usize,
    height: usize,
    intersections: usize,
    background: [f32; 3],
    image_gradient: Vec<f32>,
}

impl Scene {
    fn new(gaussians: Gaussians, width: usize, height: usize) -> Self {
        let mut random = Random::new(5);
        let image_gradient = (0..3 * width * height)
            .map(|_| random.signed() as f32)
            .collect();
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
        let image_gradient = gpu.upload("image gradient", &self.image_gradient).unwrap();
        let mut recorder = gpu.recorder();
        projection.record(&mut recorder, &device).unwrap();
        Forward::new(specialisation)
            .record(&mut recorder, &projection, &buffers)
            .unwrap();
        let backward = Backward::new(specialisation);
        backward
            .record(&mut recorder, &projection, &buffers, &image_gradient)
            .unwrap();
        let recording = recorder.finish();
        // Twice: nothing may depend on what the last step left behind.
        recording.submit().unwrap();
        recording.submit().unwrap();
        let tile_counts = projection
            .tile_counts
            .start_read(n)
            .unwrap()
            .wait()
            .unwrap();
        Run {
            projected: rows(&projection.projected.read().unwrap(), &tile_counts),
            image: buffers.image.read().unwrap(),
            transmittance: buffers.transmittance.read().unwrap(),
            counts: buffers.counts().unwrap().wait().unwrap(),
            slot_offsets: buffers.slot_offsets.read().unwrap(),
            rows: buffers.slots.read().unwrap(),
            tile_counts,
        }
    }

    fn reference(&self, run: &Run) -> Blended {
        blend(&run.projected, self.width, self.height).before(self.background.map(f64::from))
    }
}

fn rows(projected: &[[f32; 4]], tile_counts: &[u32]) -> Vec<Option<Projected>> {
    let row = |(i, &count): (usize, &u32)| {
        let r = projected[3 * i..3 * i + 3].as_flattened();
        let v = |k: usize| f64::from(r[k]);
        (count > 0).then(|| Projected {
            mean: [v(0), v(1)],
            conic: [v(2), v(3), v(4)],
            opacity: v(5),
            colour: [v(6), v(7), v(8)],
            depth: v(9),
            extent: [v(10), v(11)],
        })
    };
    tile_counts.iter().enumerate().map(row).collect()
}

impl Run {
    /// A Gaussian's rows summed, as the projection's backward does.
    fn gradients(&self) -> Vec<[f64; SLOT_ROW]> {
        let sum = |g: usize| {
            let mut sum = [0.0; SLOT_ROW];
            for k in 0..self.tile_counts[g] as usize {
                let row = &self.rows[self.slot_offsets[g] as usize + k];
                (0..SLOT_ROW).for_each(|i| sum[i] += f64::from(row[i]));
            }
            self.projected[g].as_ref().map_or([0.0; SLOT_ROW], |p| {
                flat(&gradient(&sum, p.conic, p.opacity))
            })
        };
        (0..self.tile_counts.len()).map(sum).collect()
    }
}

fn flat(g: &ProjectedGradient) -> [f64; SLOT_ROW] {
    let ([x, y], [a, b, c], [red, green, blue]) = (g.mean, g.conic, g.colour);
    [x, y, a, b, c, red, green, blue, g.opacity]
}

/// All that this adapter can run.
fn specialisations() -> Vec<Specialisation> {
    let subgroup = Specialisation::for_adapter(fixtures::gpu().describe()).subgroup;
    let plain = |subgroup: Option<u32>| {
        let fits = move |pixels: &u32| subgroup.is_none_or(|size| size <= TILE * TILE / pixels);
        [4, 8, 16]
            .into_iter()
            .filter(fits)
            .map(move |pixels| Specialisation {
                pixels,
                subgroup,
                walks: false,
            })
    };
    let mut all: Vec<_> = plain(None).collect();
    if let Some(size) = subgroup {
        all.extend(plain(subgroup));
        let walks = Specialisation {
            pixels: HALF_TILE / size,
            subgroup,
            walks: true,
        };
        all.extend((walks.pixels >= 4).then_some(walks));
    }
    all
}

#[test]
fn every_kind_of_adapter_gets_kernels_that_fit_its_subgroups() {
    let chosen = |device_type, subgroup| {
        let info = AdapterInfo {
            device_type,
            subgroup,
            ..fixtures::gpu().describe().clone()
        };
        let Specialisation {
            pixels,
            subgroup,
            walks,
        } = Specialisation::for_adapter(&info);
        (pixels, subgroup, walks)
    };
    let (cpu, card) = (DeviceType::Cpu, DeviceType::Discrete);
    assert_eq!(chosen(cpu, Some((8, 8))), (16, Some(8), true));
    assert_eq!(chosen(cpu, Some((16, 16))), (8, Some(16), true));
    // Without wide vectors, and without subgroups.
    assert_eq!(chosen(cpu, Some((4, 4))), (16, None, false));
    assert_eq!(chosen(cpu, None), (16, None, false));
    assert_eq!(chosen(card, Some((32, 32))), (4, Some(32), false));
    assert_eq!(chosen(card, Some((64, 64))), (4, Some(64), false));
    // Sizes that vary from kernel to kernel.
    assert_eq!(chosen(card, Some((8, 32))), (4, None, false));
}

fn chosen() -> Specialisation {
    Specialisation::for_adapter(fixtures::gpu().describe())
}

#[test]
fn image_and_transmittance_equal_the_reference_at_a_size_that_is_no_multiple_of_a_tile() {
    let scene = Scene::new(fixtures::gaussians(1500, 1, 3), 141, 93);
    let run = scene.run(chosen());
    assert!(
        run.counts.visible > 500 && !run.counts.overflowed(),
        "{:?}",
        run.counts
    );
    assert_eq!(
        run.counts.intersections,
        run.tile_counts.iter().sum::<u32>() as usize
    );
    let expected = scene.reference(&run);
    mostly_within(&run.image, &expected.image, 1e-4, 1e-3).unwrap();
    mostly_within(&run.transmittance, &expected.transmittance, 1e-4, 1e-3).unwrap();
}

#[test]
fn gradients_equal_the_reference_in_every_column() {
    let scene = Scene::new(fixtures::gaussians(1500, 1, 3), 141, 93);
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
fn before_a_background_image_and_gradients_equal_the_reference() {
    let black = Scene::new(fixtures::gaussians(60, 0, 3), 96, 64);
    let scene = Scene {
        background: [0.9, 0.2, 0.6],
        ..Scene::new(fixtures::gaussians(60, 0, 3), 96, 64)
    };
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
    gradients_agree(
        &opacity(&|i| found[i][8]),
        &opacity(&|i| expected[i].opacity),
    )
    .unwrap();
}

#[test]
fn all_specialisations_agree() {
    let scene = Scene::new(fixtures::gaussians(600, 0, 11), 77, 50);
    let first = scene.run(chosen());
    let image: Vec<_> = first.image.iter().map(|&v| f64::from(v)).collect();
    let gradients = first.gradients();
    let largest = gradients
        .iter()
        .flatten()
        .fold(0.0_f64, |a, &v| a.max(v.abs()));
    for specialisation in specialisations() {
        let run = scene.run(specialisation);
        mostly_within(&run.image, &image, 1e-5, 0.0)
            .unwrap_or_else(|why| panic!("{specialisation:?}: {why}"));
        let found: Vec<_> = run
            .gradients()
            .iter()
            .flatten()
            .map(|&v| (v / largest) as f32)
            .collect();
        let expected: Vec<_> = gradients.iter().flatten().map(|&v| v / largest).collect();
        mostly_within(&found, &expected, 1e-5, 0.0)
            .unwrap_or_else(|why| panic!("{specialisation:?}: {why}"));
    }
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let scene = Scene::new(fixtures::gaussians(900, 1, 7), 96, 64);
    let (a, b) = (scene.run(chosen()), scene.run(chosen()));
    let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let used = a.counts.intersections;
    assert!(bits(&a.image) == bits(&b.image));
    assert!(bits(a.rows[..used].as_flattened()) == bits(b.rows[..used].as_flattened()));
    assert!(
        bits(&a.image)
            != bits(
                &Scene::new(fixtures::gaussians(900, 1, 8), 96, 64)
                    .run(chosen())
                    .image
            )
    );
}

#[test]
fn nothing_visible_gives_black_and_full_transmittance() {
    let mut gaussians = fixtures::gaussians(40, 0, 3);
    gaussians.means.fill([0.0, 0.0, -60.0]);
    let run = Scene::new(gaussians, 64, 48).run(chosen());
    assert_eq!((run.counts.visible, run.counts.intersections), (0, 0));
    assert!(run.image.iter().all(|&v| v == 0.0) && run.transmittance.iter().all(|&v| v == 1.0));
    let empty = Scene::new(Gaussians::default(), 64, 48).run(chosen());
    assert!(empty.transmittance.iter().all(|&v| v == 1.0));
}

#[test]
fn a_splat_over_all_tiles_covers_the_image() {
    let mut gaussians = fixtures::gaussians(3, 0, 3);
    gaussians.means.fill([0.0; 3]);
    gaussians.log_scales.fill([2.5; 3]);
    gaussians.opacity_logits = vec![0.0, 9.0, 9.0];
    let scene = Scene::new(gaussians, 90, 70);
    let run = scene.run(chosen());
    assert_eq!(run.tile_counts, [30; 3]);
    let expected = scene.reference(&run);
    mostly_within(&run.image, &expected.image, 1e-4, 1e-3).unwrap();
    assert!(run.transmittance.iter().all(|&t| t < 0.6));
}

#[test]
fn a_camera_inside_a_splat_sees_it_and_those_at_and_behind_its_centre_are_left_out() {
    let mut gaussians = fixtures::gaussians(60, 0, 3);
    let camera = fixtures::viewpoint(90, 70).camera;
    let at = |depth: f64| {
        (camera.centre() + depth * camera.forward())
            .to_array()
            .map(|x| x as f32)
    };
    gaussians.means[..3].copy_from_slice(&[at(0.15), at(0.0), at(-0.5)]);
    gaussians.log_scales[..3].fill([0.0; 3]);
    gaussians.opacity_logits[..3].fill(0.0);
    let scene = Scene::new(gaussians, 90, 70);
    let run = scene.run(chosen());
    assert_eq!(run.tile_counts[..3], [30, 0, 0]);
    let expected = scene.reference(&run);
    mostly_within(&run.image, &expected.image, 1e-4, 1e-3).unwrap();
    assert!(run.transmittance.iter().all(|&t| t < 0.7));
    let upstream: Vec<_> = scene.image_gradient.iter().map(|&v| f64::from(v)).collect();
    let by_splat = blend_backward(&run.projected, &expected, &upstream);
    let (found, expected) = (run.gradients()[0], flat(&by_splat[0]));
    gradients_agree(&found, &expected).unwrap();
}

#[test]
fn an_overflow_is_counted_exactly_and_enough_room_repairs_it() {
    let mut scene = Scene::new(fixtures::gaussians(500, 0, 9), 96, 64);
    let enough = scene.run(chosen());
    scene.intersections = 300;
    let short = scene.run(chosen());
    assert!(short.counts.overflowed() && short.counts.intersections == enough.counts.intersections);
    assert_eq!(short.counts.capacity, 300);
    scene.intersections = enough.counts.intersections;
    let exact = scene.run(chosen());
    assert!(!exact.counts.overflowed() && exact.image == enough.image);
}

#[test]
fn every_row_of_the_kernel_table_agrees_with_its_shader() {
    let rows = [
        COUNT_VISIBLE,
        COMPACT_VISIBLE,
        COUNT_SLOTS,
        ASSIGN_SLOTS,
        EMIT,
        TILE_RANGES,
    ];
    for kernel in rows {
        kernel.reflect().unwrap();
    }
    for specialisation in specialisations() {
        specialisation.forward().reflect().unwrap();
        let (_, found) = specialisation.backward().reflect().unwrap();
        if !specialisation.walks {
            assert_eq!(found.constant("SUMS"), Some(SLOT_ROW as f64));
        }
        assert_eq!(found.constant("TILE"), Some(f64::from(TILE)));
    }
}

/// Prints times. Run with `cargo test --release -p fled-core blending_times -- --ignored
/// --nocapture`.
#[test]
#[ignore = "a measurement"]
fn blending_times() {
    let gpu = fixtures::gpu();
    let on_cpu = gpu.describe().device_type == DeviceType::Cpu;
    let (width, height, n) = if on_cpu {
        (280, 160, 10_000)
    } else {
        (1120, 640, 200_000)
    };
    let mut gaussians = fixtures::gaussians(n, 0, 3);
    gaussians
        .log_scales
        .iter_mut()
        .flatten()
        .for_each(|s| *s -= 0.55);
    let view = fixtures::viewpoint(width, height);
    let device = DeviceGaussians::upload(gpu, &gaussians, n).unwrap();
    let projection = Projection::new(gpu, n).unwrap();
    projection
        .camera
        .write(&[CameraUniform::new(&view.camera, n, 0, 0, 0.1)])
        .unwrap();
    let sizes = SplatSizes {
        gaussians: n,
        width,
        height,
        intersections: 20 * n,
    };
    let buffers = SplatBuffers::new(gpu, sizes, true).unwrap();
    let gradient = gpu
        .upload("image gradient", &vec![0.5_f32; 3 * width * height])
        .unwrap();
    for specialisation in specialisations() {
        let mut recorder = gpu.recorder();
        projection.record(&mut recorder, &device).unwrap();
        Forward::new(specialisation)
            .record(&mut recorder, &projection, &buffers)
            .unwrap();
        let backward = Backward::new(specialisation);
        backward
            .record(&mut recorder, &projection, &buffers, &gradient)
            .unwrap();
        let recording = recorder.finish();
        recording.submit().unwrap();
        gpu.wait().unwrap();
        let mut best = f64::INFINITY;
        for _ in 0..20 {
            let start = std::time::Instant::now();
            recording.submit().unwrap();
            gpu.wait().unwrap();
            best = best.min(start.elapsed().as_secs_f64());
        }
        gpu.profile(true);
        (0..20).for_each(|_| recording.submit().map(|_| ()).unwrap());
        eprintln!(
            "{specialisation:?}: {:.1} ms, {:?}",
            best * 1e3,
            buffers.counts().unwrap().wait()
        );
        for (name, time) in gpu.profiled() {
            let per_step = time.shortest.as_secs_f64() * 1e3 * time.dispatches as f64 / 20.0;
            eprintln!("  {name}: {per_step:.2} ms a step");
        }
        gpu.profile(false);
    }
}

#[test]
fn a_tile_counted_but_not_emitted_changes_no_pixel_and_has_zero_gradients() {
    let gpu = fixtures::gpu();
    let gaussians = fixtures::gaussians(400, 0, 3);
    let (n, width, height) = (gaussians.len(), 96, 64);
    let device = DeviceGaussians::upload(gpu, &gaussians, n).unwrap();
    let projection = Projection::new(gpu, n).unwrap();
    let view = fixtures::viewpoint(width, height);
    projection
        .camera
        .write(&[CameraUniform::new(&view.camera, n, 0, 0, 0.1)])
        .unwrap();
    let sizes = SplatSizes {
        gaussians: n,
        width,
        height,
        intersections: 20_000,
    };
    let buffers = SplatBuffers::new(gpu, sizes, true).unwrap();
    // Rows that nobody writes keep this.
    buffers.slots.write(&vec![[7.0; SLOT_ROW]; 20_000]).unwrap();
    let gradient = gpu
        .upload("image gradient", &vec![1.0_f32; 3 * width * height])
        .unwrap();
    let mut recorder = gpu.recorder();
    projection.record(&mut recorder, &device).unwrap();
    recorder.submit().unwrap();
    let mut recorder = gpu.recorder();
    Forward::new(chosen())
        .record(&mut recorder, &projection, &buffers)
        .unwrap();
    Backward::new(chosen())
        .record(&mut recorder, &projection, &buffers, &gradient)
        .unwrap();
    let recording = recorder.finish();
    recording.submit().unwrap();
    let image = buffers.image.read().unwrap();
    let mut counts = projection.tile_counts.read().unwrap();
    let changed = (0..n).find(|&g| counts[g] > 0).unwrap();
    counts[changed] += 1;
    projection.tile_counts.write(&counts).unwrap();
    recording.submit().unwrap();
    assert!(buffers.image.read().unwrap() == image);
    let slot = (buffers.slot_offsets.read().unwrap()[changed] + counts[changed] - 1) as usize;
    let rows = buffers.slots.read().unwrap();
    assert_eq!(rows[slot], [0.0; SLOT_ROW]);
}

#[test]
fn a_camera_larger_than_the_buffers_draws_nothing() {
    let gpu = fixtures::gpu();
    let gaussians = fixtures::gaussians(200, 0, 3);
    let device = DeviceGaussians::upload(gpu, &gaussians, 200).unwrap();
    let projection = Projection::new(gpu, 200).unwrap();
    let sizes = SplatSizes {
        gaussians: 200,
        width: 64,
        height: 48,
        intersections: 20_000,
    };
    let buffers = SplatBuffers::new(gpu, sizes, true).unwrap();
    let mut recorder = gpu.recorder();
    projection.record(&mut recorder, &device).unwrap();
    Forward::new(chosen())
        .record(&mut recorder, &projection, &buffers)
        .unwrap();
    let gradient = gpu.create::<f32>("image gradient", 3 * 64 * 48).unwrap();
    Backward::new(chosen())
        .record(&mut recorder, &projection, &buffers, &gradient)
        .unwrap();
    let recording = recorder.finish();
    let draw = |width, height| {
        let camera = fixtures::viewpoint(width, height).camera;
        projection
            .camera
            .write(&[CameraUniform::new(&camera, 200, 0, 0, 0.1)])
            .unwrap();
        recording.submit().unwrap();
        buffers.image.read().unwrap()
    };
    assert!(draw(640, 480).iter().all(|&v| v == 0.0));
    assert!(draw(64, 48).iter().any(|&v| v > 0.0));
}
