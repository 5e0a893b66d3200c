//! Cameras and Gaussians in the form of the kernels for processors.

use fled_cpu::View;
use fled_cpu::population::{Population, column};

use super::rows::{GEOMETRY_ROW, GeometryRow, sh_row};
use super::uniform::CameraUniform;
use crate::gaussians::Gaussians;

/// The view of a kernel's camera.
pub fn view(camera: &CameraUniform) -> View {
    View {
        rows: [camera.row_x, camera.row_y, camera.row_z],
        focal: camera.focal,
        centre: camera.centre,
        size: camera.size.map(|pixels| pixels as usize),
        position: camera.position,
        sh_degree: camera.sh_degree,
        background: camera.background,
        near: camera.near,
    }
}

/// The population of a scene.
pub fn population(scene: &Gaussians) -> Population {
    let harmonics = 3 * scene.coefficients();
    Population::from_fn(scene.sh_degree, scene.len(), |i, at| match at {
        column::MEAN..column::LOG_SCALE => scene.means[i][at],
        column::LOG_SCALE..column::QUAT => scene.log_scales[i][at - column::LOG_SCALE],
        column::QUAT..column::LOGIT => scene.quats[i][at - column::QUAT],
        column::LOGIT => scene.opacity_logits[i],
        _ => scene.sh[i * harmonics + at - column::HARMONICS],
    })
}

/// The scene of a population.
pub fn scene(population: &Population) -> Gaussians {
    let mut out = Gaussians { sh_degree: population.sh_degree(), ..Gaussians::default() };
    for i in 0..population.len() {
        let number = |at: usize| population.number(i, at);
        out.means.push([0, 1, 2].map(|n| number(column::MEAN + n)));
        out.log_scales.push([0, 1, 2].map(|n| number(column::LOG_SCALE + n)));
        out.quats.push([0, 1, 2, 3].map(|n| number(column::QUAT + n)));
        out.opacity_logits.push(number(column::LOGIT));
        out.sh.extend((column::HARMONICS..population.columns()).map(number));
    }
    out
}

/// The geometry of a population.
pub fn geometry(population: &Population) -> Vec<GeometryRow> {
    let row = |i: usize| {
        let number = |at: usize| population.number(i, at);
        GeometryRow {
            mean: [0, 1, 2].map(|n| number(column::MEAN + n)),
            log_scale: [0, 1, 2].map(|n| number(column::LOG_SCALE + n)),
            quat: [0, 1, 2, 3].map(|n| number(column::QUAT + n)),
            opacity_logit: number(column::LOGIT),
            spare: 0.0,
        }
    };
    (0..population.len()).map(row).collect()
}

/// Rows of harmonics, [count, `sh_row`].
pub fn harmonics(population: &Population) -> Vec<f32> {
    let row = sh_row(population.sh_degree());
    let mut out = vec![0.0; population.len() * row];
    for (i, out) in out.chunks_exact_mut(row).enumerate() {
        for (at, value) in (column::HARMONICS..population.columns()).zip(out) {
            *value = population.number(i, at);
        }
    }
    out
}

/// Adam's moments of the geometry with the statistics of classic densification, [count, 2, 12],
/// and of the harmonics, [count, 2, `sh_row`].
pub fn moments(population: &Population) -> [Vec<f32>; 2] {
    let (count, row) = (population.len(), sh_row(population.sh_degree()));
    let mut out = [vec![0.0; 2 * GEOMETRY_ROW * count], vec![0.0; 2 * row * count]];
    for i in 0..count {
        for at in 0..population.columns() {
            let (array, length, at_row) = place(at, row);
            for (n, moment) in population.moments(i, at).into_iter().enumerate() {
                out[array][(2 * i + n) * length + at_row] = moment;
            }
        }
        for (n, statistic) in population.statistics(i).into_iter().enumerate() {
            out[0][(2 * i + n) * GEOMETRY_ROW + column::HARMONICS] = statistic;
        }
    }
    out
}

/// Sets moments and statistics from the arrays of [`moments`].
pub fn set_moments(population: &mut Population, arrays: [&[f32]; 2]) {
    let row = sh_row(population.sh_degree());
    for i in 0..population.len() {
        for at in 0..population.columns() {
            let (array, length, at_row) = place(at, row);
            let moment = |n: usize| arrays[array][(2 * i + n) * length + at_row];
            population.set_moments(i, at, [moment(0), moment(1)]);
        }
        let statistic = |n: usize| arrays[0][(2 * i + n) * GEOMETRY_ROW + column::HARMONICS];
        population.set_statistics(i, [statistic(0), statistic(1)]);
    }
}

/// Where a column's moment lies: index and row length of its array, and place in the row. The last
/// place of a row of geometry, after its 11 numbers, holds a statistic.
fn place(at: usize, sh_row: usize) -> (usize, usize, usize) {
    if at < column::HARMONICS { (0, GEOMETRY_ROW, at) } else { (1, sh_row, at - column::HARMONICS) }
}

#[cfg(test)]
mod tests;
