//! A triangle mesh of a scene, for measuring and collisions: the depths of all cameras are fused
//! into a truncated signed distance, whose zero is the surface (Curless and Levoy 1996).
//!
//! Only what two views see is meshed, so the mesh has holes where the photographs leave them, and
//! [`Facts`] says how large they are. All of it runs on the processor, and the same scene gives
//! the same bytes.

mod coverage;
mod cubes;
mod files;
mod grid;
mod surface;
mod view;

use std::fmt;

use glam::{IVec3, Vec3};

use crate::camera::NamedCamera;
use crate::camera::normalisation::Normalisation;
use crate::device::{Device, PROCESSOR};
use crate::gaussians::ply::Scene;
use crate::render::{Renderer, SplatError};

pub use files::{bytes_of_gltf, bytes_of_ply, write_gltf, write_ply};
use grid::{Grid, Scale};
use surface::Surface;
use view::View;

/// Triangles that a mesh has at most by default.
pub const TRIANGLES: usize = 200_000;

/// Fewest and most triangles that can be wanted.
pub const TRIANGLE_LIMITS: [usize; 2] = [100, 10_000_000];

/// Pixels of all views together, which bounds the memory of their depths.
const PIXELS: f64 = 16e6;

/// Voxel by default, pixels at the views' median depth: less is noise.
const VOXEL: f32 = 3.0;

/// Truncation of the signed distance: voxels by default, by which depths differ from view to view,
/// and at least, so that all voxels at a surface know it.
const TRUNCATION: [f32; 2] = [4.0, 2.0];

/// Factor by which a voxel grows until the grid fits into its memory.
const GROWTH: f32 = 1.25;

/// Limits of the factor by which a voxel grows for fewer triangles: thin parts vanish with large
/// voxels, so their number falls faster than by the square.
const TRIANGLE_GROWTH: [f32; 2] = [1.05, 1.25];

/// How fine a mesh is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Detail {
    /// Most triangles, for which voxels grow; [`TRIANGLES`] by default, unless a voxel is given.
    pub triangles: Option<usize>,
    /// Side of a voxel, units of the poses' world; by default three pixels at the median depth.
    pub voxel: Option<f64>,
}

impl Detail {
    /// Checks a number of triangles.
    ///
    /// # Errors
    /// The rest of a sentence if it is outside [`TRIANGLE_LIMITS`].
    pub fn triangles(wanted: usize) -> Result<usize, String> {
        let [least, most] = TRIANGLE_LIMITS;
        if (least..=most).contains(&wanted) {
            return Ok(wanted);
        }
        Err(format!("must be from {least} to {most} triangles"))
    }

    /// Checks the side of a voxel.
    ///
    /// # Errors
    /// The rest of a sentence if it is not positive and finite.
    pub fn voxel(wanted: f64) -> Result<f64, String> {
        if wanted > 0.0 && wanted.is_finite() {
            return Ok(wanted);
        }
        Err(format!("must be a positive length, not {wanted}"))
    }
}

/// Measures of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facts {
    /// Side of a voxel, units of the poses' world.
    pub voxel: f64,
    /// Number of triangles.
    pub triangles: usize,
    /// Edges that belong to one triangle only: the rims of holes.
    pub boundary_edges: usize,
    /// Share of the views' pixels in which the scene stops most of the light.
    pub seen: f64,
    /// Share of the views' pixels whose ray meets the mesh near where the scene stops the light.
    pub met: f64,
}

impl fmt::Display for Facts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { voxel, triangles, boundary_edges, seen, met } = self;
        let [seen, met] = [seen, met].map(|share| 100.0 * share);
        write!(
            f,
            "{triangles} triangles from voxels of {}; the mesh covers {met:.1} % of the views' \
             pixels, and {seen:.1} % show a surface; {boundary_edges} open edges",
            rounded_up(*voxel)
        )
    }
}

/// A triangle mesh in the coordinates of `scene.ply`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Vertices.
    pub positions: Vec<Vec3>,
    /// Unit normals of the vertices, towards the cameras.
    pub normals: Vec<Vec3>,
    /// Colours of the vertices, sRGB.
    pub colours: Vec<[u8; 3]>,
    /// Indices of vertices, anticlockwise as seen from the cameras.
    pub triangles: Vec<[u32; 3]>,
    /// Measures.
    pub facts: Facts,
    /// Of the world of its scene.
    pub normalisation: Normalisation,
}

/// No mesh can be made.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// No surface is seen by two views.
    #[error(
        "the scene has nothing to mesh: no surface stops most of the light in two views or more"
    )]
    Nothing,
    /// A voxel is smaller than a pixel of the views, or the grid would not fit into its memory.
    #[error("a voxel of {wanted} is too fine: use {} or more", rounded_up(*least))]
    TooFine {
        /// Wanted side of a voxel, units of the poses' world.
        wanted: f64,
        /// Smallest possible side.
        least: f64,
    },
    /// The wanted voxel leads to more than the wanted triangles.
    #[error(
        "the mesh would have {triangles} triangles, more than {most}: take a larger voxel, or leave it out"
    )]
    TooMany {
        /// Triangles of the mesh.
        triangles: usize,
        /// Wanted triangles.
        most: usize,
    },
    /// No mesh has so few triangles.
    #[error("nothing is left of the mesh with at most {0} triangles: allow more")]
    TooFew(usize),
    /// The scene cannot be rendered.
    #[error(transparent)]
    Render(#[from] SplatError),
}

