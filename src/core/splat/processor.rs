//! Cameras and Gaussians as the kernels for processors take them.

use fled_cpu::View;
use fled_cpu::population::{Population, column};

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

/// The population of a scene, with moments of zero.
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

#[cfg(test)]
mod tests;
