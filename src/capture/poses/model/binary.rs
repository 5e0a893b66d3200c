//! `cameras.bin`, `images.bin`, `points3D.bin`: little-endian, counts first.

use std::path::Path;

use super::camera::{CameraModel, CameraRow, ModelCamera, read_of};
use super::rows::{ModelImage, ModelPoint, SparseModel};
use super::{UnreadCamera, file};
use crate::photo_path::decoded;
use crate::poses::{PoseFileError, text};

/// COLMAP's value for a keypoint without a point.
const NO_POINT: u64 = u64::MAX;

/// Later camera models have numbers and parameter counts in these ranges.
const LATER_NUMBERS: std::ops::Range<i32> = 0..100;
const LATER_PARAMETERS: u64 = 32;

/// Largest side of a camera, px, in a file with such models: misaligned reads give larger ones.
const LARGEST_SIDE: usize = 1 << 24;

pub(super) fn read(dir: &Path) -> Result<(SparseModel, Vec<UnreadCamera>), PoseFileError> {
    let cameras = file(dir, "cameras.bin");
    let (cameras, unread) = read_of(&cameras, camera_rows(&cameras)?)?;
    let model = SparseModel {
        cameras,
        images: rows(&file(dir, "images.bin"), image)?,
        points: super::points(dir, "points3D.bin", |file| rows(file, point))?,
    };
    Ok((model, unread))
}

/// Bytes being parsed. Counts in the file are never trusted for allocation: the bytes run out
/// first.
struct Bytes<'a> {
    left: &'a [u8],
    file: &'a Path,
}

impl<'a> Bytes<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], PoseFileError> {
        let (head, tail) = self
            .left
            .split_first_chunk::<N>()
            .ok_or_else(|| PoseFileError::bad_file(self.file, "the file is cut short"))?;
        self.left = tail;
        Ok(*head)
    }

    fn u32(&mut self) -> Result<u32, PoseFileError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, PoseFileError> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, PoseFileError> {
        self.take().map(f64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], PoseFileError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    fn many<T>(
        &mut self,
        count: u64,
        row: impl Fn(&mut Self) -> Result<T, PoseFileError>,
    ) -> Result<Vec<T>, PoseFileError> {
        (0..count).map(|_| row(self)).collect()
    }

    fn text(&mut self) -> Result<String, PoseFileError> {
        let end = self.left.iter().position(|&byte| byte == 0);
        let end = end.ok_or_else(|| PoseFileError::bad_file(self.file, "a name without an end"))?;
        let name = decoded(&self.left[..end]);
        self.left = &self.left[end + 1..];
        Ok(name)
    }
}

/// The rows of `cameras.bin`. For an unknown later camera model, the parameter count is the one
/// that makes the file end with its last camera; if several counts do, the file is unreadable.
fn camera_rows(file: &Path) -> Result<Vec<CameraRow>, PoseFileError> {
    let content = text::bytes(file)?;
    let read = |later: Option<u64>| -> Result<(Vec<CameraRow>, bool), PoseFileError> {
        let mut bytes = Bytes { left: &content, file };
        let count = bytes.u64()?;
        Ok((bytes.many(count, |bytes| camera(bytes, later))?, bytes.left.is_empty()))
    };
    let error = match read(None) {
        Ok((rows, _)) => return Ok(rows),
        Err(error) => error,
    };
    let fit = (0..=LATER_PARAMETERS).filter_map(|count| read(Some(count)).ok());
    let mut fit = fit.filter(|(_, ends)| *ends);
    match (fit.next(), fit.next()) {
        (Some((rows, _)), None) => Ok(rows),
        _ => Err(error),
    }
}

