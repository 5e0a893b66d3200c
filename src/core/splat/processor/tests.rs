//! Tests of the kernels for processors against the f64 reference.

use fled_cpu::bins::Bins;
use fled_cpu::blend::{Canvas, SUMS, SlotSums};
use fled_cpu::project::{Projection, entry};
use fled_cpu::update::{Blended, Step};

use super::*;
use crate::splat::compare::{gradients_agree, mostly_within};
use crate::splat::fixtures::{self, Random};
use crate::splat::reference::{
    Projected, ProjectedGradient, Splat, Viewpoint, blend, blend_backward, column as columns,
    project, project_backward, render_backward,
};

/// A scene with a camera, and a derivative of the loss by its image.
struct Case {
    gaussians: Gaussians,
    viewpoint: Viewpoint,
    background: [f32; 3],
    upstream: Vec<f32>,
}

/// The results of all kernels.
#[derive(Default)]
struct Run {
    projection: Projection,
    bins: Bins,
    canvas: Canvas,
    sums: SlotSums,
}

impl Case {
    fn new(gaussians: Gaussians, width: usize, height: usize) -> Self {
        let mut random = Random::new(5);
        let upstream = (0..3 * width * height).map(|_| random.signed() as f32).collect();
        let degree = gaussians.sh_degree;
        let viewpoint = Viewpoint { sh_degree: degree, ..fixtures::viewpoint(width, height) };
        Self { gaussians, viewpoint, background: [0.0; 3], upstream }
    }

    fn view(&self) -> View {
        let (count, degree) = (self.gaussians.len(), self.viewpoint.sh_degree);
        let (camera, near) = (&self.viewpoint.camera, self.viewpoint.near as f32);
        let allocated = self.gaussians.sh_degree;
        view(&CameraUniform::new(camera, count, degree, allocated, near).before(self.background))
    }

    fn run(&self) -> Run {
        let mut run = Run::default();
        let (population, view) = (population(&self.gaussians), self.view());
        // Twice: no result may depend on the leftovers of the previous step.
        for _ in 0..2 {
            run.projection.run(&population, &view);
            run.bins.run(&run.projection, view.size);
            run.canvas.run(&run.projection, &run.bins, &view);
            run.sums.run(&run.projection, &run.bins, &run.canvas, &self.upstream, &view);
        }
        run
    }

    fn splats(&self) -> Vec<Splat> {
        (0..self.gaussians.len()).map(|i| Splat::from_gaussians(&self.gaussians, i)).collect()
    }

    /// The reference's image of what was projected.
    fn expected(&self, run: &Run) -> crate::splat::reference::Blended {
        let [width, height] = self.view().size;
        blend(&run.projected(), width, height).before(self.background.map(f64::from))
    }

    fn wide_upstream(&self) -> Vec<f64> {
        self.upstream.iter().map(|&v| f64::from(v)).collect()
    }
}

impl Run {
    /// The projections; `None` if culled.
    fn projected(&self) -> Vec<Option<Projected>> {
        let rows = self.projection.splats.iter().zip(&self.projection.depths);
        let row = |(splat, &depth): (&fled_cpu::project::Splat, &f32)| {
            let at = |n: usize| f64::from(splat[n]);
            let curve =
                |n: usize, factor: f64| at(entry::CURVE + n) / (-factor * std::f64::consts::LOG2_E);
            depth.is_finite().then(|| Projected {
                mean: [at(entry::MEAN), at(entry::MEAN + 1)],
                conic: [curve(0, 0.5), curve(1, 1.0), curve(2, 0.5)],
                opacity: at(entry::LOG_OPACITY).exp2(),
                colour: [0, 1, 2].map(|n| at(entry::COLOUR + n)),
                depth: f64::from(depth),
                extent: [at(entry::EXTENT), at(entry::EXTENT + 1)],
            })
        };
        rows.map(row).collect()
    }

