//! NeRF's `transforms.json`: camera-to-world matrices with OpenGL axes (x right, y up, z
//! backward), intrinsics for all frames or frame by frame. `transforms_train.json` is read with its
//! `_test` and `_val`.

mod json;
mod masks;
mod optics;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::{DMat3, DMat4, DVec3};
use serde_json::Value;

use super::given_view::GivenView;
use crate::photo_path::PhotoPath;
use crate::poses::left_out::{LeftOut, in_words};
use crate::poses::{PoseFileError, Rotation, rotation};
use json::{Fields, Object};
pub use masks::masks;

/// Suffixes of the file names if there is one per split, and whether its views train.
const SPLITS: [(&str, bool); 3] = [("_train", true), ("_val", false), ("_test", false)];

/// The contents of the files.
#[derive(Default)]
pub(super) struct Transforms {
    /// The frames by `file_path`; `None` for a frame that is left out.
    pub(super) views: Vec<(PhotoPath, Option<GivenView>)>,
    pub(super) left_out: Vec<LeftOut>,
    pub(super) warnings: Vec<String>,
}

/// Reads a file, and the other splits beside it.
///
/// # Errors
/// [`PoseFileError`] if a file cannot be read, or no frame is usable.
pub(super) fn read(file: &Path) -> Result<Transforms, PoseFileError> {
    let mut all = Transforms::default();
    let mut mended = Vec::new();
    for (file, trains) in files(file)? {
        all.add(&file, trains, &mut mended)?;
    }
    if all.views.iter().all(|(_, view)| view.is_none()) && !all.left_out.is_empty() {
        return Err(PoseFileError::bad_file(file, in_words(&all.left_out)));
    }
    if let Some((name, rotation)) = mended.first() {
        let count = mended.len();
        let Rotation { scale, .. } = rotation;
        all.warnings.push(format!(
            "`transform_matrix` of {count} frames holds a rotation that is scaled or rounded, the \
             first is {name} with a scale of {scale:.4}: the nearest rotation is taken"
        ));
    }
    Ok(all)
}

/// The file, or all splits if its name contains one, and whether their frames train.
fn files(file: &Path) -> Result<Vec<(PathBuf, bool)>, PoseFileError> {
    let stem = |path: &Path| {
        let stem = path.file_stem().unwrap_or_default();
        stem.to_string_lossy().to_lowercase()
    };
    let own = stem(file);
    let Some((base, _)) =
        SPLITS.iter().find_map(|(end, trains)| Some((own.strip_suffix(*end)?, trains)))
    else {
        return Ok(vec![(file.to_owned(), true)]);
    };
    let folder = file.parent().unwrap_or(Path::new(""));
    let mut found = Vec::new();
    for entry in folder.read_dir().map_err(PoseFileError::io(folder))? {
        let path = entry.map_err(PoseFileError::io(folder))?.path();
        let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
        let split = SPLITS.iter().position(|(end, _)| stem(&path) == format!("{base}{end}"));
        if let (true, Some(split)) = (is_json, split) {
            found.push((split, path));
        }
    }
    found.sort();
    Ok(found.into_iter().map(|(split, path)| (path, SPLITS[split].1)).collect())
}

impl Transforms {
    fn add(
        &mut self,
        file: &Path,
        trains: bool,
        mended: &mut Vec<(String, Rotation)>,
    ) -> Result<(), PoseFileError> {
        let content = json::read(file)?;
        let Some(Value::Array(frames)) = content.get("frames") else {
            return Err(PoseFileError::bad_file(file, "it has no list of `frames`"));
        };
        let held_out = held_out(&content);
        for (index, frame) in frames.iter().enumerate() {
            let name = frame.get("file_path").and_then(Value::as_str);
            let outcome = name.ok_or_else(|| "it has no `file_path`".to_owned()).and_then(|name| {
                let own = frame.as_object().expect("it has a field");
                let (view, rotation) = view(&Fields::new(own, &content))?;
                Ok((name.to_owned(), view, rotation))
            });
            match outcome {
                Ok((name, view, rotation)) => {
                    let held_out = !trains || held_out.contains(&*name);
                    if rotation.is_mended {
                        mended.push((name.clone(), rotation));
                    }
                    let view = GivenView { held_out, ..view };
                    self.views.push((PhotoPath::new(&name), Some(view)));
                }
                Err(reason) => {
                    self.views.extend(name.map(|name| (PhotoPath::new(name), None)));
                    let name = name.map_or_else(|| format!("frame {index}"), ToOwned::to_owned);
                    self.left_out.push(LeftOut::new(name, reason));
                }
            }
        }
        self.warn_of_unused(file, &content, frames);
        Ok(())
    }

