//! Times every part of a step on a scene like those of `fled bench`: random Gaussians in a box,
//! flat and long ones, that touch about 3.1 tiles each.
//!
//! `cargo run --release -p fled-cpu --example parts -- 560 320 30000`, with `RAYON_NUM_THREADS` for
//! the number of threads. Times are summed over all threads. With a last argument `field`, it times
//! only the noise field.

use std::time::Instant;

use fled_cpu::View;
use fled_cpu::bins::Bins;
use fled_cpu::blend::{Canvas, SlotSums};
use fled_cpu::loss::{Loss, Noise, Shares, Target};
use fled_cpu::noise::{self, NoiseField};
use fled_cpu::population::{Population, column};
use fled_cpu::project::Projection;
use fled_cpu::shake::{KNOTS, Kernel, Response, Shake, Tap};
use fled_cpu::update::{Blended, Step};

const STEPS: usize = 30;
const BOX: [f32; 3] = [1.6, 0.95, 1.0];

struct Random(u64);

impl Random {
    fn signed(&mut self) -> f32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

fn scene(count: usize) -> Population {
    let mut random = Random(7);
    let log_scale = (0.024 * (10_000.0 / count as f32).sqrt()).ln();
    let scene = Population::from_fn(3, count, |_, at| {
        let value = random.signed();
        match at {
            column::MEAN..column::LOG_SCALE => BOX[at] * value,
            column::LOG_SCALE..column::QUAT => log_scale + 0.8 * value,
            column::QUAT..column::LOGIT => value,
            column::LOGIT => 0.5 + 2.5 * value,
            _ if at < column::HARMONICS + 3 => value,
            _ => 0.1 * value,
        }
    });
    scene.in_training()
}

/// Three units in front of the box.
fn view(width: usize, height: usize) -> View {
    let focal = [width as f32; 2];
    let centre = [0.5 * width as f32, 0.5 * height as f32];
    View {
        rows: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 3.0]],
        focal,
        centre,
        size: [width, height],
        position: [0.0, 0.0, -3.0],
        sh_degree: 3,
        background: [0.0; 3],
        near: 0.01,
    }
}

/// A shake along a line of 21 taps.
fn line(size: [usize; 2]) -> Kernel {
    let taps = (-10..=10).map(|n: i32| Tap { offset: [n, n / 2], weights: [1.0 / 21.0; 6] });
    Kernel::new(taps.collect(), size)
}

fn squares() -> Response {
    Response::new(&std::array::from_fn(|n| (n as f32 / (KNOTS - 1) as f32).powi(2)))
}

/// CPU seconds of all threads of this process, which other processes do not affect.
fn computed() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let times = tasks.filter_map(|task| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<f64>().ok()
    });
    1e-9 * times.sum::<f64>()
}

/// Multiplications and additions of a pixel in a product of its 128 numbers with a layer's weights.
/// Forward pass, its repetition, derivatives by inputs and by weights have three each.
const LAYER: f64 = 2.0 * 128.0 * 128.0;

/// Times the noise field.
fn field(view: &View) {
    let mut random = Random(3);
    let parameters = (0..noise::PARAMETERS).map(|_| 0.09 * random.signed()).collect();
    let mut field = NoiseField::new(0, parameters).expect("as many parameters as it has");
    let values = 3 * view.size[0] * view.size[1];
    let (render, gradient) = (vec![0.5; values], vec![1e-6; values]);
    let mut prediction = Vec::new();
    let mut times = [const { Vec::new() }; 2];
    for _ in 0..STEPS / 3 {
        let begin = (computed(), Instant::now());
        field.forward(view, &render, &mut prediction);
        times[0].push((computed() - begin.0, begin.1.elapsed().as_secs_f64()));
        let begin = (computed(), Instant::now());
        field.backward(view, &gradient);
        times[1].push((computed() - begin.0, begin.1.elapsed().as_secs_f64()));
    }
    for (name, layers, mut times) in
        [("field", 3.0, times[0].clone()), ("back", 9.0, times[1].clone())]
    {
        times.sort_by(|a, b| f64::total_cmp(&a.0, &b.0));
        let (computed, elapsed) = times[0];
        let rate = layers * LAYER * (values / 3) as f64 / computed * 1e-9;
        eprintln!(
            "{name:12} {:7.2} ms, elapsed {:7.2}; {rate:.1} GFLOP/s of a core",
            1e3 * computed,
            1e3 * elapsed
        );
    }
}

fn main() {
    let numbers: Vec<usize> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [width, height, count] = numbers[..] else {
        eprintln!("usage: parts WIDTH HEIGHT GAUSSIANS");
        std::process::exit(2);
    };
    let (mut population, view) = (scene(count), view(width, height));
    if std::env::args().any(|a| a == "field") {
        return field(&view);
    }
    let (mut projection, mut bins) = (Projection::default(), Bins::default());
    let (mut canvas, mut sums, mut loss) =
        (Canvas::default(), SlotSums::default(), Loss::default());
    let mut gradient = vec![0.0; 3 * width * height];
    let target = vec![30_000_u16; 3 * width * height];
    let step = Step {
        rates: [1e-9; 4],
        bias: [1.0; 2],
        opacity_weight: 1e-9,
        noise: if std::env::args().any(|a| a == "noise") { 1e-9 } else { 0.0 },
        ..Step::default()
    };
    let shares = Shares { absolute: 0.8, similarity: 0.2 };
    let (kernel, response) = (line(view.size), squares());
    let mut shake = Shake::default();
    let names =
        ["projection", "binning", "forward", "shake", "loss", "shake back", "backward", "update"];
    let mut times = vec![Vec::new(); names.len()];
    for _ in 0..STEPS {
        let mut part = 0;
        let mut timed = |work: &mut dyn FnMut()| {
            let begin = computed();
            work();
            times[part].push(computed() - begin);
            part += 1;
        };
        timed(&mut || projection.run(&population, &view));
        timed(&mut || bins.run(&projection, view.size));
        timed(&mut || canvas.run(&projection, &bins, &view));
        timed(&mut || shake.forward(&canvas.image, &kernel, &response));
        let target = Target { values: &target, size: view.size, noise: &Noise::NONE };
        timed(&mut || _ = loss.run(&canvas.image, target, shares, &mut gradient));
        timed(&mut || {
            shake.backward(&canvas.image, &gradient, &kernel, &response, [1e-7, 0.02]);
        });
        timed(&mut || sums.run(&projection, &bins, &canvas, &gradient, &view));
        timed(&mut || {
            let blended = Blended { view: &view, bins: &bins, sums: &sums };
            blended.update(&mut population, &step);
        });
    }
    let mut whole = 0.0;
    for (name, times) in names.iter().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let (least, median) = (1e3 * times[0], 1e3 * times[STEPS / 2]);
        whole += least;
        eprintln!("{name:12} {median:7.2} ms, least {least:7.2}");
    }
    let (visible, intersections) = (bins.visible(), bins.intersections());
    eprintln!("all parts    {whole:7.2} ms at least; {visible} visible, {intersections} entries");
}
