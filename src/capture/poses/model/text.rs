//! `cameras.txt`, `images.txt`, `points3D.txt`.

use std::fmt::Write as _;
use std::path::Path;
use std::str::{FromStr, SplitAsciiWhitespace};

use super::camera::{CameraModel, CameraRow, ModelCamera, read_of};
use super::rows::{ModelImage, ModelPoint, SparseModel};
use super::{UnreadCamera, file};
use crate::poses::{PoseFileError, text};

pub(super) fn read(dir: &Path) -> Result<(SparseModel, Vec<UnreadCamera>), PoseFileError> {
    let cameras = file(dir, "cameras.txt");
    let (cameras, unread) = read_of(&cameras, rows(&cameras, camera)?)?;
    let ids = { cameras.iter() }.map(|camera| camera.id);
    let ids: Vec<u32> = ids.chain(unread.iter().map(|camera| camera.id)).collect();
    let model = SparseModel {
        images: images(&file(dir, "images.txt"), &ids)?,
        points: super::points(dir, "points3D.txt", |file| rows(file, point))?,
        cameras,
    };
    Ok((model, unread))
}

/// A line being parsed, with its location for errors.
struct Fields<'a> {
    fields: SplitAsciiWhitespace<'a>,
    text: &'a str,
    file: &'a Path,
    line: usize,
}

impl<'a> Fields<'a> {
    fn new(text: &'a str, file: &'a Path, line: usize) -> Self {
        Self { fields: text.split_ascii_whitespace(), text, file, line }
    }

    fn fault(&self, what: &str) -> PoseFileError {
        PoseFileError::bad_file(self.file, format!("line {}: {what}", self.line))
    }

    fn word(&mut self) -> Result<&'a str, PoseFileError> {
        self.fields.next().ok_or_else(|| self.fault("too few fields"))
    }

    fn next<T: FromStr>(&mut self) -> Result<T, PoseFileError> {
        let word = self.word()?;
        // Windows writes -nan(ind) and 1.#QNAN.
        let is_nan = word.contains("nan") || word.contains("#QNAN") || word.contains("#IND");
        let number = if is_nan { "nan" } else { word };
        number.parse().map_err(|_| self.fault(&format!("`{word}` is not a number that fits")))
    }

    fn array<T: FromStr + Copy + Default, const N: usize>(
        &mut self,
    ) -> Result<[T; N], PoseFileError> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = self.next()?;
        }
        Ok(values)
    }

    /// The rest of the line unchanged: a name may contain blanks.
    fn remainder(&self) -> &'a str {
        match self.fields.clone().next() {
            // `SplitAsciiWhitespace::remainder` is not stable yet.
            Some(word) => {
                self.text[word.as_ptr() as usize - self.text.as_ptr() as usize..].trim_ascii_end()
            }
            None => "",
        }
    }

    /// The rest of the line, several values per row.
    fn rest<T>(
        &mut self,
        row: impl Fn(&mut Self) -> Result<T, PoseFileError>,
    ) -> Result<Vec<T>, PoseFileError> {
        let mut rows = Vec::new();
        while self.fields.clone().next().is_some() {
            rows.push(row(self)?);
        }
        Ok(rows)
    }
}

fn is_comment(line: &str) -> bool {
    line.trim_ascii_start().starts_with('#')
}

