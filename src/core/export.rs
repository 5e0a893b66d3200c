//! Exports of a finished result for use elsewhere: its pictures, its cameras with them, its scene
//! in other formats or as a mesh.
//!
//! Each is written sequentially, so a caller can stream it while it is being made. Missing inputs
//! are reported before that. A mesh is made as a whole before it is written.

mod archive;
mod cameras;
mod error;
mod trim;

use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use archive::{Archive, Picture, pictures};
use serde_json::Value;

use crate::camera::{Intrinsics, NamedCamera};
use crate::gaussians::placement::Placement;
use crate::gaussians::ply::{self, Extent, PlyError, Scene};
use crate::gaussians::{Y00, compressed, glb, sog, spz, usd};
use crate::image::Image;
use crate::mesh::{self, Detail, Facts, Mesh};
use crate::poses::model::SparseModel;
use crate::run_folder::RunFolder;

pub use error::ExportError;
pub use trim::{MOST_SH_DEGREE, Trim};

/// Approximate compressed size of a camera or a point in a COLMAP model, bytes.
const ROW: u64 = 40;

/// Bytes of a pixel of three channels of 16 bits.
const PIXEL: u64 = 6;

/// A format in which a result is exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Export {
    /// The restored views as a zip.
    Restored,
    /// The restored views as TIFFs of 16 bits in linear light, as a zip.
    Linear,
    /// The restored views and a COLMAP model of the corrected cameras as a zip.
    Colmap,
    /// The corrected cameras as nerfstudio's `transforms.json`.
    Transforms,
    /// The corrected cameras in the form of Inria's 3D Gaussian splatting.
    InriaCameras,
    /// The scene as PLY, in the layout of 3DGS.
    Ply,
    /// The scene as compressed PLY.
    CompressedScene,
    /// The scene as binary glTF.
    Gltf,
    /// The scene as OpenUSD text.
    Usd,
    /// The scene as SPZ, compressed by gzip.
    SpzVersion3,
    /// The scene as SPZ, compressed by Zstandard.
    Spz,
    /// The scene as SOG.
    Sog,
    /// A triangle mesh as PLY.
    MeshPly,
    /// A triangle mesh as binary glTF.
    MeshGltf,
}

impl Export {
    /// All formats.
    pub const ALL: [Self; 14] = [
        Self::Restored,
        Self::Linear,
        Self::Colmap,
        Self::Transforms,
        Self::InriaCameras,
        Self::Ply,
        Self::CompressedScene,
        Self::Gltf,
        Self::Usd,
        Self::SpzVersion3,
        Self::Spz,
        Self::Sog,
        Self::MeshPly,
        Self::MeshGltf,
    ];