    /// The gradients by what was projected.
    fn gradients(&self) -> Vec<ProjectedGradient> {
        let gradient = |(g, projected): (usize, Option<Projected>)| {
            let mut sum = [0.0; SUMS];
            for slot in self.bins.slots(g) {
                let row = self.sums.row(slot);
                (0..SUMS).for_each(|n| sum[n] += f64::from(row[n]));
            }
            let zero = ProjectedGradient::default();
            projected.map_or(zero, |p| crate::splat::rasterize::gradient(&sum, p.conic, p.opacity))
        };
        self.projected().into_iter().enumerate().map(gradient).collect()
    }
}

fn flat(p: &Projected) -> [f64; 10] {
    let ([x, y], [a, b, c], [red, green, blue]) = (p.mean, p.conic, p.colour);
    [x, y, a, b, c, p.opacity, red, green, blue, p.depth]
}

fn flat_gradient(g: &ProjectedGradient) -> [f64; 9] {
    let ([x, y], [a, b, c], [red, green, blue]) = (g.mean, g.conic, g.colour);
    [x, y, a, b, c, red, green, blue, g.opacity]
}

#[test]
fn the_projection_matches_the_reference() {
    for degree in 0..=3 {
        let mut case = Case::new(fixtures::gaussians(401, 3, 17), 144, 96);
        case.viewpoint.sh_degree = degree;
        let found = case.run().projected();
        let mut visible = 0;
        for (i, splat) in case.splats().iter().enumerate() {
            let expected = project(splat, &case.viewpoint);
            let (Some(expected), Some(found)) = (&expected, &found[i]) else {
                assert_eq!(expected.is_some(), found[i].is_some(), "{i}");
                continue;
            };
            visible += 1;
            for (found, expected) in flat(found).into_iter().zip(flat(expected)) {
                let error = (found - expected).abs();
                assert!(error <= 2e-4 * (1.0 + expected.abs()), "{i}: {found} {expected}");
            }
        }
        assert!(visible > 150, "{visible} visible");
    }
}

#[test]
fn poisoned_gaussians_are_culled() {
    let mut gaussians = fixtures::gaussians(7, 1, 3);
    gaussians.means.fill([0.0; 3]);
    gaussians.log_scales.fill([-2.0; 3]);
    gaussians.opacity_logits.fill(2.0);
    gaussians.means[0][1] = f32::NAN;
    gaussians.quats[1] = [0.0; 4];
    gaussians.log_scales[2] = [3e38; 3];
    gaussians.sh[3 * 12 + 1] = f32::INFINITY;
    gaussians.opacity_logits[4] = f32::NAN;
    gaussians.means[5] = [0.0, 0.0, -50.0];
    let found = Case::new(gaussians, 64, 48).run().projected();
    assert!(found[..6].iter().all(Option::is_none) && found[6].is_some());
}

#[test]
fn image_and_transmittance_match_the_reference_at_odd_sizes() {
    for (width, height) in [(141, 93), (16, 16), (5, 40)] {
        let case = Case::new(fixtures::gaussians(1500, 1, 3), width, height);
        let run = case.run();
        let expected = case.expected(&run);
        mostly_within(&run.canvas.image, &expected.image, 1e-4, 1e-3).unwrap();
        mostly_within(&run.canvas.transmittance, &expected.transmittance, 1e-4, 1e-3).unwrap();
    }
}

#[test]
fn a_splat_over_all_tiles_covers_the_image() {
    let mut gaussians = fixtures::gaussians(3, 0, 3);
    gaussians.means.fill([0.0; 3]);
    gaussians.log_scales.fill([2.5; 3]);
    gaussians.opacity_logits = vec![0.0, 9.0, 9.0];
    let case = Case::new(gaussians, 90, 70);
    let run = case.run();
    assert_eq!(run.bins.intersections(), 3 * run.bins.len());
    mostly_within(&run.canvas.image, &case.expected(&run).image, 1e-4, 1e-3).unwrap();
    assert!(run.canvas.transmittance.iter().all(|&t| t < 0.6));
}

#[test]
fn nothing_visible_gives_the_background() {
    for gaussians in [Gaussians::default(), fixtures::gaussians(40, 0, 3)] {
        let mut case = Case::new(gaussians, 64, 48);
        case.gaussians.means.fill([0.0, 0.0, -60.0]);
        case.background = [0.25, 0.5, 0.75];
        let run = case.run();
        assert_eq!((run.bins.visible(), run.bins.intersections()), (0, 0));
        let expected = case.expected(&run);
        mostly_within(&run.canvas.image, &expected.image, 0.0, 0.0).unwrap();
    }
}

