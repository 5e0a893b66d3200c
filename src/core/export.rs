//! Exports of a finished result for use elsewhere: its pictures, its cameras with them, its scene
//! in other formats.
//!
//! Each is written sequentially, so a caller can stream it while it is being made. Missing inputs
//! are reported before that.

mod error;

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use zip::ZipWriter;
use zip::write::{SimpleFileOptions, StreamWriter};

use crate::camera::NamedCamera;
use crate::gaussians::ply::{self, Scene};
use crate::gaussians::{Y00, compressed, glb, sog, spz};
use crate::poses::model::SparseModel;
use crate::run_folder::{RoundPictures, RunFolder};

pub use error::ExportError;

/// Compression level: pictures are already compressed, so the fastest is as good as the best.
const LEVEL: i64 = 1;

/// Approximate compressed size of a camera or a point in a COLMAP model, bytes.
const ROW: u64 = 40;

/// A format in which a result is exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Export {
    /// The restored views as a zip.
    Restored,
    /// The restored views and a COLMAP model of the corrected cameras as a zip.
    Colmap,
    /// The scene as compressed PLY.
    CompressedScene,
    /// The scene as binary glTF.
    Gltf,
    /// The scene as SPZ, compressed by gzip.
    SpzVersion3,
    /// The scene as SPZ, compressed by Zstandard.
    Spz,
    /// The scene as SOG.
    Sog,
}

impl Export {
    /// All formats.
    pub const ALL: [Self; 7] = [
        Self::Restored,
        Self::Colmap,
        Self::CompressedScene,
        Self::Gltf,
        Self::SpzVersion3,
        Self::Spz,
        Self::Sog,
    ];

    /// The name of its file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Restored => "restored.zip",
            Self::Colmap => "colmap.zip",
            Self::CompressedScene => "scene.compressed.ply",
            Self::Gltf => "scene.glb",
            Self::SpzVersion3 => "scene.v3.spz",
            Self::Spz => "scene.spz",
            Self::Sog => "scene.sog",
        }
    }

    /// A description, with the intended use.
    pub fn about(self) -> &'static str {
        match self {
            Self::Restored => "Every restored view: the scene rendered from the view's camera.",
            Self::Colmap => {
                "The restored views with their corrected cameras and points of the scene, as a \
                 COLMAP model for other trainers."
            }
            Self::CompressedScene => {
                "The scene at a quarter of its size or less, rounded too little to be visible, for \
                 SuperSplat, PlayCanvas and other viewers."
            }
            Self::Gltf => {
                "The scene as binary glTF, unrounded, for three.js, Babylon.js, Cesium and other \
                 programs that read glTF."
            }
            Self::SpzVersion3 => {
                "The scene at a sixth of its size, as SPZ version 3, for Spark, Babylon.js, \
                 three.js and phones."
            }
            Self::Spz => {
                "The same as SPZ version 4, a little smaller, for PlayCanvas, Babylon.js and \
                 three.js; others know only version 3."
            }
            Self::Sog => {
                "The scene at a fifth to an eighth of its size, for PlayCanvas, SuperSplat, \
                 Babylon.js and Spark: the smallest for many Gaussians."
            }
        }
    }

    /// Finds its inputs, of the delivered round or of a finished one.
    ///
    /// # Errors
    /// [`ExportError`] if they are missing or unreadable.
    pub fn prepare(self, run: &RunFolder, round: Option<u32>) -> Result<Prepared, ExportError> {
        let scene = run.scene_of(round);
        Ok(Prepared(match self {
            Self::Restored => Content::Pictures(pictures(run, round)?),
            Self::Colmap => {
                let cameras = cameras(run, round)?;
                let views = with_pictures(&cameras, pictures(run, round)?)?;
                let (gaussians, _) = ply::read_extent(&scene)?;
                Content::Colmap { views, scene, gaussians }
            }
            Self::CompressedScene => {
                Content::scene(scene, compressed::bytes_of, compressed::write_to)?
            }
            Self::Gltf => Content::scene(scene, glb::bytes_of, glb::write_to)?,
            Self::SpzVersion3 => Content::scene(scene, spz::bytes_of, spz::write_version_3)?,
            Self::Spz => Content::scene(scene, spz::bytes_of, spz::write_version_4)?,
            Self::Sog => Content::scene(scene, sog::bytes_of, sog::write_to)?,
        }))
    }
}

impl FromStr for Export {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|export| export.name() == name);
        found.ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("`{name}` is none of {names}")
        })
    }
}

/// A picture on disk.
#[derive(Debug)]
struct Picture {
    path: PathBuf,
    /// Without folders.
    file_name: String,
    bytes: u64,
}

#[derive(Debug)]
enum Content {
    Pictures(Vec<Picture>),
    Colmap { views: Vec<(NamedCamera, Picture)>, scene: PathBuf, gaussians: usize },
    Scene { scene: PathBuf, bytes: u64, write_to: WriteScene },
}

/// Writes a scene in some format.
type WriteScene = fn(&Scene, &mut dyn Write) -> io::Result<()>;

impl Content {
    /// A scene in a format that has `bytes_of` a number of Gaussians and a degree.
    fn scene(
        scene: PathBuf,
        bytes_of: fn(usize, u32) -> u64,
        write_to: WriteScene,
    ) -> Result<Self, ExportError> {
        let (gaussians, sh_degree) = ply::read_extent(&scene)?;
        Ok(Self::Scene { bytes: bytes_of(gaussians, sh_degree), scene, write_to })
    }
}

