//! Checks a model against the matches: the number of placed photographs proves nothing.
//!
//! Matches between two photographs fit a model if each is near the epipolar line of the other.
//! Photographs of different but similar places (the windows of two walls, the sides of a table)
//! also match, and a model that trusts these matches contradicts the true ones. The true ones are
//! more numerous, so the strongest matches that connect all photographs, a maximum spanning tree,
//! decide. If the model contradicts a branch, the photographs that depend on it are not trusted.

use std::collections::HashMap;

use glam::{DMat3, DVec2, DVec3};

use super::copies::Copies;
use super::groups::{Groups, LEAST_MATCHES};
use crate::camera::Camera;
use crate::poses::Lens;
use crate::poses::matching::{Correspondences, PairMatches};
use crate::poses::model::SparseModel;

/// Largest distance of a match from the epipolar line, px of the small copies.
const NEAR: f64 = 3.0;

/// Smallest share of a branch's matches that fit the model. On models with true poses (cells of 2.6
/// and 4.4 px) it is 0.71 or more for every branch; for a false branch 0.64 or less, but 0.73 once.
const LEAST_FIT: f64 = 0.68;

/// Share of a pair's matches from which it supports its model.
const SUPPORT: f64 = 0.5;

/// The matches of two placed photographs, and how many of them fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PairFit {
    pub first: usize,
    pub second: usize,
    pub matches: usize,
    pub fitting: usize,
}

impl PairFit {
    fn share(&self) -> f64 {
        self.fitting as f64 / self.matches.max(1) as f64
    }
}

/// How the matches agree with a model.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Consistency {
    /// For every pair of placed photographs with matches.
    pub pairs: Vec<PairFit>,
    /// Placed photographs that the strongest matches connect consistently with the model; the
    /// largest part first.
    pub parts: Vec<Vec<usize>>,
}

/// A placed photograph.
struct Placed {
    camera: Camera,
    lens: Lens,
    /// From px of the matches to px of the model's copies.
    scale: f64,
}

impl Consistency {
    /// Compares a model, made from `copies`, with the matches found in the `small` ones.
    pub fn of(
        model: &SparseModel,
        copies: &Copies,
        small: &Copies,
        found: &Correspondences,
    ) -> Self {
        let places = placed(model, copies, small);
        let mut pairs: Vec<PairFit> = Vec::new();
        for pair in &found.pairs {
            if let (Some(a), Some(b)) = (places.get(&pair.first), places.get(&pair.second)) {
                pairs.push(PairFit {
                    first: pair.first,
                    second: pair.second,
                    matches: pair.matches.len(),
                    fitting: fitting(a, b, pair, found),
                });
            }
        }
        let mut views: Vec<usize> = places.into_keys().collect();
        views.sort_unstable();
        Self { parts: parts(&views, &pairs), pairs }
    }

    /// Share of all matches between placed photographs that fit the model.
    pub fn share(&self) -> f64 {
        let matches: usize = self.pairs.iter().map(|pair| pair.matches).sum();
        let fitting: usize = self.pairs.iter().map(|pair| pair.fitting).sum();
        fitting as f64 / matches.max(1) as f64
    }

    /// The trusted photographs.
    pub fn believed(&self) -> &[usize] {
        self.parts.first().map_or(&[], Vec::as_slice)
    }

    /// A photograph's matches with placed ones, and how many of them fit.
    pub fn matches_of(&self, view: usize) -> (usize, usize) {
        let own = self.pairs.iter().filter(|pair| pair.first == view || pair.second == view);
        own.fold((0, 0), |(matches, fitting), pair| {
            (matches + pair.matches, fitting + pair.fitting)
        })
    }

    /// The fitting matches between trusted photographs, and the `strongest` pairs of the others.
    pub fn agreeing(
        &self,
        found: &Correspondences,
        strongest: &Correspondences,
    ) -> Correspondences {
        let believed = self.believed();
        let agrees = |pair: &&PairMatches| {
            let of_pair = |fit: &&PairFit| (fit.first, fit.second) == (pair.first, pair.second);
            if believed.contains(&pair.first) && believed.contains(&pair.second) {
                let fit = self.pairs.iter().find(of_pair);
                return fit.is_some_and(|fit| fit.share() >= SUPPORT);
            }
            let same =
                |other: &PairMatches| (other.first, other.second) == (pair.first, pair.second);
            strongest.pairs.iter().any(same)
        };
        Correspondences {
            key_points: found.key_points.clone(),
            pairs: found.pairs.iter().filter(agrees).cloned().collect(),
            kept: found.kept,
        }
    }
}

/// The model's cameras by photograph index.
fn placed(model: &SparseModel, copies: &Copies, small: &Copies) -> HashMap<usize, Placed> {
    let mut placed = HashMap::new();
    for image in &model.images {
        let index = copies.copies.iter().position(|copy| copy.file == image.name);
        if let Some(index) = index {
            let lens = model.camera_of(image).lens();
            placed.insert(
                index,
                Placed {
                    camera: Camera {
                        intrinsics: lens.intrinsics,
                        world_to_camera: image.world_to_camera(),
                    },
                    lens,
                    scale: copies.copies[index].size.0 as f64 / small.copies[index].size.0 as f64,
                },
            );
        }
    }
    placed
}

/// Number of matches of a pair that are near each other's epipolar lines.
fn fitting(a: &Placed, b: &Placed, pair: &PairMatches, found: &Correspondences) -> usize {
    let rotation = b.camera.rotation() * a.camera.rotation().transpose();
    let translation = b.camera.translation() - rotation * a.camera.translation();
    let cross = DMat3::from_cols(
        DVec3::new(0.0, translation.z, -translation.y),
        DVec3::new(-translation.z, 0.0, translation.x),
        DVec3::new(translation.y, -translation.x, 0.0),
    );
    let essential = cross * rotation;
    let focal = 0.5 * (a.lens.intrinsics.fx / a.scale + b.lens.intrinsics.fx / b.scale);
    let ray = |placed: &Placed, [x, y]: [f32; 2]| {
        let pixel = DVec2::new(f64::from(x), f64::from(y)) * placed.scale;
        placed.lens.ray(pixel).extend(1.0)
    };
    let near = |[first, second]: &&[u32; 2]| {
        let from = ray(a, found.key_points[pair.first][*first as usize]);
        let to = ray(b, found.key_points[pair.second][*second as usize]);
        let (line_to, line_from) = (essential * from, essential.transpose() * to);
        let slope = line_to.truncate().length_squared() + line_from.truncate().length_squared();
        // Sampson's distance.
        to.dot(line_to).abs() * focal <= NEAR * slope.sqrt()
    };
    pair.matches.iter().filter(near).count()
}

/// The parts connected by the fitting branches of the maximum spanning tree.
fn parts(views: &[usize], pairs: &[PairFit]) -> Vec<Vec<usize>> {
    let mut strongest: Vec<&PairFit> =
        pairs.iter().filter(|pair| pair.matches >= LEAST_MATCHES).collect();
    strongest.sort_by_key(|pair| (std::cmp::Reverse(pair.matches), pair.first, pair.second));
    let mut tree = Groups::new(views);
    let branches: Vec<&PairFit> =
        strongest.into_iter().filter(|pair| tree.join(pair.first, pair.second)).collect();
    let mut held = Groups::new(views);
    for branch in branches {
        if branch.share() >= LEAST_FIT {
            held.join(branch.first, branch.second);
        }
    }
    held.members()
}

#[cfg(test)]
mod tests;