#[test]
fn gradients_by_the_projection_match_the_reference_in_every_column() {
    let mut case = Case::new(fixtures::gaussians(1500, 1, 3), 141, 93);
    case.background = [0.9, 0.2, 0.6];
    let run = case.run();
    let expected = blend_backward(&run.projected(), &case.expected(&run), &case.wide_upstream());
    let (found, expected): (Vec<_>, Vec<_>) = (
        run.gradients().iter().map(flat_gradient).collect(),
        expected.iter().map(flat_gradient).collect(),
    );
    for column in 0..9 {
        let of = |rows: &[[f64; 9]]| rows.iter().map(|r| r[column]).collect::<Vec<_>>();
        gradients_agree(&of(&found), &of(&expected))
            .unwrap_or_else(|why| panic!("column {column}: {why}"));
    }
}

/// The gradients of all numbers, [Gaussians, columns].
fn gradients(case: &Case, run: &Run) -> Vec<f64> {
    let (population, view) = (population(&case.gaussians), case.view());
    let blended = Blended { view: &view, bins: &run.bins, sums: &run.sums };
    blended.gradients(&population).into_iter().map(f64::from).collect()
}

#[test]
fn gradients_of_every_parameter_match_the_reference() {
    for degree in 0..=3 {
        let mut case = Case::new(fixtures::gaussians(400, 3, 4), 144, 96);
        case.viewpoint.sh_degree = degree;
        let run = case.run();
        let found = gradients(&case, &run);
        let by_projection = run.gradients();
        let splats = case.splats().into_iter().zip(&by_projection);
        let expected: Vec<f64> = splats
            .flat_map(|(splat, by)| project_backward(&splat, &case.viewpoint, by).flatten())
            .collect();
        let row = population(&case.gaussians).columns();
        let opacity = columns::OPACITY_LOGIT..columns::OPACITY_LOGIT + 1;
        let harmonics = columns::HARMONICS..row;
        for range in [columns::MEAN, columns::LOG_SCALE, columns::QUAT, opacity, harmonics] {
            let pick = |all: &[f64]| -> Vec<f64> {
                all.chunks(row).flat_map(|row| row[range.clone()].to_vec()).collect()
            };
            gradients_agree(&pick(&found), &pick(&expected))
                .unwrap_or_else(|why| panic!("degree {degree}, {range:?}: {why}"));
        }
    }
}

#[test]
fn the_whole_backward_pass_matches_that_of_the_reference() {
    let mut case = Case::new(fixtures::gaussians(120, 2, 8), 70, 45);
    // Few splats end at a pixel's centre exactly: a smooth upstream leaves little to their edges.
    case.upstream.iter_mut().enumerate().for_each(|(i, v)| *v = (i as f32 * 0.01).sin());
    let found = gradients(&case, &case.run());
    let by_splat = render_backward(&case.splats(), &case.viewpoint, &case.wide_upstream());
    let expected: Vec<f64> = by_splat.iter().flat_map(Splat::flatten).collect();
    let relative = fixtures::relative_l2(&found, &expected);
    assert!(relative < 1e-2, "{relative}");
}

