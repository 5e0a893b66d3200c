//! Scenes as PLY files in the layout of 3DGS viewers: binary little endian, quaternions w x y z,
//! opacity as a logit, scales as logarithms, higher harmonics channel-major.
//!
//! The files are in the world of the poses, less an offset that `f32` cannot represent. Header
//! comments give the offset and the scene's [normalisation](Normalisation).

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::Gaussians;
use crate::camera::normalisation::Normalisation;

/// A PLY file that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum PlyError {
    /// Reading or writing failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not a scene of Gaussians.
    #[error("{path}: {message}")]
    Format {
        /// The file.
        path: PathBuf,
        /// The fault.
        message: String,
    },
}

/// A trained scene and the normalisation of its world.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// As trained.
    pub gaussians: Gaussians,
    /// From the world of the poses to the training world.
    pub normalisation: Normalisation,
}

/// Trained Gaussians in the form of files.
pub(super) fn in_file<'a>(gaussians: &'a Gaussians, by: &Normalisation) -> Cow<'a, Gaussians> {
    if by.is_identity() {
        return Cow::Borrowed(gaussians);
    }
    Cow::Owned(gaussians.moved(1.0 / by.scale, by.offset - by.missing_in_files()))
}

/// The header line of an offset that the file leaves out; empty without one.
pub(crate) fn offset_comment(by: &Normalisation) -> String {
    if !by.left_out {
        return String::new();
    }
    let DVec3 { x, y, z } = by.offset;
    format!("comment fled: add {x} {y} {z} to x y z for the full coordinates\n")
}

/// Header lines; none if the file is as the scene trained.
pub(super) fn comments(by: &Normalisation) -> String {
    let DVec3 { x, y, z } = by.offset;
    let scale = by.scale;
    let mut lines = offset_comment(by);
    if !by.is_identity() {
        lines += &format!("comment fled: trained as world less {x} {y} {z} times {scale}\n");
    }
    lines
}

/// Writes `gaussians`, which `normalisation` brought to the training world, to `path`: first to a
/// temporary name beside it, then renamed.
///
/// # Errors
/// [`PlyError::Io`].
pub fn write(
    gaussians: &Gaussians,
    normalisation: &Normalisation,
    path: &Path,
) -> Result<(), PlyError> {
    let fault = |source| PlyError::Io { path: path.to_owned(), source };
    let temporary = path.with_extension("ply.tmp");
    let mut file = BufWriter::new(File::create(&temporary).map_err(fault)?);
    write_to(gaussians, normalisation, &mut file).map_err(fault)?;
    let file = file.into_inner().map_err(|error| fault(error.into_error()))?;
    file.sync_all().map_err(fault)?;
    std::fs::rename(&temporary, path).map_err(fault)
}

/// Size of this many Gaussians in bytes, without the header.
pub fn bytes_of(count: usize, sh_degree: u32) -> u64 {
    let coefficients = ((sh_degree + 1) * (sh_degree + 1)) as usize;
    (count * size_of::<f32>() * property_names(coefficients).len()) as u64
}

/// Writes a scene's bytes.
///
/// # Errors
/// Those of the writer.
pub fn write_scene(scene: &Scene, mut out: &mut dyn Write) -> std::io::Result<()> {
    write_to(&scene.gaussians, &scene.normalisation, &mut out)
}