fn rows<T>(
    file: &Path,
    row: impl Fn(&mut Fields<'_>) -> Result<T, PoseFileError>,
) -> Result<Vec<T>, PoseFileError> {
    let text = text::read(file)?;
    let lines =
        text.lines().enumerate().filter(|(_, l)| !is_comment(l) && !l.trim_ascii().is_empty());
    lines.map(|(index, line)| row(&mut Fields::new(line, file, index + 1))).collect()
}

fn camera(fields: &mut Fields<'_>) -> Result<CameraRow, PoseFileError> {
    let id = fields.next()?;
    let name = fields.word()?;
    let Some(model) = CameraModel::from_name(name) else {
        let reason = CameraModel::unread(name);
        return Ok(Err(UnreadCamera { id, reason }));
    };
    let (width, height) = (fields.next()?, fields.next()?);
    let params = fields.rest(Fields::next)?;
    if params.len() != model.parameters() {
        return Err(fields.fault(&format!(
            "{name} has {} parameters, not {}",
            model.parameters(),
            params.len()
        )));
    }
    Ok(Ok(ModelCamera { id, model, width, height, params }))
}

/// Two lines per image; the second, the keypoints, may be empty, and some programs omit it.
fn images(file: &Path, cameras: &[u32]) -> Result<Vec<ModelImage>, PoseFileError> {
    let text = text::read(file)?;
    let mut lines = text.lines().enumerate().peekable();
    let mut images = Vec::new();
    while let Some((index, line)) = lines.next() {
        if is_comment(line) || line.trim_ascii().is_empty() {
            continue;
        }
        let mut image = image(&mut Fields::new(line, file, index + 1))?;
        let is_next = |line: &str| begins_an_image(&mut Fields::new(line, file, 0), cameras);
        if let Some((index, line)) = lines.next_if(|(_, line)| !is_next(line)) {
            let keypoints = Fields::new(line, file, index + 1).rest(|fields| {
                let (x, y, point): (f64, f64, i64) =
                    (fields.next()?, fields.next()?, fields.next()?);
                Ok((x, y, u64::try_from(point).ok()))
            });
            image.keypoints = keypoints.map_err(|error| match error {
                PoseFileError::BadFile { file, reason } => {
                    let name = &image.name;
                    let line =
                        format!("the line after {name} holds its key points, or is left out");
                    PoseFileError::bad_file(&file, format!("{reason}: {line}"))
                }
                error => error,
            })?;
        }
        images.push(image);
    }
    Ok(images)
}

/// The first line of an image.
fn image(fields: &mut Fields<'_>) -> Result<ModelImage, PoseFileError> {
    let id = fields.next()?;
    let (rotation, translation) = (fields.array()?, fields.array()?);
    let camera_id = fields.next()?;
    let name = fields.remainder().to_owned();
    if name.is_empty() {
        return Err(fields.fault("an image without a name"));
    }
    Ok(ModelImage { id, rotation, translation, camera_id, name, keypoints: Vec::new() })
}

/// Whether the line after an image's first line begins the next image: pixels are not a unit
/// quaternion followed by a camera's number.
fn begins_an_image(fields: &mut Fields<'_>, cameras: &[u32]) -> bool {
    image(fields).is_ok_and(|image| {
        let norm: f64 = image.rotation.iter().map(|q| q * q).sum();
        let is_unit = norm.is_nan() || (norm - 1.0).abs() < 0.1;
        is_unit && cameras.contains(&image.camera_id)
    })
}

fn point(fields: &mut Fields<'_>) -> Result<ModelPoint, PoseFileError> {
    Ok(ModelPoint {
        id: fields.next()?,
        position: fields.array()?,
        colour: fields.array()?,
        error: fields.next()?,
        track: fields.rest(|fields| Ok((fields.next()?, fields.next()?)))?,
    })
}

pub(super) fn write(model: &SparseModel, dir: &Path) -> Result<(), PoseFileError> {
    std::fs::create_dir_all(dir).map_err(PoseFileError::io(dir))?;
    for (name, text) in files(model) {
        let file = dir.join(name);
        std::fs::write(&file, text).map_err(PoseFileError::io(&file))?;
    }
    Ok(())
}

/// The three files, by name.
pub(super) fn files(model: &SparseModel) -> [(&'static str, String); 3] {
    let cameras =
        format_rows("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", &model.cameras, |out, c| {
            let _ = write!(out, "{} {} {} {}", c.id, c.model.name(), c.width, c.height);
            for p in &c.params {
                let _ = write!(out, " {p}");
            }
        });
    let header = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)";
    let images = format_rows(header, &model.images, |out, i| {
        let ([w, x, y, z], [a, b, c]) = (i.rotation, i.translation);
        let _ = writeln!(out, "{} {w} {x} {y} {z} {a} {b} {c} {} {}", i.id, i.camera_id, i.name);
        let keypoint = |(x, y, point): &(f64, f64, Option<u64>)| match point {
            Some(point) => format!("{x} {y} {point}"),
            None => format!("{x} {y} -1"),
        };
        out.push_str(&i.keypoints.iter().map(keypoint).collect::<Vec<_>>().join(" "));
    });
    let header = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)";
    let points = format_rows(header, &model.points, |out, p| {
        let ([x, y, z], [r, g, b]) = (p.position, p.colour);
        let _ = write!(out, "{} {x} {y} {z} {r} {g} {b} {}", p.id, p.error);
        for (image, index) in &p.track {
            let _ = write!(out, " {image} {index}");
        }
    });
    [("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", points)]
}

fn format_rows<T>(header: &str, rows: &[T], row: impl Fn(&mut String, &T)) -> String {
    let mut out = format!("{header}\n");
    for item in rows {
        row(&mut out, item);
        out.push('\n');
    }
    out
}