#[test]
fn the_first_update_moves_every_number_by_its_rate() {
    let case = Case::new(fixtures::gaussians(61, 1, 9), 144, 96);
    let (run, view) = (case.run(), case.view());
    let gradients = gradients(&case, &run);
    let mut population = population(&case.gaussians).in_training();
    let step = Step {
        rates: [1e-3, 2e-3, 3e-3, 4e-3],
        rate_sh0: 5e-3,
        rate_sh: 6e-3,
        bias: [10.0, 1000.0],
        ..Step::default()
    };
    let blended = Blended { view: &view, bins: &run.bins, sums: &run.sums };
    assert_eq!(blended.update(&mut population, &step), 0);
    for (i, splat) in case.splats().iter().enumerate() {
        for (at, &before) in splat.flatten().iter().enumerate() {
            let rate = match at {
                0..3 => step.rates[0],
                3..6 => step.rates[1],
                6..10 => step.rates[2],
                10 => step.rates[3],
                11..14 => step.rate_sh0,
                _ => step.rate_sh,
            };
            let by = gradients[i * population.columns() + at];
            let expected = before - f64::from(rate) * if by == 0.0 { 0.0 } else { by.signum() };
            let after = f64::from(population.number(i, at));
            assert!((after - expected).abs() <= 2e-6 * (1.0 + expected.abs()), "{i} {at}");
            let [first, second] = population.moments(i, at).map(f64::from);
            assert!((first - 0.1 * by).abs() <= 1e-6 + 1e-5 * by.abs());
            assert!((second - 0.001 * by * by).abs() <= 1e-6 + 1e-5 * by * by);
        }
    }
    let moved = scene(&population);
    assert_ne!(moved, case.gaussians);
    assert_eq!(super::population(&moved).len(), population.len());
}

#[test]
fn scenes_round_trip_bit_for_bit() {
    let gaussians = fixtures::gaussians(33, 2, 8);
    assert_eq!(scene(&population(&gaussians)), gaussians);
}

#[test]
fn a_densification_copies_splits_and_clears() {
    let gaussians = fixtures::gaussians(20, 2, 9);
    let case = Case::new(gaussians.clone(), 144, 96);
    let (run, view) = (case.run(), case.view());
    let mut population = population(&gaussians).in_training();
    let blended = Blended { view: &view, bins: &run.bins, sums: &run.sums };
    let step = Step { bias: [1.0; 2], accumulates: true, ..Step::default() };
    blended.update(&mut population, &step);
    assert_eq!(scene(&population), gaussians, "rates of zero move nothing");
    // A dead one and a new one become others; 3 splits, and 5 becomes what 4 was before.
    let moves = [[4, 3], [20, 3], [3, 3], [5, 4]];
    let shapes = [[-1.0, -2.0, -3.0, 0.5], [-4.0, -5.0, -6.0, 0.25], [-7.0; 4], [-8.0; 4]];
    population.relocate(&moves, &shapes, 22);
    let after = scene(&population);
    assert_eq!(after.len(), 22);
    for ([to, from], shape) in moves.map(|m| m.map(|i| i as usize)).into_iter().zip(shapes) {
        assert_eq!(after.means[to], gaussians.means[from]);
        assert_eq!(after.quats[to], gaussians.quats[from]);
        assert_eq!(after.log_scales[to], shape[..3]);
        assert_eq!(after.opacity_logits[to], shape[3]);
        assert_eq!(after.sh[27 * to..27 * to + 27], gaussians.sh[27 * from..27 * from + 27]);
        assert!((0..population.columns()).all(|at| population.moments(to, at) == [0.0; 2]));
    }
    let kept = (0..20).filter(|i| ![3, 4, 5].contains(i));
    let moments = kept.flat_map(|i| (0..population.columns()).map(move |at| (i, at)));
    assert!(moments.into_iter().any(|(i, at)| population.moments(i, at) != [0.0; 2]));
    assert!(after.quats[21] == [0.0; 4], "a row that no move fills is culled");
}

/// A scene after one step from moments of zero.
fn updated(case: &Case, step: &Step) -> Gaussians {
    let (run, view) = (case.run(), case.view());
    let mut population = population(&case.gaussians).in_training();
    Blended { view: &view, bins: &run.bins, sums: &run.sums }.update(&mut population, step);
    scene(&population)
}