    /// The name of its file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Restored => "restored.zip",
            Self::Linear => "linear.zip",
            Self::Colmap => "colmap.zip",
            Self::Transforms => "transforms.json",
            Self::InriaCameras => "cameras.inria.json",
            Self::Ply => "scene.ply",
            Self::CompressedScene => "scene.compressed.ply",
            Self::Gltf => "scene.glb",
            Self::Usd => "scene.usda",
            Self::SpzVersion3 => "scene.v3.spz",
            Self::Spz => "scene.spz",
            Self::Sog => "scene.sog",
            Self::MeshPly => "mesh.ply",
            Self::MeshGltf => "mesh.glb",
        }
    }

    /// A description, with the intended use.
    pub fn about(self) -> &'static str {
        match self {
            Self::Restored => "Every restored view: the scene rendered from the view's camera.",
            Self::Linear => {
                "The restored views as 16-bit TIFFs in linear light, for colour grading."
            }
            Self::Colmap => {
                "The restored views with their corrected cameras and points of the scene, as a \
                 COLMAP model for other trainers."
            }
            Self::Transforms => {
                "The corrected cameras for nerfstudio, beside the result's restored/ and scene.ply."
            }
            Self::InriaCameras => {
                "The corrected cameras for viewers that expect Inria's cameras.json beside \
                 scene.ply, such as SuperSplat."
            }
            Self::Ply => "The scene as it was trained, unrounded, for nearly all programs.",
            Self::CompressedScene => {
                "The scene at a quarter of its size or less, rounded too little to be visible, for \
                 SuperSplat, PlayCanvas and other viewers."
            }
            Self::Gltf => {
                "The scene as binary glTF, unrounded, for three.js, Babylon.js, Cesium and other \
                 programs that read glTF."
            }
            Self::Usd => {
                "The scene as OpenUSD text, unrounded, for programs with OpenUSD 26.03 or newer; \
                 larger than PLY."
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
            Self::MeshPly => {
                "A triangle mesh for measuring and collisions, with holes where fewer than two \
                 photographs see a surface."
            }
            Self::MeshGltf => {
                "The same mesh as binary glTF, for game engines, Blender and three.js."
            }
        }
    }

    /// Whether it is a mesh, which is made as a whole before it is written.
    pub fn is_mesh(self) -> bool {
        matches!(self, Self::MeshPly | Self::MeshGltf)
    }

    /// Whether it holds the scene or a mesh of it, so that it can be trimmed.
    pub fn has_scene(self) -> bool {
        !matches!(
            self,
            Self::Restored | Self::Linear | Self::Colmap | Self::Transforms | Self::InriaCameras
        )
    }

    /// Refuses what does not suit this format.
    fn check(self, round: Option<u32>, trim: Trim) -> Result<(), ExportError> {
        let is_mesh = self.is_mesh();
        Err(match self {
            _ if !self.has_scene() && !trim.is_nothing() => ExportError::NotTrimmed(self.name()),
            _ if is_mesh && trim.sh_degree.is_some() => ExportError::NoHarmonics(self.name()),
            _ if !is_mesh && trim.mesh != Detail::default() => ExportError::NoMesh(self.name()),
            Self::Linear if round.is_some() => ExportError::OnlyDelivered(self.name()),
            _ => return Ok(()),
        })
    }

    /// Finds its inputs, of the delivered round or of a finished one. A trimmed scene is read and
    /// held in memory.
    ///
    /// # Errors
    /// [`ExportError`] if they are missing or unreadable, or if the trim leaves nothing or does not
    /// suit this format.
    pub fn prepare(
        self,
        run: &RunFolder,
        round: Option<u32>,
        trim: Trim,
    ) -> Result<Prepared, ExportError> {
        let path = run.scene_of(round);
        self.check(round, trim)?;
        let flat = |bytes_of, write| {
            let placement = trim.placement(&[], false);
            Content::scene(&path, trim, bytes_of, WriteScene::Flat(write), placement)
        };
        let placed = |bytes_of, write| {
            let is_map = ply::read_extent(&path)?.normalisation.left_out;
            let placement = trim.placement(&cameras::cameras(run, round)?, is_map);
            Content::scene(&path, trim, bytes_of, WriteScene::Placed(write), placement)
        };
        let mesh = |format| -> Result<Content, ExportError> {
            let (scene, _) = Source::of(&path, trim)?;
            let cameras = cameras::cameras(run, round)?;
            let is_map = ply::read_extent(&path)?.normalisation.left_out;
            let placement = trim.placement(&cameras, is_map);
            Ok(Content::Unmeshed { scene, cameras, detail: trim.mesh, format, placement })
        };
        Ok(Prepared(match self {
            Self::Restored => Content::Pictures(pictures(run, round)?),
            Self::Linear => {
                let views = cameras::views(run, None)?;
                for (_, picture) in &views {
                    if !picture.has_16_bits()? {
                        return Err(ExportError::EightBits(self.name()));
                    }
                }
                Content::Linear(views)
            }
            Self::Colmap => {
                let views = cameras::views(run, round)?;
                let gaussians = ply::read_extent(&path)?.gaussians;
                Content::Colmap { views, scene: path, gaussians }
            }
            Self::Transforms => Content::json(&cameras::transforms(run, round)?),
            Self::InriaCameras => Content::json(&cameras::inria(run, round)?),
            Self::Ply if trim.is_nothing() => Content::copy(path)?,
            Self::Ply => flat(ply::bytes_of, ply::write_scene)?,
            Self::CompressedScene => flat(compressed::bytes_of, compressed::write_to)?,
            Self::Gltf => placed(glb::bytes_of, glb::write_to)?,
            Self::Usd => placed(usd::bytes_of, usd::write_to)?,
            Self::SpzVersion3 => flat(spz::bytes_of, spz::write_version_3)?,
            Self::Spz => flat(spz::bytes_of, spz::write_version_4)?,
            Self::Sog => flat(sog::bytes_of, sog::write_to)?,
            Self::MeshPly => mesh((mesh::bytes_of_ply, mesh::write_ply))?,
            Self::MeshGltf => mesh((mesh::bytes_of_gltf, mesh::write_gltf))?,
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

#[derive(Debug)]
enum Content {
    Pictures(Vec<Picture>),
    Linear(Vec<(NamedCamera, Picture)>),
    Colmap {
        views: Vec<(NamedCamera, Picture)>,
        scene: PathBuf,
        gaussians: usize,
    },
    Scene {
        scene: Source,
        bytes: u64,
        write_to: WriteScene,
        placement: Placement,
    },
    Copy {
        path: PathBuf,
        bytes: u64,
    },
    Text(String),
    Unmeshed {
        scene: Source,
        cameras: Vec<NamedCamera>,
        detail: Detail,
        format: OfMesh,
        placement: Placement,
    },
    Meshed {
        mesh: Box<Mesh>,
        format: OfMesh,
        placement: Placement,
    },
}

/// A scene to be written.
#[derive(Debug)]
enum Source {
    /// As it is on disk.
    File(PathBuf),
    /// Trimmed.
    Trimmed(Box<Scene>),
}

/// The approximate size of a mesh with a number of triangles, and its writer.
type OfMesh = (fn(usize) -> u64, fn(&Mesh, Placement, &mut dyn Write) -> io::Result<()>);

/// Writes a scene in some format.
#[derive(Clone, Copy, Debug)]
enum WriteScene {
    /// All numbers are in the units of the export.
    Flat(fn(&Scene, &mut dyn Write) -> io::Result<()>),
    /// A node of the file has the placement.
    Placed(fn(&Scene, Placement, &mut dyn Write) -> io::Result<()>),
}

impl WriteScene {
    fn to(self, scene: Cow<'_, Scene>, by: Placement, out: &mut dyn Write) -> io::Result<()> {
        match self {
            Self::Flat(write) if by.scale == 1.0 => write(&scene, out),
            Self::Flat(write) => {
                let mut scene = scene.into_owned();
                scene.normalisation = scene.normalisation.of_scaled_world(by.scale);
                write(&scene, out)
            }
            Self::Placed(write) => write(&scene, by, out),
        }
    }
}

impl Source {
    /// A scene, with its number of Gaussians and its degree.
    fn of(path: &Path, trim: Trim) -> Result<(Self, (usize, u32)), ExportError> {
        if trim.keeps_all() {
            let Extent { gaussians, sh_degree, .. } = ply::read_extent(path)?;
            return Ok((Self::File(path.to_owned()), (gaussians, sh_degree)));
        }
        let left = trim.of(ply::read(path)?)?;
        let extent = (left.gaussians.len(), left.gaussians.sh_degree);
        Ok((Self::Trimmed(Box::new(left)), extent))
    }

    fn read(&self) -> Result<Cow<'_, Scene>, PlyError> {
        Ok(match self {
            Self::File(path) => Cow::Owned(ply::read(path)?),
            Self::Trimmed(scene) => Cow::Borrowed(scene),
        })
    }
}

impl Content {
    /// A scene in a format that has `bytes_of` a number of Gaussians and a degree.
    fn scene(
        path: &Path,
        trim: Trim,
        bytes_of: fn(usize, u32) -> u64,
        write_to: WriteScene,
        placement: Placement,
    ) -> Result<Self, ExportError> {
        let (scene, (gaussians, sh_degree)) = Source::of(path, trim)?;
        let bytes = bytes_of(gaussians, sh_degree);
        Ok(Self::Scene { scene, bytes, write_to, placement })
    }

    /// The scene's own file.
    fn copy(path: PathBuf) -> Result<Self, ExportError> {
        ply::read_extent(&path)?;
        let about = fs::metadata(&path).map_err(ExportError::io(&path))?;
        Ok(Self::Copy { path, bytes: about.len() })
    }

    fn json(document: &Value) -> Self {
        Self::Text(format!("{document:#}\n"))
    }
}

/// An export that is ready to be written.
#[derive(Debug)]
pub struct Prepared(Content);

impl Prepared {
    /// The same with its mesh, if it is one: all that can fail before it is written.
    ///
    /// # Errors
    /// [`ExportError::Mesh`], or if the scene cannot be read.
    pub fn meshed(self) -> Result<Self, ExportError> {
        let Content::Unmeshed { scene, cameras, detail, format, placement } = self.0 else {
            return Ok(self);
        };
        let mesh = Box::new(mesh::of(&*scene.read()?, &cameras, detail)?);
        Ok(Self(Content::Meshed { mesh, format, placement }))
    }

    /// The measures of its mesh, once that is made, in units of the poses' world.
    pub fn facts(&self) -> Option<Facts> {
        match &self.0 {
            Content::Meshed { mesh, .. } => Some(mesh.facts),
            _ => None,
        }
    }

    /// Its approximate size in bytes; of a mesh that is to be made, the largest.
    pub fn bytes(&self) -> u64 {
        match &self.0 {
            Content::Pictures(pictures) => pictures.iter().map(|picture| picture.bytes).sum(),
            Content::Linear(views) => {
                let pixels = |view: &(NamedCamera, Picture)| {
                    let Intrinsics { width, height, .. } = view.0.intrinsics;
                    (width * height) as u64
                };
                views.iter().map(|view| PIXEL * pixels(view)).sum()
            }
            Content::Colmap { views, gaussians, .. } => {
                let pictures: u64 = views.iter().map(|(_, picture)| picture.bytes).sum();
                pictures + ROW * (views.len() + gaussians) as u64
            }
            Content::Scene { bytes, .. } | Content::Copy { bytes, .. } => *bytes,
            Content::Text(text) => text.len() as u64,
            Content::Unmeshed { detail, format: (bytes_of, _), .. } => {
                bytes_of(detail.triangles.unwrap_or(mesh::TRIANGLES))
            }
            Content::Meshed { mesh, format: (bytes_of, _), .. } => bytes_of(mesh.triangles.len()),
        }
    }

    /// Writes it.
    ///
    /// # Errors
    /// [`ExportError`]; the output is incomplete then.
    pub fn write(&self, mut out: impl Write) -> Result<(), ExportError> {
        match &self.0 {
            Content::Pictures(pictures) => {
                let mut archive = Archive::new(out);
                for picture in pictures {
                    archive.picture("", picture)?;
                }
                archive.finish()
            }
            Content::Linear(views) => {
                let mut archive = Archive::new(out);
                for (named, picture) in views {
                    let light = Image::load(&picture.path)?.to_linear();
                    let bytes = light.to_tiff()?;
                    archive.entry(&format!("{}.tif", named.name), &mut bytes.as_slice())?;
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
            Content::Scene { scene, write_to, placement, .. } => {
                let mut out = io::BufWriter::new(out);
                write_to.to(scene.read()?, *placement, &mut out).map_err(ExportError::of_format)
            }
            Content::Copy { path, .. } => {
                let mut file = File::open(path).map_err(ExportError::io(path))?;
                let copied = io::copy(&mut file, &mut out).and_then(|_| out.flush());
                copied.map_err(ExportError::Write)
            }
            Content::Text(text) => {
                let written = out.write_all(text.as_bytes()).and_then(|()| out.flush());
                written.map_err(ExportError::Write)
            }
            Content::Unmeshed { scene, cameras, detail, format: (_, write_to), placement } => {
                let mesh = mesh::of(&*scene.read()?, cameras, *detail)?;
                let mut out = io::BufWriter::new(out);
                write_to(&mesh, *placement, &mut out).map_err(ExportError::of_format)
            }
            Content::Meshed { mesh, format: (_, write_to), placement } => {
                let mut out = io::BufWriter::new(out);
                write_to(mesh, *placement, &mut out).map_err(ExportError::of_format)
            }
        }
    }
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
