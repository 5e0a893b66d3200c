//! The part of a scene to export, and its unit of length.

use crate::camera::{NamedCamera, upright};
use crate::gaussians::crop::{Crop, EmptyCrop};
use crate::gaussians::placement::Placement;
use crate::gaussians::ply::Scene;
use crate::mesh::Detail;

/// Highest degree of the harmonics.
pub const MOST_SH_DEGREE: u32 = 3;

/// Least and largest scale: beyond them 32-bit numbers do not hold a scene.
pub const SCALE_LIMITS: [f64; 2] = [1e-6, 1e6];

/// How an export differs from the scene; by default it does not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trim {
    /// Where Gaussians are kept.
    pub crop: Option<Crop>,
    /// Degree of the harmonics, 0 to [`MOST_SH_DEGREE`]: the scene's are cut, or padded with zeros.
    pub sh_degree: Option<u32>,
    /// Units of the export, such as metres, per unit of the poses' world, if not 1.
    pub scale: Option<f64>,
    /// How fine a mesh is.
    pub mesh: Detail,
}

impl Trim {
    /// Checks a scale.
    ///
    /// # Errors
    /// The rest of a sentence if it is outside [`SCALE_LIMITS`].
    pub fn scale(wanted: f64) -> Result<f64, String> {
        let [least, most] = SCALE_LIMITS;
        if (least..=most).contains(&wanted) {
            return Ok(wanted);
        }
        Err(format!("must be from {least} to {most}, not {wanted}"))
    }

    /// Whether it changes nothing of the scene.
    pub fn is_nothing(&self) -> bool {
        self.keeps_all() && self.scale.is_none()
    }

    /// Whether it leaves nothing of the scene out, and adds nothing.
    pub(super) fn keeps_all(&self) -> bool {
        self.crop.is_none() && self.sh_degree.is_none()
    }

    /// Where the export lies, if its format has a place for it; `is_map` if the cameras' world is
    /// that of a map.
    pub(super) fn placement(&self, cameras: &[NamedCamera], is_map: bool) -> Placement {
        let cameras: Vec<_> = cameras.iter().map(NamedCamera::camera).collect();
        let up = if is_map { upright::up_of_map(&cameras) } else { upright::up(&cameras) };
        let Placement { scale, up: usual } = Placement::default();
        Placement { scale: self.scale.unwrap_or(scale), up: up.unwrap_or(usual) }
    }

    /// The rest of a scene. Scale and fineness of a mesh do not change the scene.
    ///
    /// # Errors
    /// [`EmptyCrop`].
    pub(super) fn of(&self, scene: Scene) -> Result<Scene, EmptyCrop> {
        let mut scene = scene.within(self.crop)?;
        if let Some(degree) = self.sh_degree {
            scene.gaussians = scene.gaussians.with_sh_degree(degree);
        }
        Ok(scene)
    }
}