#[test]
fn exploration_moves_faint_gaussians_and_leaves_opaque_ones() {
    let mut gaussians = fixtures::gaussians(400, 0, 9);
    gaussians.means.iter_mut().for_each(|m| m[2] -= 500.0);
    gaussians.log_scales.fill([-1.0, -1.0, -4.0]);
    gaussians.quats.fill([1.0, 0.0, 0.0, 0.0]);
    for i in 0..400 {
        gaussians.opacity_logits[i] = if i < 200 { -9.0 } else { 2.0 };
    }
    let case = Case::new(gaussians, 144, 96);
    let after = updated(&case, &Step { noise: 1.0, seed: 3, step: 7, ..Step::default() });
    let moved = |i: usize, axis: usize| after.means[i][axis] - case.gaussians.means[i][axis];
    let spread = |axis| ((0..200).map(|i| moved(i, axis).powi(2)).sum::<f32>() / 200.0).sqrt();
    // e^-2 times the gate of an opacity of 1.2e-4.
    assert!((spread(0) / 0.0838 - 1.0).abs() < 0.2, "{}", spread(0));
    assert!((spread(1) / 0.0838 - 1.0).abs() < 0.2 && spread(2) < 0.01);
    assert!((200..400).all(|i| moved(i, 0).abs() < 1e-6));
}

#[test]
fn no_gaussian_recedes_by_more_than_a_quarter_of_its_depth() {
    let mut gaussians = fixtures::gaussians(60, 0, 9);
    gaussians.log_scales[..30].fill([2.0, -1.0, 2.0]);
    gaussians.quats[..30].fill([1.0, 0.0, 0.0, 0.0]);
    let case = Case::new(gaussians, 144, 96);
    let seen = case.run();
    let (after, camera) = (updated(&case, &Step::default()), &case.viewpoint.camera);
    let mut shrunk = 0;
    for i in 0..60 {
        let mean = glam::DVec3::from(case.gaussians.means[i].map(f64::from));
        let depth = (camera.rotation() * mean + camera.translation()).z;
        for axis in 0..3 {
            let before = case.gaussians.log_scales[i][axis];
            let after = after.log_scales[i][axis];
            let recedes = camera.rotation().col(axis).z.abs().max(1e-6);
            let most = (0.25 * depth / recedes).ln() as f32;
            let is_held = i < 30 && !seen.bins.slots(i).is_empty();
            let expected = if is_held { before.min(most) } else { before };
            if i < 30 || seen.bins.slots(i).is_empty() {
                assert!((after - expected).abs() < 1e-4, "{i} {axis}: {after} {expected}");
            }
            shrunk += usize::from(after < before);
        }
    }
    assert!(shrunk > 5, "{shrunk}");
}

#[test]
fn regularisers_lower_opacities_and_scales_of_gaussians_out_of_sight() {
    let mut gaussians = fixtures::gaussians(20, 0, 9);
    gaussians.means.fill([0.0, 0.0, -60.0]);
    let case = Case::new(gaussians, 64, 48);
    let step = Step {
        rates: [1e-3; 4],
        bias: [10.0, 1000.0],
        opacity_weight: 1e-4,
        scale_weight: 1e-4,
        ..Step::default()
    };
    let after = updated(&case, &step);
    for i in 0..20 {
        let by = |before: f32, after: f32| (before - after - 1e-3).abs() < 1e-6;
        assert!(by(case.gaussians.opacity_logits[i], after.opacity_logits[i]));
        assert!((0..3).all(|n| by(case.gaussians.log_scales[i][n], after.log_scales[i][n])));
    }
    assert_eq!(after.means, case.gaussians.means);
}

#[test]
fn a_gradient_that_is_not_finite_is_dropped_and_counted() {
    let mut case = Case::new(fixtures::gaussians(50, 1, 9), 96, 64);
    case.upstream[64 * 48 + 30] = f32::NAN;
    let (run, view) = (case.run(), case.view());
    let mut population = population(&case.gaussians).in_training();
    let step = Step { rates: [1e-3; 4], bias: [10.0, 1000.0], ..Step::default() };
    let blended = Blended { view: &view, bins: &run.bins, sums: &run.sums };
    let dropped = blended.update(&mut population, &step);
    let after = scene(&population);
    let kept = (0..50).filter(|&i| after.means[i] == case.gaussians.means[i]).count();
    let visible = (0..50).filter(|&i| !run.bins.slots(i).is_empty()).count();
    assert!(dropped > 0 && dropped < visible, "{dropped} of {visible}");
    assert_eq!(kept, 50 - visible + dropped);
    let columns = population.columns();
    assert!(
        (0..50 * columns).all(|n| {
            population.moments(n / columns, n % columns).iter().all(|m| m.is_finite())
        })
    );
}
