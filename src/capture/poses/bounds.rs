//! LLFF's `poses_bounds.npy`: f64 or f32 [B, 17]; a row is the 3x5 matrix [R | t | (height, width,
//! focal)] row-major, then near and far depth. R and t go from camera to world; R's columns are
//! the camera's down, right and backward axes.

use std::fs;
use std::path::Path;

use glam::{DMat3, DMat4, DVec3};

use super::npy::Table;
use super::{PoseFileError, rotation};
use crate::camera::{Camera, Intrinsics};

/// Columns of the file.
const COLUMNS: usize = 17;
/// Larger than any capture's file, bytes: half a million cameras.
const LARGEST: u64 = 64 << 20;

/// A camera with the depth range of its scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundedCamera {
    /// The camera; one focal length, the principal point in the centre.
    pub camera: Camera,
    /// Nearest depth, world units. Some files have impossible depths.
    pub near: f64,
    /// Farthest depth, world units.
    pub far: f64,
}

/// Reads the rows, which belong to the photographs in the order of their file names; for an invalid
/// row, the reason.
///
/// # Errors
/// [`PoseFileError::BadFile`] if it is not such an array or no row is a camera.
pub fn read_poses_bounds(file: &Path) -> Result<Vec<Result<BoundedCamera, String>>, PoseFileError> {
    let bad_file = |reason: String| PoseFileError::bad_file(file, reason);
    let length = fs::metadata(file).map_err(PoseFileError::io(file))?.len();
    if length > LARGEST {
        let reason = format!("{length} bytes, more than any capture has cameras for");
        return Err(bad_file(reason));
    }
    let bytes = fs::read(file).map_err(PoseFileError::io(file))?;
    let table = Table::parse(&bytes).map_err(|reason| {
        bad_file(format!("{reason}; save rows of {COLUMNS} numbers by numpy.save"))
    })?;
    if table.columns != COLUMNS {
        let reason = format!("rows of {} numbers instead of {COLUMNS}", table.columns);
        return Err(bad_file(reason));
    }
    let rows: Vec<_> = table.rows().map(camera).collect();
    match rows.iter().position(Result::is_ok) {
        None if !rows.is_empty() => {
            let first = rows.into_iter().find_map(Result::err).unwrap_or_default();
            Err(bad_file(format!("no row is a camera; row 0 {first}")))
        }
        _ => Ok(rows),
    }
}

fn camera(row: &[f64]) -> Result<BoundedCamera, String> {
    let (near, far) = (row[15], row[16]);
    if !row[..15].iter().all(|v| v.is_finite()) {
        return Err("holds NaN or infinity".to_owned());
    }
    let column = |c: usize| DVec3::new(row[c], row[5 + c], row[10 + c]);
    let (down, right, backward) = (column(0), column(1), column(2));
    let (height, width, focal) = (row[4], row[9], row[14]);
    if !((1.0..1e6).contains(&width) && (1.0..1e6).contains(&height) && focal > 0.0) {
        return Err(format!(
            "has a picture of {width} x {height} px and a focal length of {focal}"
        ));
    }
    let axes = rotation(DMat3::from_cols(right, down, -backward));
    let axes = axes.map_err(|what| format!("has a matrix that {what}"))?;
    if axes.is_mended {
        return Err(format!(
            "has a rotation that is scaled by {:.4} or rounded: write its columns of length 1",
            axes.scale
        ));
    }
    let rotation = axes.matrix.transpose();
    let mut world_to_camera = DMat4::from_mat3(rotation);
    world_to_camera.w_axis = (-(rotation * column(3))).extend(1.0);
    let intrinsics = Intrinsics {
        width: width.round() as usize,
        height: height.round() as usize,
        fx: focal,
        fy: focal,
        cx: 0.5 * width,
        cy: 0.5 * height,
    };
    Ok(BoundedCamera { camera: Camera { intrinsics, world_to_camera }, near, far })
}

