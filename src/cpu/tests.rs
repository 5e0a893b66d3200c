//! The bytes of whole steps, on vectors of either width and with any number of threads.

use std::sync::atomic::Ordering::Relaxed;

use crate::View;
use crate::bins::Bins;
use crate::blend::{Canvas, SlotSums};
use crate::loss::{Loss, Noise, Shares, Target};
use crate::noise::{NoiseField, PARAMETERS};
use crate::population::{Population, column};
use crate::project::Projection;
use crate::shake::{KNOTS, Kernel, Response, Shake, Tap};
use crate::simd::NARROW;
use crate::update::{Blended, Step};

/// Numbers in -1..1.
fn random() -> impl FnMut() -> f32 {
    let mut state = 9_u32;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    }
}

fn population() -> Population {
    let mut random = random();
    Population::from_fn(2, 700, |_, at| {
        let value = random();
        match at {
            column::LOG_SCALE..column::QUAT => value - 3.0,
            _ => value,
        }
    })
}

fn view() -> View {
    let rows = [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 3.0]];
    View {
        rows,
        focal: [90.0; 2],
        centre: [50.0, 31.0],
        size: [101, 67],
        position: [-0.1, 0.0, -3.0],
        sh_degree: 2,
        background: [0.1; 3],
        near: 0.1,
    }
}

/// Numbers of all kernels after three steps.
fn steps() -> Vec<u32> {
    let view = view();
    let mut population = population().in_training();
    let (mut projection, mut bins) = (Projection::default(), Bins::default());
    let (mut canvas, mut sums) = (Canvas::default(), SlotSums::default());
    let (mut loss, mut shake) = (Loss::default(), Shake::default());
    let values = 3 * 101 * 67;
    let (target, mut gradient) = (vec![30_000_u16; values], vec![0.0; values]);
    let tap = |offset, share| Tap { offset, weights: [share; 6] };
    let taps = vec![tap([0, 0], 0.5), tap([2, -1], 0.3), tap([-3, 1], 0.2)];
    let kernel = Kernel::new(taps, view.size);
    let light = std::array::from_fn(|n| (n as f32 / (KNOTS - 1) as f32).powi(2));
    let response = Response::new(&light);
    let shares = Shares { absolute: 0.8, similarity: 0.2 };
    let noise = Noise::new(std::array::from_fn(|n| 0.2 / (n + 1) as f32));
    let step = Step {
        rates: [1e-3; 4],
        rate_sh0: 1e-3,
        rate_sh: 1e-4,
        bias: [10.0, 1000.0],
        opacity_weight: 1e-5,
        scale_weight: 1e-5,
        noise: 5.0,
        ..Step::default()
    };
    for _ in 0..3 {
        projection.run(&population, &view);
        bins.run(&projection, view.size);
        canvas.run(&projection, &bins, &view);
        shake.forward(&canvas.image, &kernel, &response);
        let target = Target { values: &target, size: view.size, noise: &noise };
        loss.run(&shake.blurred, target, shares, &mut gradient);
        shake.backward(&canvas.image, &gradient, &kernel, &response, [1e-6, 0.02]);
        sums.run(&projection, &bins, &canvas, &shake.render_gradient, &view);
        Blended { view: &view, bins: &bins, sums: &sums }.update(&mut population, &step);
    }
    assert!(bins.visible() > 300 && bins.intersections() > 1000);
    let all = [&canvas.image, &shake.blurred, &gradient, &shake.render_gradient];
    let values = population.values.as_flattened();
    all.into_iter().flatten().chain(values).map(|value| value.to_bits()).collect()
}

/// Numbers of the noise field after two steps.
fn field_steps() -> Vec<u32> {
    let view = View { size: [150, 11], ..view() };
    let mut random = random();
    let parameters = (0..PARAMETERS).map(|_| 0.09 * random()).collect();
    let mut field = NoiseField::new(0, parameters).expect("as many as it has");
    let render: Vec<f32> = (0..3 * 150 * 11).map(|_| random()).collect();
    let mut prediction = Vec::new();
    for _ in 0..2 {
        field.forward(&view, &render, &mut prediction);
        field.backward(&view, &render);
    }
    prediction.iter().chain(field.numbers()).map(|value| value.to_bits()).collect()
}

fn with_threads(threads: usize, steps: fn() -> Vec<u32>) -> Vec<u32> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    pool.install(steps)
}

/// FNV-1a of the bits, which are the same with any number of threads and on every processor.
fn hash(steps: fn() -> Vec<u32>) -> u64 {
    let one = with_threads(1, steps);
    assert_eq!(one, with_threads(3, steps));
    NARROW.store(true, Relaxed);
    let narrow = with_threads(2, steps);
    NARROW.store(false, Relaxed);
    assert_eq!(one, narrow);
    one.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, &bits| {
        (hash ^ u64::from(bits)).wrapping_mul(0x100_0000_01b3)
    })
}

#[test]
fn threads_and_widths_of_vectors_do_not_change_a_bit() {
    // One after the other: the width is the process's.
    for (steps, expected) in
        [(steps as fn() -> Vec<u32>, 0xa248_d054_4022_852a), (field_steps, 0xf7c5_136d_5008_e0a5)]
    {
        let found = hash(steps);
        assert_eq!(found, expected, "{found:#x}");
    }
}