/// An export that is ready to be written.
#[derive(Debug)]
pub struct Prepared(Content);

impl Prepared {
    /// Its approximate size in bytes.
    pub fn bytes(&self) -> u64 {
        match &self.0 {
            Content::Pictures(pictures) => pictures.iter().map(|picture| picture.bytes).sum(),
            Content::Colmap { views, gaussians, .. } => {
                let pictures: u64 = views.iter().map(|(_, picture)| picture.bytes).sum();
                pictures + ROW * (views.len() + gaussians) as u64
            }
            Content::Scene { bytes, .. } => *bytes,
        }
    }

    /// Writes it.
    ///
    /// # Errors
    /// [`ExportError`]; the output is incomplete then.
    pub fn write(&self, out: impl Write) -> Result<(), ExportError> {
        match &self.0 {
            Content::Pictures(pictures) => {
                let mut archive = Archive::new(out);
                for picture in pictures {
                    archive.picture("", picture)?;
                }
                archive.finish()
            }
            Content::Colmap { views, scene, .. } => {
                let mut archive = Archive::new(out);
                let named = views
                    .iter()
                    .map(|(camera, picture)| (picture.file_name.clone(), camera.camera()));
                let scene = ply::read(scene)?;
                let model = SparseModel::of_views(named, points(&scene));
                for (name, text) in model.text_files() {
                    let mut text = text.as_bytes();
                    archive.entry(&format!("sparse/0/{name}"), &mut text)?;
                }
                for (_, picture) in views {
                    archive.picture("images/", picture)?;
                }
                archive.finish()
            }
            Content::Scene { scene, write_to, .. } => {
                let mut out = io::BufWriter::new(out);
                write_to(&ply::read(scene)?, &mut out).map_err(ExportError::Write)
            }
        }
    }
}

/// A zip whose entries are compressed while streaming.
struct Archive<W: Write>(ZipWriter<StreamWriter<W>>);

impl<W: Write> Archive<W> {
    fn new(out: W) -> Self {
        Self(ZipWriter::new_stream(out))
    }

    fn entry(&mut self, name: &str, content: &mut impl io::Read) -> Result<(), ExportError> {
        // Compressed although pictures gain nothing: readers that cannot seek do not find the end
        // of an uncompressed entry.
        let options = SimpleFileOptions::default().compression_level(Some(LEVEL));
        let begun = self.0.start_file(name, options).map_err(io::Error::from);
        begun.and_then(|()| io::copy(content, &mut self.0)).map_err(ExportError::Write)?;
        Ok(())
    }

    fn picture(&mut self, folder: &str, picture: &Picture) -> Result<(), ExportError> {
        let mut file = File::open(&picture.path).map_err(ExportError::io(&picture.path))?;
        self.entry(&format!("{folder}{}", picture.file_name), &mut file)
    }

    fn finish(self) -> Result<(), ExportError> {
        let finished = self.0.finish().map_err(io::Error::from);
        let mut out = finished.map_err(ExportError::Write)?.into_inner();
        out.flush().map_err(ExportError::Write)
    }
}

/// The restored views, or the renders of a round, by name.
fn pictures(run: &RunFolder, round: Option<u32>) -> Result<Vec<Picture>, ExportError> {
    let folder = match round {
        Some(round) => run.round(round).pictures(RoundPictures::Renders),
        None => run.restored(),
    };
    let mut pictures = Vec::new();
    for entry in fs::read_dir(&folder).map_err(ExportError::io(&folder))? {
        let entry = entry.map_err(ExportError::io(&folder))?;
        let path = entry.path();
        let about = entry.metadata().map_err(ExportError::io(&path))?;
        let Ok(file_name) = entry.file_name().into_string() else {
            continue;
        };
        // Names of files being written begin with a dot.
        if about.is_file() && !file_name.starts_with('.') {
            pictures.push(Picture { path, file_name, bytes: about.len() });
        }
    }
    pictures.sort_by(|a, b| a.file_name.cmp(&b.file_name));
    if pictures.is_empty() {
        return Err(ExportError::NoPictures(folder));
    }
    Ok(pictures)
}

fn cameras(run: &RunFolder, round: Option<u32>) -> Result<Vec<NamedCamera>, ExportError> {
    let path = match round {
        Some(round) => run.round(round).cameras(),
        None => run.cameras(),
    };
    let text = fs::read(&path).map_err(ExportError::io(&path))?;
    serde_json::from_slice(&text).map_err(|source| ExportError::Cameras { path, source })
}

/// Each camera with its view's picture; a view without one is useless for training.
fn with_pictures(
    cameras: &[NamedCamera],
    pictures: Vec<Picture>,
) -> Result<Vec<(NamedCamera, Picture)>, ExportError> {
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

/// The centres of Gaussians more opaque than not, with their base colour.
fn points(Scene { gaussians: scene, normalisation }: &Scene) -> Vec<([f64; 3], [u8; 3])> {
    let row = 3 * scene.coefficients();
    let is_solid = |&index: &usize| scene.is_usable(index) && scene.opacity_logits[index] > 0.0;
    let point = |index: usize| {
        let sh = &scene.sh[index * row..][..3];
        let colour = |channel: usize| (0.5 + Y00 * sh[channel]).clamp(0.0, 1.0) * 255.0;
        let colour = std::array::from_fn(|channel| colour(channel).round() as u8);
        let place = normalisation.point_in_world(scene.means[index].map(f64::from).into());
        (place.to_array(), colour)
    };
    (0..scene.len()).filter(is_solid).map(point).collect()
}

#[cfg(test)]
mod tests;