    /// Fisheye lenses have no tangential terms.
    fn warn_of_unused(&mut self, file: &Path, content: &Object, frames: &[Value]) {
        let is_unused = |frame: &Value| {
            let own = frame.as_object();
            own.is_some_and(|own| optics::has_unused_terms(&Fields::new(own, content)))
        };
        if frames.iter().any(is_unused) {
            self.warnings.push(format!(
                "{}: `p1` and `p2` of a fisheye lens are not used",
                crate::poses::name_of(file)
            ));
        }
    }
}

/// The `file_path`s that nerfstudio's lists hold out from training.
fn held_out(content: &Object) -> HashSet<&str> {
    let list = |key: &str| -> HashSet<&str> {
        let names = content.get(key).and_then(Value::as_array);
        names.into_iter().flatten().filter_map(Value::as_str).collect()
    };
    let mut names = list("test_filenames");
    names.extend(list("val_filenames"));
    let trained = list("train_filenames");
    names.retain(|name| !trained.contains(name));
    names
}

/// Signs of the camera's axes relative to OpenCV's. OpenGL's point up and backward; instant-ngp and
/// NeuS2 mark files with OpenCV's axes and with Mitsuba's, which point left and up.
fn flip(fields: &Fields<'_>) -> DVec3 {
    if fields.is_set("from_na") {
        DVec3::ONE
    } else if fields.is_set("from_mitsuba") || fields.is_set("normal_mts_args") {
        DVec3::new(-1.0, -1.0, 1.0)
    } else {
        DVec3::new(1.0, -1.0, -1.0)
    }
}

fn view(fields: &Fields<'_>) -> Result<(GivenView, Rotation), String> {
    let lens = optics::lens(fields)?;
    let (rotation, centre) = pose(fields)?;
    let camera_to_world = DMat4::from_mat3_translation(rotation.matrix, centre);
    let flip = DMat4::from_scale(flip(fields));
    let view = GivenView {
        lens,
        world_to_camera: (camera_to_world * flip).inverse(),
        bounds: None,
        held_out: false,
    };
    Ok((view, rotation))
}

/// The camera's axes and position.
fn pose(fields: &Fields<'_>) -> Result<(Rotation, DVec3), String> {
    let of = |what: &str| format!("`transform_matrix` {what}");
    let rows = fields.own("transform_matrix").and_then(Value::as_array);
    let rows = rows.ok_or_else(|| of("is missing"))?;
    let numbers = |row: &Value| -> Option<[f64; 4]> {
        let row: Option<Vec<f64>> = row.as_array()?.iter().map(json::number).collect();
        row?.try_into().ok()
    };
    let rows: Option<Vec<[f64; 4]>> = rows.iter().map(numbers).collect();
    let rows = rows.filter(|rows| rows.len() == 3 || rows.len() == 4);
    let rows = rows.ok_or_else(|| of("is not of 3 or 4 rows of 4 numbers"))?;
    if rows.iter().flatten().any(|v| !v.is_finite()) {
        return Err(of("holds NaN or infinity"));
    }
    if let Some(&[x, y, z, w]) = rows.get(3)
        && [x, y, z, w - 1.0].iter().any(|v| v.abs() > 1e-3)
    {
        return Err(of("has another last row than 0 0 0 1: is it written by columns?"));
    }
    let axes = DMat3::from_cols_array_2d(&[0, 1, 2].map(|c| [rows[0][c], rows[1][c], rows[2][c]]));
    let rotation = rotation(axes).map_err(|what| of(&what))?;
    Ok((rotation, DVec3::new(rows[0][3], rows[1][3], rows[2][3])))
}