fn rows<T>(
    file: &Path,
    row: impl Fn(&mut Bytes<'_>) -> Result<T, PoseFileError>,
) -> Result<Vec<T>, PoseFileError> {
    let content = text::bytes(file)?;
    let mut bytes = Bytes { left: &content, file };
    let count = bytes.u64()?;
    bytes.many(count, row)
}

/// A row; `later` is the parameter count of unknown models.
fn camera(bytes: &mut Bytes<'_>, later: Option<u64>) -> Result<CameraRow, PoseFileError> {
    let id = bytes.u32()?;
    let number = i32::from_le_bytes(bytes.take()?);
    let (width, height) = (bytes.u64()? as usize, bytes.u64()? as usize);
    if later.is_some() && width.max(height) > LARGEST_SIDE {
        return Err(PoseFileError::bad_file(bytes.file, format!("camera {id} has no usable size")));
    }
    let Some(model) = CameraModel::from_number(number) else {
        let (name, parameters) = CameraModel::unread_name(number);
        let reason = CameraModel::unread(&name);
        let later = later.filter(|_| LATER_NUMBERS.contains(&number));
        // If their count is unknown, everything after them is.
        let skipped = parameters.or(later).and_then(|count| bytes.many(count, Bytes::f64).ok());
        return match skipped {
            Some(_) => Ok(Err(UnreadCamera { id, reason })),
            None => Err(PoseFileError::bad_file(bytes.file, reason)),
        };
    };
    let params = bytes.many(model.parameters() as u64, Bytes::f64)?;
    Ok(Ok(ModelCamera { id, model, width, height, params }))
}

fn image(bytes: &mut Bytes<'_>) -> Result<ModelImage, PoseFileError> {
    let id = bytes.u32()?;
    let (rotation, translation) = (bytes.f64s()?, bytes.f64s()?);
    let camera_id = bytes.u32()?;
    let name = bytes.text()?;
    let count = bytes.u64()?;
    let keypoints = bytes.many(count, |bytes| {
        let (x, y, point) = (bytes.f64()?, bytes.f64()?, bytes.u64()?);
        Ok((x, y, (point != NO_POINT).then_some(point)))
    })?;
    Ok(ModelImage { id, rotation, translation, camera_id, name, keypoints })
}

fn point(bytes: &mut Bytes<'_>) -> Result<ModelPoint, PoseFileError> {
    let id = bytes.u64()?;
    let position = bytes.f64s()?;
    let colour = bytes.take()?;
    let error = bytes.f64()?;
    let count = bytes.u64()?;
    let track = bytes.many(count, |bytes| Ok((bytes.u32()?, bytes.u32()?)))?;
    Ok(ModelPoint { id, position, colour, error, track })
}

pub(super) fn write(model: &SparseModel, dir: &Path) -> Result<(), PoseFileError> {
    std::fs::create_dir_all(dir).map_err(PoseFileError::io(dir))?;
    save(&dir.join("cameras.bin"), &model.cameras, |out, c| {
        out.extend(c.id.to_le_bytes());
        out.extend(c.model.number().to_le_bytes());
        out.extend((c.width as u64).to_le_bytes());
        out.extend((c.height as u64).to_le_bytes());
        extend(out, &c.params);
    })?;
    save(&dir.join("images.bin"), &model.images, |out, i| {
        out.extend(i.id.to_le_bytes());
        extend(out, &i.rotation);
        extend(out, &i.translation);
        out.extend(i.camera_id.to_le_bytes());
        out.extend(i.name.as_bytes());
        out.push(0);
        out.extend((i.keypoints.len() as u64).to_le_bytes());
        for (x, y, point) in &i.keypoints {
            extend(out, &[*x, *y]);
            out.extend(point.unwrap_or(NO_POINT).to_le_bytes());
        }
    })?;
    save(&dir.join("points3D.bin"), &model.points, |out, p| {
        out.extend(p.id.to_le_bytes());
        extend(out, &p.position);
        out.extend(p.colour);
        out.extend(p.error.to_le_bytes());
        out.extend((p.track.len() as u64).to_le_bytes());
        for (image, index) in &p.track {
            out.extend(image.to_le_bytes());
            out.extend(index.to_le_bytes());
        }
    })
}

fn extend(out: &mut Vec<u8>, values: &[f64]) {
    values.iter().for_each(|value| out.extend(value.to_le_bytes()));
}

fn save<T>(file: &Path, rows: &[T], row: impl Fn(&mut Vec<u8>, &T)) -> Result<(), PoseFileError> {
    let mut out = (rows.len() as u64).to_le_bytes().to_vec();
    rows.iter().for_each(|item| row(&mut out, item));
    std::fs::write(file, out).map_err(PoseFileError::io(file))
}