/// Writes the rows.
///
/// # Errors
/// [`PoseFileError::BadFile`] if the file cannot be written.
pub fn write_poses_bounds(file: &Path, rows: &[BoundedCamera]) -> Result<(), PoseFileError> {
    let mut values = vec![0.0; rows.len() * COLUMNS];
    for (row, BoundedCamera { camera, near, far }) in values.chunks_exact_mut(COLUMNS).zip(rows) {
        let axes = camera.rotation().transpose();
        let k = &camera.intrinsics;
        let size = DVec3::new(k.height as f64, k.width as f64, k.fx);
        for (column, value) in
            [axes.y_axis, axes.x_axis, -axes.z_axis, camera.centre(), size].into_iter().enumerate()
        {
            for line in 0..3 {
                row[5 * line + column] = value[line];
            }
        }
        (row[15], row[16]) = (*near, *far);
    }
    let table = Table { columns: COLUMNS, values };
    fs::write(file, table.to_bytes()).map_err(PoseFileError::io(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> BoundedCamera {
        let k = Intrinsics { width: 320, height: 180, fx: 277.0, fy: 277.0, cx: 160.0, cy: 90.0 };
        let camera =
            Camera::look_at(k, DVec3::new(1.0, -2.0, -5.0), DVec3::new(0.2, 0.0, 1.0), DVec3::Y);
        BoundedCamera { camera, near: 1.5, far: 9.0 }
    }

    #[test]
    fn cameras_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("poses_bounds.npy");
        write_poses_bounds(&file, &[row(), row()]).unwrap();
        let read = read_poses_bounds(&file).unwrap();
        assert_eq!(read.len(), 2);
        let second = read[1].clone().unwrap();
        assert_eq!(second.camera.intrinsics, row().camera.intrinsics);
        assert!(second.camera.world_to_camera.abs_diff_eq(row().camera.world_to_camera, 1e-12));
    }

    #[test]
    fn the_columns_are_down_right_and_backward() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("poses_bounds.npy");
        write_poses_bounds(&file, &[row()]).unwrap();
        let written = Table::parse(&fs::read(&file).unwrap()).unwrap().values;
        let down = DVec3::new(written[0], written[5], written[10]);
        let backward = DVec3::new(written[2], written[7], written[12]);
        assert!((down - row().camera.down()).length() < 1e-12);
        assert!((backward + row().camera.forward()).length() < 1e-12);
        assert_eq!((written[4], written[9], written[14]), (180.0, 320.0, 277.0));
    }

    #[test]
    fn a_header_that_exceeds_the_data_allocates_no_memory() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("poses_bounds.npy");
        write_poses_bounds(&file, &[row()]).unwrap();
        let good = fs::read(&file).unwrap();
        let refused = |bytes: &[u8]| {
            fs::write(&file, bytes).unwrap();
            read_poses_bounds(&file).is_err()
        };
        assert!(!refused(&good));
        // 2^50 rows, in place of one and of the padding at the header's end.
        let (one, many) = (&b"(1, 17)"[..], &b"(1125899906842624, 17)"[..]);
        let at = good.windows(7).position(|part| part == one).unwrap();
        let end = good.iter().position(|&byte| byte == b'\n').unwrap();
        let rest = &good[at + one.len()..end - (many.len() - one.len())];
        let absurd = [&good[..at], many, rest, &good[end..]].concat();
        assert_eq!(absurd.len(), good.len());
        assert!(refused(&absurd));
        // A header of 4 GiB.
        let mut long = good.clone();
        long[6] = 2;
        long[8..12].fill(0xff);
        assert!(refused(&long));
        for length in [0, 5, 9, 11, good.len() - 1] {
            assert!(refused(&good[..length]), "{length} bytes");
        }
    }

    #[test]
    fn a_mirrored_rotation_and_a_wrong_shape_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("poses_bounds.npy");
        write_poses_bounds(&file, &[row()]).unwrap();
        let mut table = Table::parse(&fs::read(&file).unwrap()).unwrap();
        for line in 0..3 {
            table.values[5 * line] *= -1.0;
        }
        fs::write(&file, table.to_bytes()).unwrap();
        assert!(read_poses_bounds(&file).unwrap_err().to_string().contains("row 0"));
        let narrow = Table { columns: 15, values: vec![0.0; 30] };
        fs::write(&file, narrow.to_bytes()).unwrap();
        let message = read_poses_bounds(&file).unwrap_err().to_string();
        assert!(message.contains("15") && message.starts_with("poses_bounds.npy:"), "{message}");
    }
}