/// Writes the PLY's bytes.
///
/// # Errors
/// Those of the writer.
pub fn write_to(
    gaussians: &Gaussians,
    normalisation: &Normalisation,
    out: &mut impl Write,
) -> std::io::Result<()> {
    let gaussians = in_file(gaussians, normalisation);
    let coefficients = gaussians.coefficients();
    out.write_all(b"ply\nformat binary_little_endian 1.0\n")?;
    out.write_all(comments(normalisation).as_bytes())?;
    writeln!(out, "element vertex {}", gaussians.len())?;
    for name in property_names(coefficients) {
        writeln!(out, "property float {name}")?;
    }
    out.write_all(b"end_header\n")?;
    for (i, sh) in gaussians.sh.chunks_exact(3 * coefficients).enumerate() {
        let mut row = Vec::with_capacity(14 + sh.len() + 3);
        row.extend(gaussians.means[i]);
        row.extend([0.0; 3]);
        row.extend(&sh[..3]);
        for channel in 0..3 {
            row.extend(sh[3..].iter().skip(channel).step_by(3));
        }
        row.push(gaussians.opacity_logits[i]);
        row.extend(gaussians.log_scales[i]);
        row.extend(gaussians.quats[i]);
        for value in row {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    out.flush()
}

fn property_names(coefficients: usize) -> Vec<String> {
    let fixed = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let mut names = fixed(&["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]);
    names.extend((0..3 * (coefficients - 1)).map(|n| format!("f_rest_{n}")));
    names.extend(fixed(&[
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ]));
    names
}

/// Reads a scene, as it trained. Properties may be in any order; unknown ones are skipped.
///
/// # Errors
/// [`PlyError`] if the file cannot be read or lacks a property of a Gaussian.
pub fn read(path: &Path) -> Result<Scene, PlyError> {
    let fault = |source| PlyError::Io { path: path.to_owned(), source };
    let mut file = BufReader::new(File::open(path).map_err(fault)?);
    let format = |message: String| PlyError::Format { path: path.to_owned(), message };
    let header = read_header(&mut file).map_err(fault)?.map_err(format)?;
    let mut body = Vec::new();
    file.read_to_end(&mut body).map_err(fault)?;
    let in_file = header.decode(&body).map_err(format)?;
    let by = header.normalisation;
    let shift = (by.offset - by.missing_in_files()) * by.scale;
    Ok(Scene {
        gaussians: if by.is_identity() { in_file } else { in_file.moved(by.scale, -shift) },
        normalisation: by,
    })
}

/// What a scene's header says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Degree of their harmonics.
    pub sh_degree: u32,
    /// From the world of the poses to the training world.
    pub normalisation: Normalisation,
}

/// Reads only the header of a scene.
///
/// # Errors
/// As [`read`].
pub fn read_extent(path: &Path) -> Result<Extent, PlyError> {
    let fault = |source| PlyError::Io { path: path.to_owned(), source };
    let format = |message: String| PlyError::Format { path: path.to_owned(), message };
    let mut file = BufReader::new(File::open(path).map_err(fault)?);
    let header = read_header(&mut file).map_err(fault)?.map_err(format)?;
    let sh_degree = header.sh_degree().map_err(format)? as u32;
    Ok(Extent { gaussians: header.count, sh_degree, normalisation: header.normalisation })
}

/// The vertex element of a PLY header.
struct Header {
    count: usize,
    stride: usize,
    /// Name, byte offset, size.
    properties: Vec<(String, usize, usize)>,
    normalisation: Normalisation,
}

/// Outer error: reading; inner error: the header's.
fn read_header(file: &mut impl BufRead) -> std::io::Result<Result<Header, String>> {
    let mut header = Header {
        count: 0,
        stride: 0,
        properties: Vec::new(),
        normalisation: Normalisation::default(),
    };
    for number in 0..1_000 {
        let mut line = String::new();
        if file.by_ref().take(1_000).read_line(&mut line)? == 0 {
            break;
        }
        let words: Vec<_> = line.split_whitespace().collect();
        match (number, words.as_slice()) {
            (0, ["ply"]) | (_, ["format", "binary_little_endian", _] | ["obj_info", ..]) => {}
            (_, ["comment", "fled:", words @ ..]) => {
                if header.normalise(words).is_none() {
                    return Ok(Err(format!("cannot read `{}`", line.trim())));
                }
            }
            (_, ["comment", ..]) => {}
            (0, _) => return Ok(Err("not a PLY file".to_owned())),
            (_, ["element", "vertex", count]) => match count.parse() {
                Ok(count) => header.count = count,
                Err(_) => return Ok(Err(format!("bad vertex count `{count}`"))),
            },
            (_, ["property", kind, name]) => {
                let Some(size) = size_of_type(kind) else {
                    return Ok(Err(format!("property `{name}` has the unknown type `{kind}`")));
                };
                header.properties.push(((*name).to_owned(), header.stride, size));
                header.stride += size;
            }
            (_, ["end_header"]) => return Ok(Ok(header)),
            _ => {
                return Ok(Err(format!("cannot read the header line `{}`", line.trim())));
            }
        }
    }
    Ok(Err("the header has no end".to_owned()))
}

fn size_of_type(kind: &str) -> Option<usize> {
    match kind {
        "float" | "float32" | "int" | "uint" | "int32" | "uint32" => Some(4),
        "double" | "float64" => Some(8),
        "short" | "ushort" | "int16" | "uint16" => Some(2),
        "char" | "uchar" | "int8" | "uint8" => Some(1),
        _ => None,
    }
}

impl Header {
    /// Parses one of the [`comments`].
    fn normalise(&mut self, words: &[&str]) -> Option<()> {
        let number = |word: &str| word.parse().ok().filter(|number: &f64| number.is_finite());
        match *words {
            ["add", _, _, _, ..] => self.normalisation.left_out = true,
            ["trained", "as", "world", "less", x, y, z, "times", scale] => {
                self.normalisation.offset = DVec3::new(number(x)?, number(y)?, number(z)?);
                self.normalisation.scale = number(scale).filter(|scale| *scale > 0.0)?;
            }
            _ => return None,
        }
        Some(())
    }

    fn decode(&self, body: &[u8]) -> Result<Gaussians, String> {
        let expected = self.count.checked_mul(self.stride).ok_or("the vertex count is absurd")?;
        if body.len() < expected {
            return Err(format!("{} bytes of vertices, {expected} announced", body.len()));
        }
        let sh_degree = self.sh_degree()?;
        let mut offsets = Vec::new();
        for name in property_names((sh_degree + 1) * (sh_degree + 1)) {
            if !matches!(name.as_str(), "nx" | "ny" | "nz") {
                offsets.push(self.offset(&name)?);
            }
        }
        let mut out = Gaussians { sh_degree: sh_degree as u32, ..Gaussians::default() };
        for vertex in body.chunks_exact(self.stride.max(1)).take(self.count) {
            let row: Vec<_> = offsets.iter().map(|&at| float(vertex, at)).collect();
            push(&mut out, &row);
        }
        Ok(out)
    }

    fn sh_degree(&self) -> Result<usize, String> {
        let rest = self.properties.iter().filter(|(name, ..)| name.starts_with("f_rest_")).count();
        (0..=3)
            .find(|degree| 3 * ((degree + 1) * (degree + 1) - 1) == rest)
            .ok_or_else(|| format!("{rest} higher harmonics fit no degree"))
    }

    fn offset(&self, name: &str) -> Result<usize, String> {
        let found = self.properties.iter().find(|(known, _, size)| known == name && *size == 4);
        found.map(|(_, offset, _)| *offset).ok_or_else(|| format!("no float property `{name}`"))
    }
}

fn float(vertex: &[u8], at: usize) -> f32 {
    f32::from_le_bytes([vertex[at], vertex[at + 1], vertex[at + 2], vertex[at + 3]])
}

/// Appends a row in the order of [`property_names`] without the normal.
fn push(out: &mut Gaussians, row: &[f32]) {
    let rest = 3 * (out.coefficients() - 1);
    let tail = 6 + rest;
    out.means.push([row[0], row[1], row[2]]);
    out.sh.extend(&row[3..6]);
    let by_channel = &row[6..tail];
    for n in 0..rest / 3 {
        out.sh.extend([0, 1, 2].map(|channel| by_channel[channel * (rest / 3) + n]));
    }
    out.opacity_logits.push(row[tail]);
    out.log_scales.push([row[tail + 1], row[tail + 2], row[tail + 3]]);
    out.quats.push([row[tail + 4], row[tail + 5], row[tail + 6], row[tail + 7]]);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(count: usize, sh_degree: u32) -> Gaussians {
        let value = |i: usize, n: usize| (i as f32 + 1.0) * 0.37 - n as f32 * 0.11;
        let row = 3 * ((sh_degree + 1) * (sh_degree + 1)) as usize;
        Gaussians {
            means: (0..count).map(|i| [0, 1, 2].map(|n| value(i, n))).collect(),
            quats: (0..count).map(|i| [3, 4, 5, 6].map(|n| value(i, n))).collect(),
            log_scales: (0..count).map(|i| [7, 8, 9].map(|n| value(i, n))).collect(),
            opacity_logits: (0..count).map(|i| value(i, 10)).collect(),
            sh: (0..count * row).map(|n| value(n, 2)).collect(),
            sh_degree,
        }
    }

    #[test]
    fn a_scene_of_every_degree_round_trips_bit_for_bit() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for degree in 0..=3 {
            let (path, scene) = (folder.path().join("scene.ply"), scene(5, degree));
            write(&scene, &Normalisation::default(), &path).expect("written");
            assert_eq!(read(&path).expect("read").gaussians, scene);
            assert!(!path.with_extension("ply.tmp").exists());
        }
    }

    #[test]
    fn a_file_is_in_the_world_of_the_poses_less_an_offset_beyond_f32() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (path, scene) = (folder.path().join("scene.ply"), scene(5, 1));
        let offset = DVec3::new(512_352.0, -5_412_352.0, 64.0);
        for left_out in [true, false] {
            let by = Normalisation { offset, scale: 0.0625, left_out };
            write(&scene, &by, &path).expect("written");
            let found = read(&path).expect("read");
            assert_eq!(found.normalisation, by);
            assert_eq!(found.gaussians.sh, scene.sh);
            let bytes = std::fs::read(&path).expect("bytes");
            let is_noted =
                String::from_utf8_lossy(&bytes).contains("add 512352 -5412352 64 to x y z");
            assert_eq!(is_noted, left_out);
            let at = bytes.windows(11).position(|w| w == b"end_header\n");
            let at = at.expect("a header") + 11;
            let number = |n: usize| float(&bytes, at + 4 * n);
            let moved = if left_out { 0.0 } else { 512_352.0 };
            assert_eq!(number(0), scene.means[0][0] * 16.0 + moved);
            let log_scale = number(9 + 9 + 1);
            assert!((log_scale - scene.log_scales[0][0] - 16_f32.ln()).abs() < 1e-6);
            // A step of f32 at 5,412,352 is half a metre: 1/32 of this scene.
            let coarse = if left_out { 1e-6 } else { 0.5 / 16.0 };
            for (a, b) in found.gaussians.means.iter().zip(&scene.means) {
                let off = (0..3).map(|axis| (a[axis] - b[axis]).abs());
                assert!(off.fold(0.0, f32::max) <= coarse, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn an_invalid_comment_of_ours_is_refused_and_others_are_ignored() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("scene.ply");
        let with = |comment: &str| {
            let mut bytes = Vec::new();
            write_to(&scene(3, 0), &Normalisation::default(), &mut bytes).expect("written");
            let (head, rest) = bytes.split_at(b"ply\n".len());
            let bytes = [head, format!("comment {comment}\n").as_bytes(), rest].concat();
            std::fs::write(&path, bytes).expect("written");
            read(&path)
        };
        assert!(with("offset of another program").is_ok());
        for bad in ["fled: trained as world less 1 2 x times 1", "fled: add", "fled: what"] {
            assert!(matches!(with(bad), Err(PlyError::Format { .. })), "{bad}");
        }
        assert!(with("fled: trained as world less 1 2 3 times 0").is_err());
    }

    #[test]
    fn higher_harmonics_are_channel_major_and_the_quaternion_starts_with_w() {
        let scene = scene(1, 1);
        let mut bytes = Vec::new();
        write_to(&scene, &Normalisation::default(), &mut bytes).expect("written");
        let at = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        let body: Vec<_> = bytes[at..]
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        assert_eq!(body.len(), 26);
        assert_eq!(
            body[9..12],
            [scene.sh[3], scene.sh[6], scene.sh[9]],
            "red of coefficients 1, 2, 3"
        );
        assert_eq!(body[12], scene.sh[4], "then green");
        assert_eq!(body[18], scene.opacity_logits[0]);
        assert_eq!(body[22..], scene.quats[0]);
    }

    #[test]
    fn a_truncated_or_foreign_file_is_refused_with_a_reason() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("bad.ply");
        let mut bytes = Vec::new();
        write_to(&scene(3, 2), &Normalisation::default(), &mut bytes).expect("written");
        std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("written");
        assert!(
            matches!(read(&path), Err(PlyError::Format { message, .. }) if message.contains("announced"))
        );
        std::fs::write(&path, b"P6 3 3").expect("written");
        assert!(
            matches!(read(&path), Err(PlyError::Format { message, .. }) if message == "not a PLY file")
        );
    }

    #[test]
    fn poisoned_gaussians_are_left_out() {
        let mut scene = scene(4, 1);
        scene.means[0][1] = f32::NAN;
        scene.quats[2] = [0.0; 4];
        scene.sh[3 * 12] = f32::INFINITY;
        let clean = scene.without_unusable();
        assert_eq!(clean.means, [scene.means[1]]);
        assert_eq!(clean.sh, scene.sh[12..24]);
    }
}
