//! Given poses assigned to their photographs.

use std::collections::HashMap;

use glam::DMat4;

use super::Given;
use super::doubt::{doubt_of_lens, doubt_of_points, doubt_of_size};
use super::given_view::GivenView;
use super::upright::{Upright, upright};
use crate::camera::Camera;
use crate::capture::CaptureView;
use crate::image::read_header;
use crate::photo_path::PhotoPath;
use crate::poses::turn::mirror;
use crate::poses::{LeftOut, PoseFileError, PosedView, SparsePoint};

/// Given poses in pixels of the upright photographs.
#[derive(Default)]
pub(super) struct Placed {
    pub(super) views: Vec<PosedView>,
    pub(super) bounds: Vec<Option<(f64, f64)>>,
    /// Names of the views that the poses hold out from training.
    pub(super) held_out: Vec<String>,
    /// Names of the photographs whose poses were rotated with them, and those of them whose sizes
    /// do not prove that this was necessary.
    pub(super) turned: Vec<String>,
    pub(super) assumed: Vec<String>,
    /// Poses used unchanged that are unlikely to be right.
    pub(super) doubts: Vec<LeftOut>,
}

impl Placed {
    /// If all photographs were mirrored, so was the world in which they were computed, including
    /// `given.points`: both are mirrored back. This is impossible if only some were.
    pub(super) fn of(
        photographs: &[CaptureView],
        of_photograph: &HashMap<&PhotoPath, &GivenView>,
        given: &mut Given,
    ) -> Result<Self, PoseFileError> {
        let mut upright_views = Vec::new();
        for view in photographs {
            let Some(&given_view) = of_photograph.get(&view.path) else {
                continue;
            };
            let header = read_header(&view.file)
                .map_err(|error| PoseFileError::bad_file(&view.file, error.to_string()))?;
            match upright(given_view, &header) {
                Ok(upright) => upright_views.push((view, given_view, upright)),
                Err(reason) => given.left_out.push(LeftOut::new(view.path.as_str(), reason)),
            }
        }
        let is_mirrored = |(_, _, upright): &(_, _, Upright)| upright.turn.is_mirrored();
        let world = match upright_views.iter().all(is_mirrored) {
            true => mirror(),
            false => DMat4::IDENTITY,
        };
        for point in &mut given.points {
            point.position = world.transform_point3(point.position.into()).to_array();
        }
        let mut placed = Self::default();
        for (view, given_view, upright) in upright_views {
            if upright.turn.is_mirrored() && world == DMat4::IDENTITY {
                let reason = "it is stored mirrored (EXIF orientation 2, 4, 5 or 7) and others are \
                              not: store all upright, and compute the poses again";
                given.left_out.push(LeftOut::new(view.path.as_str(), reason));
                continue;
            }
            placed.push(view, given_view, &upright, world, &given.points);
        }
        Ok(placed)
    }

    fn push(
        &mut self,
        view: &CaptureView,
        given: &GivenView,
        upright: &Upright,
        world: DMat4,
        points: &[SparsePoint],
    ) {
        if given.held_out {
            self.held_out.push(view.name.clone());
        }
        if !upright.turn.is_none() {
            self.turned.push(view.path.to_string());
        }
        if upright.is_assumed {
            self.assumed.push(view.path.to_string());
        }
        let posed = PosedView {
            name: view.name.clone(),
            camera: Camera {
                intrinsics: upright.lens.pinhole(),
                world_to_camera: upright.world_to_camera * world,
            },
            lens: upright.lens,
        };
        let doubts = [
            doubt_of_lens(&upright.lens),
            doubt_of_size(given, upright),
            doubt_of_points(&posed, points),
        ];
        let doubts = doubts.into_iter().flatten();
        let doubts = doubts.map(|reason| LeftOut::new(view.path.as_str(), reason));
        self.doubts.extend(doubts);
        self.bounds.push(given.bounds);
        self.views.push(posed);
    }
}