/// A number with three digits, not below the given one.
fn rounded_up(value: f64) -> String {
    let digits = 2 - value.log10().floor() as i32;
    let rounded = (value * 10f64.powi(digits)).ceil() / 10f64.powi(digits);
    format!("{rounded:.*}", digits.max(0) as usize)
}

/// Makes the mesh of a scene from its cameras, which are in the world of the poses.
///
/// # Errors
/// [`MeshError`].
pub fn of(scene: &Scene, cameras: &[NamedCamera], detail: Detail) -> Result<Mesh, MeshError> {
    let normalisation = scene.normalisation;
    let mut views = views(scene, cameras)?;
    let pixel = view::without_far_depths(&mut views).ok_or(MeshError::Nothing)?;
    let wanted = detail.voxel.map(|side| (side * normalisation.scale) as f32);
    let mut voxel = wanted.map_or(VOXEL * pixel, |side| side.max(pixel));
    let places = loop {
        match grid::blocks(&views, scale(voxel, pixel)) {
            Some(places) => break places,
            None => voxel *= GROWTH,
        }
    };
    if let (Some(wanted), Some(side)) = (detail.voxel, wanted)
        && voxel > side
    {
        return Err(MeshError::TooFine { wanted, least: f64::from(voxel) / normalisation.scale });
    }
    let (surface, voxel) = limited(&views, pixel, detail, (places, voxel))?;
    let [seen, met] = coverage::of(&views, &surface, 2.0 * voxel);
    let facts = Facts {
        voxel: f64::from(voxel) / normalisation.scale,
        triangles: surface.triangles.len(),
        boundary_edges: surface.boundary_edges(),
        seen,
        met,
    };
    Ok(finished(surface, facts, normalisation))
}

/// The lengths of a grid with this voxel, by a pixel's side at the median depth.
fn scale(voxel: f32, pixel: f32) -> Scale {
    let truncation = (TRUNCATION[0] * VOXEL * pixel).max(TRUNCATION[1] * voxel);
    Scale { voxel, truncation }
}

/// The surface with at most the wanted triangles, and its voxel, which grows for that from the
/// given one, whose blocks have these places.
fn limited(
    views: &[View],
    pixel: f32,
    detail: Detail,
    (places, mut voxel): (Vec<IVec3>, f32),
) -> Result<(Surface, f32), MeshError> {
    let surface = |places, voxel| {
        cubes::surface(&Grid::fused(places, views, scale(voxel, pixel))).without_crumbs()
    };
    let most = detail.triangles.or(detail.voxel.is_none().then_some(TRIANGLES));
    let mut found = surface(places, voxel);
    if found.triangles.is_empty() {
        return Err(MeshError::Nothing);
    }
    while let Some(most) = most.filter(|most| found.triangles.len() > *most) {
        if detail.voxel.is_some() {
            return Err(MeshError::TooMany { triangles: found.triangles.len(), most });
        }
        let ratio = found.triangles.len() as f32 / most as f32;
        let [least, largest] = TRIANGLE_GROWTH;
        voxel *= ratio.sqrt().clamp(least, largest);
        // Fewer blocks than before, which fitted.
        found = surface(grid::blocks(views, scale(voxel, pixel)).unwrap_or_default(), voxel);
        if found.triangles.is_empty() {
            return Err(MeshError::TooFew(most));
        }
    }
    Ok((found, voxel))
}

/// The depths and colours that the cameras see, in the training world.
fn views(scene: &Scene, cameras: &[NamedCamera]) -> Result<Vec<View>, MeshError> {
    let device = Device::new(PROCESSOR).map_err(SplatError::from)?;
    let renderer = Renderer::new(&device);
    let pixels: f64 =
        cameras.iter().map(|c| (c.intrinsics.width * c.intrinsics.height) as f64).sum();
    let scale = (PIXELS / pixels).sqrt().min(1.0);
    let colours = renderer.upload(&scene.gaussians)?;
    let view = |named: &NamedCamera| {
        let camera = scene.normalisation.within(&named.camera());
        let [width, height] = camera.size().map(|side| ((side as f64 * scale) as usize).max(1));
        let camera = camera.resized(width, height);
        let depth = renderer.depth(&scene.gaussians, &camera)?;
        let colour = renderer.render_scene(&colours, &camera)?;
        Ok(View::new(&camera, &depth, &colour))
    };
    cameras.iter().map(view).collect()
}

/// The mesh of a surface in the training world.
fn finished(surface: Surface, facts: Facts, normalisation: Normalisation) -> Mesh {
    let normals = surface.normals();
    let missing = normalisation.missing_in_files();
    let place = |at: &Vec3| (normalisation.point_in_world(at.as_dvec3()) - missing).as_vec3();
    Mesh {
        positions: surface.positions.iter().map(place).collect(),
        normals,
        colours: surface.colours,
        triangles: surface.triangles,
        facts,
        normalisation,
    }
}

#[cfg(test)]
mod tests;
