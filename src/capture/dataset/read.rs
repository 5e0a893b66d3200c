//! The contents of each format.

use std::path::Path;

use super::given_view::GivenView;
use super::transforms::{self, Transforms};
use super::{Assignment, Given};
use crate::photo_path::PhotoPath;
use crate::poses::bounds::{BoundedCamera, read_poses_bounds};
use crate::poses::model::{ModelImage, SparseModel};
use crate::poses::{Distortion, LeftOut, Lens, PoseFileError};

pub(super) fn model(dir: &Path) -> Result<(Assignment, Given), PoseFileError> {
    let (model, left_out) = SparseModel::read_usable(dir)?;
    let view = |image: &ModelImage| GivenView {
        lens: model.camera_of(image).lens().into(),
        world_to_camera: image.world_to_camera(),
        bounds: None,
        held_out: false,
    };
    let views = model.images.iter().map(|image| (&image.name, Some(view(image))));
    let views = views.chain(left_out.iter().map(|left_out| (&left_out.name, None)));
    let views = views.map(|(name, view)| (PhotoPath::new(name), view));
    let given = Given {
        points: model.sparse_points(),
        mean_error: model.mean_error().filter(|error| error.is_finite()),
        mean_track: model.mean_track(),
        ..Given::default()
    };
    let views = Assignment::ByPath(views.collect());
    Ok((views, Given { left_out, ..given }))
}

pub(super) fn transforms(file: &Path) -> Result<(Assignment, Given), PoseFileError> {
    let Transforms { views, left_out, warnings } = transforms::read(file)?;
    let given = Given { left_out, warnings, ..Given::default() };
    Ok((Assignment::ByPath(views), given))
}

pub(super) fn poses_bounds(file: &Path) -> Result<(Assignment, Given), PoseFileError> {
    let view = |row: &BoundedCamera| GivenView {
        lens: Lens { intrinsics: row.camera.intrinsics, distortion: Distortion::None }.into(),
        world_to_camera: row.camera.world_to_camera,
        // Used only as the range for points.
        bounds: Some((row.near, row.far))
            .filter(|(near, far)| *near > 0.0 && far > near && far.is_finite()),
        held_out: false,
    };
    let (mut views, mut given) = (Vec::new(), Given::default());
    for (index, row) in read_poses_bounds(file)?.into_iter().enumerate() {
        views.push(row.as_ref().map(view).ok());
        if let Err(reason) = row {
            let left_out = LeftOut::new(format!("row {index}"), format!("it {reason}"));
            given.left_out.push(left_out);
        }
    }
    Ok((Assignment::ByOrder(views), given))
}
