//! The corrected cameras in the forms of other programs. Both forms are in the coordinates of
//! `scene.ply`, which lack an offset that `f32` cannot represent.

use std::fs;
use std::path::Path;

use glam::{DMat4, DVec3};
use serde_json::{Value, json};

use super::ExportError;
use super::archive::{Picture, pictures};
use crate::camera::{Camera, Intrinsics, NamedCamera, Split};
use crate::gaussians::ply;
use crate::run_folder::RunFolder;

/// Signs of the axes of OpenGL's cameras, whose y points up and z backward, relative to OpenCV's.
const OPENGL: DVec3 = DVec3::new(1.0, -1.0, -1.0);

/// The cameras of the delivered round or of a finished one.
pub(super) fn cameras(
    run: &RunFolder,
    round: Option<u32>,
) -> Result<Vec<NamedCamera>, ExportError> {
    let path = match round {
        Some(round) => run.round(round).cameras(),
        None => run.cameras(),
    };
    let text = fs::read(&path).map_err(ExportError::io(&path))?;
    serde_json::from_slice(&text).map_err(|source| ExportError::Cameras { path, source })
}

/// The cameras with their views' pictures; a view without one is useless for training.
pub(super) fn views(
    run: &RunFolder,
    round: Option<u32>,
) -> Result<Vec<(NamedCamera, Picture)>, ExportError> {
    let cameras = cameras(run, round)?;
    let pictures = pictures(run, round)?;
    let folder = pictures.first().and_then(|picture| picture.path.parent());
    let folder = folder.map(Path::to_owned).unwrap_or_default();
    let mut views = Vec::with_capacity(pictures.len());
    for picture in pictures {
        let stem = picture.path.file_stem().unwrap_or_default();
        let camera = cameras.iter().find(|camera| stem == camera.name.as_str());
        if let Some(camera) = camera {
            views.push((camera.clone(), picture));
        }
    }
    if views.is_empty() {
        return Err(ExportError::NoPictures(folder));
    }
    Ok(views)
}

/// A camera's rotation and centre, to the coordinates of `scene.ply`.
fn camera_to_scene(camera: &Camera, offset: DVec3) -> DMat4 {
    let centre = camera.centre() - offset;
    DMat4::from_mat3_translation(camera.rotation().transpose(), centre)
}

/// The `cameras.json` of Inria's 3D Gaussian splatting, which its viewers read: the axes of a
/// camera are the columns of `rotation`. It has no place for a principal point beside the middle.
pub(super) fn inria(run: &RunFolder, round: Option<u32>) -> Result<Value, ExportError> {
    let offset = ply::read_extent(&run.scene_of(round))?.normalisation.missing_in_files();
    let entry = |(id, named): (usize, NamedCamera)| {
        let Intrinsics { width, height, fx, fy, .. } = named.intrinsics;
        let to_scene = camera_to_scene(&named.camera(), offset);
        let [x, y, z, _] = to_scene.transpose().to_cols_array_2d();
        let rotation = [x, y, z].map(|row| [row[0], row[1], row[2]]);
        json!({
            "id": id,
            "img_name": named.name,
            "width": width,
            "height": height,
            "position": to_scene.w_axis.truncate().to_array(),
            "rotation": rotation,
            "fy": fy,
            "fx": fx,
        })
    };
    Ok(cameras(run, round)?.into_iter().enumerate().map(entry).collect())
}

/// nerfstudio's `transforms.json`, for the top of the result's folder: its pictures and its scene
/// are named from there. Views that were held out from training remain so.
pub(super) fn transforms(run: &RunFolder, round: Option<u32>) -> Result<Value, ExportError> {
    let scene = run.scene_of(round);
    let normalisation = ply::read_extent(&scene)?.normalisation;
    let offset = normalisation.missing_in_files();
    let views = views(run, round)?;
    let place = |path: &Path| {
        let below = path.strip_prefix(run.root()).unwrap_or(path);
        let parts = below.iter().map(|part| part.to_string_lossy());
        parts.collect::<Vec<_>>().join("/")
    };
    let first = views.first().map(|(camera, _)| camera.intrinsics);
    let is_shared = views.iter().all(|(camera, _)| Some(camera.intrinsics) == first);
    let mut document = match first {
        Some(shared) if is_shared => lens(&shared),
        _ => json!({}),
    };
    document["camera_model"] = "PINHOLE".into();
    document["ply_file_path"] = place(&scene).into();
    if normalisation.left_out {
        document["scene_offset"] = json!(offset.to_array());
    }
    let frame = |(camera, picture): &(NamedCamera, Picture)| {
        let to_scene = camera_to_scene(&camera.camera(), offset) * DMat4::from_scale(OPENGL);
        let mut frame = if is_shared { json!({}) } else { lens(&camera.intrinsics) };
        frame["file_path"] = place(&picture.path).into();
        frame["transform_matrix"] = json!(to_scene.transpose().to_cols_array_2d());
        frame
    };
    document["frames"] = views.iter().map(frame).collect();
    if views.iter().any(|(camera, _)| camera.split == Split::HeldOut) {
        // nerfstudio needs all three lists if there is one.
        let list = |split| -> Value {
            let of_split = views.iter().filter(|(camera, _)| camera.split == split);
            of_split.map(|(_, picture)| place(&picture.path)).collect()
        };
        document["train_filenames"] = list(Split::Train);
        document["val_filenames"] = list(Split::HeldOut);
        document["test_filenames"] = list(Split::HeldOut);
    }
    Ok(document)
}

/// nerfstudio's fields of a lens.
fn lens(k: &Intrinsics) -> Value {
    json!({ "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy, "w": k.width, "h": k.height })
}
