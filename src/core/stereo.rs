//! Dense points: how far away what every photograph shows is, by comparing it with its neighbours
//! plane by plane, and what several photographs agree on.
//!
//! Structure from motion finds points at corners, and few of them in shaken photographs. Splats
//! that begin with few points guess the rest, each photograph for itself, and from between the
//! photographs one sees it: floaters and needles. A plane sweep needs no corners, only texture, and
//! bears shake and noise because a window of 7 x 7 px is compared at a time (Collins 1996).

mod fuse;
mod map;
mod sweep;

use glam::DVec3;
use rayon::prelude::*;

use crate::camera::Camera;
use crate::cancel::{CancelToken, Cancelled};
use crate::image::Image;

pub use fuse::DensePoint;

use map::{DepthMap, StereoView};

/// Longest side of what is compared, px: at half the size a shake is half as long and the noise
/// half as strong.
const SIZE: usize = 280;

/// What photographs agree on about the depth of what they show.
#[derive(Debug)]
pub struct Stereo {
    views: Vec<StereoView>,
    maps: Vec<DepthMap>,
    nearest: Vec<Option<f64>>,
}

impl Stereo {
    /// Compares photographs taken by these cameras. `sparse` are points of the scene, world units:
    /// they tell which depths come into question, and, where they were `measured` and not guessed,
    /// what is too near to be anything. Nothing is agreed on where there are fewer than three
    /// photographs, or hardly any sparse points.
    ///
    /// # Errors
    /// Cancelled.
    pub fn of(
        photographs: &[(Camera, &Image)],
        sparse: &[[f32; 3]],
        measured: bool,
        cancel: &CancelToken,
    ) -> Result<Self, Cancelled> {
        let views: Vec<StereoView> = photographs
            .par_iter()
            .map(|(camera, image)| StereoView::new(camera, image, SIZE))
            .collect();
        let maps: Vec<DepthMap> = (0..views.len())
            .into_par_iter()
            .map(|index| {
                cancel.check()?;
                Ok(sweep::depths(&views, index, sparse))
            })
            .collect::<Result<_, Cancelled>>()?;
        let nearest = |view: &StereoView| {
            let [_, near] = sweep::inverse_depths(view, sparse)?;
            measured.then(|| 1.0 / near)
        };
        Ok(Self {
            nearest: views.iter().map(nearest).collect(),
            maps: fuse::agreed(&views, &maps),
            views,
        })
    }

    /// At most `most` points on the surfaces that are agreed on, evenly spread.
    pub fn points(&self, most: usize) -> Vec<DensePoint> {
        if most == 0 {
            return Vec::new();
        }
        fuse::thinned(&fuse::points(&self.views, &self.maps), most)
    }

    /// Whether nothing can be at a place, world units: it lies far nearer to a camera that sees it
    /// than anything of the scene, or before surfaces that two photographs are sure of.
    pub fn is_free(&self, place: [f32; 3]) -> bool {
        let place = DVec3::from(place.map(f64::from));
        let mut before = 0;
        for ((view, map), nearest) in self.views.iter().zip(&self.maps).zip(&self.nearest) {
            let Some((pixel, depth)) = view.camera.project(place) else {
                continue;
            };
            let (width, height) = view.size();
            let margin = MARGIN * width.max(height) as f64;
            let shown = pixel.x > -margin
                && pixel.y > -margin
                && pixel.x < width as f64 + margin
                && pixel.y < height as f64 + margin;
            if shown && nearest.is_some_and(|nearest| depth < NEARER * nearest) {
                return true;
            }
            match map.at(view, pixel) {
                Some(surface) if depth < BEFORE * surface => before += 1,
                Some(surface) if depth < surface / BEFORE => return false,
                _ => {}
            }
        }
        before >= SURE
    }
}

/// What is nearer to a camera than this share of the nearest plane is nothing of the scene.
const NEARER: f64 = 0.5;
/// How far beyond the border of a picture that holds, share of its longest side: what hangs before
/// a lens is large.
const MARGIN: f64 = 0.25;
/// What is nearer than this share of a surface's depth lies before it.
const BEFORE: f64 = 0.85;
/// Photographs that must be sure of what lies behind.
const SURE: usize = 2;

#[cfg(test)]
mod tests;
