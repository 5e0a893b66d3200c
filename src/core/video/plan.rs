//! The request for a video.

use glam::DMat3;
use serde::{Deserialize, Serialize};

use super::flight;
use crate::camera::orbit::Orbit;
use crate::camera::{Camera, NamedCamera, Split};
use crate::gaussians::crop::Crop;
use crate::run_folder::{PictureSize, Viewpoint};

/// Maximum duration, s.
pub const MOST_SECONDS: f64 = 60.0;

/// Maximum pictures a second.
pub const MOST_FPS: u32 = 30;

/// Longest side, px.
pub const MOST_SIDE: usize = 1920;

/// Maximum number of poses of a path.
pub const MOST_POSES: usize = 100;

/// Shortest side, px.
const LEAST_SIDE: usize = 64;

/// Default duration, s.
const SECONDS: f64 = 8.0;

/// Default pictures a second.
const FPS: u32 = 24;

/// Largest number in a pose: UTM in millimetres has 1e10.
const LARGEST: f64 = 1e12;

/// The kind of camera path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Around the centre of the scene.
    Orbit,
    /// Through the cameras of the photographs.
    Cameras,
    /// Through given poses.
    Path,
}

/// A pose on a path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Key {
    /// Rigid, row-major; OpenCV axes.
    pub world_to_camera: [[f64; 4]; 4],
    /// Duration of the path from the previous pose; ignored for the first.
    #[serde(default)]
    pub seconds: f64,
}

/// The request for a video.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The kind of camera path.
    pub kind: Kind,
    /// Duration, 1..=60; default 8. A path takes it from its poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Pictures a second, 1..=30; default 24.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fps: Option<u32>,
    /// px, 64..=1920, an odd one is one less; default: the views', or in proportion to the height.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<usize>,
    /// px, 64..=1920, an odd one is one less; default: the views', or in proportion to the width.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<usize>,
    /// The round; default: the delivered one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub round: Option<u32>,
    /// The part of the scene to show; default: all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<Crop>,
    /// For an orbit, the arc in total: 360 is once around, less a swing to both sides and back;
    /// default: the arc of the photographers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees: Option<f64>,
    /// For an orbit, degrees above the photographers; default 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elevation: Option<f64>,
    /// For an orbit, times the photographers' median distance from the centre; default 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance: Option<f64>,
    /// For a path, the poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poses: Option<Vec<Key>>,
}

/// Why a plan is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct PlanError {
    /// The field at fault.
    pub field: &'static str,
    /// A sentence without its full stop.
    pub message: String,
}

impl PlanError {
    fn new(field: &'static str, message: impl Into<String>) -> Self {
        Self { field, message: message.into() }
    }
}

impl Plan {
    /// A video of this kind, with defaults.
    pub fn new(kind: Kind) -> Self {
        Self {
            kind,
            seconds: None,
            fps: None,
            width: None,
            height: None,
            round: None,
            crop: None,
            degrees: None,
            elevation: None,
            distance: None,
            poses: None,
        }
    }

    /// Pictures a second.
    pub fn fps(&self) -> u32 {
        self.fps.unwrap_or(FPS)
    }

    /// Its duration, s.
    pub fn seconds(&self) -> f64 {
        let poses = self.poses.iter().flatten().skip(1);
        match self.kind {
            Kind::Path => poses.map(|key| key.seconds).sum(),
            _ => self.seconds.unwrap_or(SECONDS),
        }
    }

    /// Its number of pictures.
    pub fn frames(&self) -> usize {
        ((self.seconds() * f64::from(self.fps())).round() as usize).max(1)
    }

    /// Checks that all fields are within their bounds and belong to the kind.
    ///
    /// # Errors
    /// [`PlanError`] for the first that is not.
    pub fn check(&self) -> Result<(), PlanError> {
        let of_kinds: [(&'static str, bool, &[Kind]); 5] = [
            ("seconds", self.seconds.is_some(), &[Kind::Orbit, Kind::Cameras]),
            ("degrees", self.degrees.is_some(), &[Kind::Orbit]),
            ("elevation", self.elevation.is_some(), &[Kind::Orbit]),
            ("distance", self.distance.is_some(), &[Kind::Orbit]),
            ("poses", self.poses.is_some(), &[Kind::Path]),
        ];
        for (field, is_said, kinds) in of_kinds {
            if is_said && !kinds.contains(&self.kind) {
                let message = format!("`{field}` means nothing for this kind of video");
                return Err(PlanError::new(field, message));
            }
        }
        self.check_path()?;
        let side = |side: Option<usize>| side.unwrap_or(LEAST_SIDE) as f64;
        let sides = LEAST_SIDE as f64..=MOST_SIDE as f64;
        let bounds = [
            ("seconds", self.seconds(), 1.0..=MOST_SECONDS),
            ("fps", f64::from(self.fps()), 1.0..=f64::from(MOST_FPS)),
            ("width", side(self.width), sides.clone()),
            ("height", side(self.height), sides),
            ("degrees", self.degrees.unwrap_or(360.0), 1.0..=360.0),
            ("elevation", self.elevation.unwrap_or(0.0), -60.0..=60.0),
            ("distance", self.distance.unwrap_or(1.0), 0.1..=10.0),
        ];
        for (field, value, bounds) in bounds {
            if !bounds.contains(&value) {
                let (least, most) = (bounds.start(), bounds.end());
                let message = format!("`{field}` is {value}, not within {least} and {most}");
                return Err(PlanError::new(field, message));
            }
        }
        Ok(())
    }

    fn check_path(&self) -> Result<(), PlanError> {
        if self.kind != Kind::Path {
            return Ok(());
        }
        let poses = self.poses.as_deref().unwrap_or_default();
        if !(2..=MOST_POSES).contains(&poses.len()) {
            let message = format!("a path has 2 to {MOST_POSES} `poses`, not {}", poses.len());
            return Err(PlanError::new("poses", message));
        }
        for (number, key) in (1..).zip(poses) {
            if !key.is_rigid() {
                let message = format!(
                    "`world_to_camera` of pose {number} is no rotation and translation, row by \
                     row, with 0 0 0 1 below"
                );
                return Err(PlanError::new("poses", message));
            }
            let takes_time = key.seconds.is_finite() && key.seconds >= 0.05;
            if number > 1 && !takes_time {
                let message = format!("`seconds` of pose {number} is not 0.05 or more");
                return Err(PlanError::new("poses", message));
            }
        }
        Ok(())
    }

    /// The camera of every picture, for a scene whose views have these cameras; all have one size,
    /// with even sides, as H.264 requires.
    ///
    /// # Errors
    /// [`PlanError`] for a plan that is out of bounds, and for cameras that do not determine a
    /// path.
    pub fn cameras(&self, views: &[NamedCamera]) -> Result<Vec<Camera>, PlanError> {
        self.check()?;
        let nowhere = |why: &str| PlanError::new("kind", why.to_owned());
        let orbit = Orbit::from_cameras(views);
        let (Some(first), Some(orbit)) = (views.first(), orbit) else {
            return Err(nowhere("the cameras of this scene do not say where it is"));
        };
        let sides = self.sides(first)?;
        let frames = self.frames();
        if self.kind == Kind::Orbit {
            let degrees = self.degrees.unwrap_or_else(|| flight::arc(&orbit, views));
            let (elevation, distance) = (self.elevation.unwrap_or(0.0), self.distance);
            let camera = |index: usize| {
                let azimuth = flight::azimuth(degrees, index as f64 / frames as f64);
                orbit.camera(azimuth, elevation, distance.unwrap_or(1.0), sides)
            };
            return Ok((0..frames).map(camera).collect());
        }
        let way = match self.kind {
            Kind::Path => flight::along(self.keys(first), frames),
            _ => flight::through(views, orbit.radius, frames),
        };
        let way = way.ok_or_else(|| nowhere("the photographs were taken from one place"))?;
        let size = PictureSize::from(Some(sides));
        let fitted = |camera: &Camera| {
            let fitted = Viewpoint::Pose(*camera).camera(views, size);
            fitted.map_err(|error| nowhere(&error.to_string()))
        };
        way.iter().map(fitted).collect()
    }

    /// The poses, each at its time, with the first view's field of view.
    fn keys(&self, first: &NamedCamera) -> Vec<(f64, Camera)> {
        let mut time = 0.0;
        let poses = self.poses.iter().flatten().enumerate();
        let key = |(index, key): (usize, &Key)| {
            time += if index > 0 { key.seconds } else { 0.0 };
            let named = NamedCamera {
                world_to_camera: key.world_to_camera,
                ..NamedCamera::new("", &first.camera(), Split::Train)
            };
            (time, named.camera())
        };
        poses.map(key).collect()
    }

    /// Width and height: even, and within bounds.
    fn sides(&self, first: &NamedCamera) -> Result<(usize, usize), PlanError> {
        let own = first.intrinsics;
        let (wide, high) = (own.width as f64, own.height as f64);
        let asked = |side: Option<usize>| side.map(|side| side as f64);
        let (width, height) = match (asked(self.width), asked(self.height)) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, width * high / wide),
            (None, Some(height)) => (height * wide / high, height),
            (None, None) => {
                // Views of any size give a valid video.
                let scale = (MOST_SIDE as f64 / wide.max(high)).min(1.0);
                let scale = scale.max(LEAST_SIDE as f64 / wide.min(high));
                (wide * scale, high * scale)
            }
        };
        let even = |side: f64| side.round() as usize / 2 * 2;
        let sides = (even(width), even(height));
        let allowed = LEAST_SIDE..=MOST_SIDE;
        if allowed.contains(&sides.0) && allowed.contains(&sides.1) {
            return Ok(sides);
        }
        let message = format!(
            "a video of {} x {} px is not within {LEAST_SIDE} and {MOST_SIDE} px",
            sides.0, sides.1
        );
        Err(PlanError::new("width", message))
    }
}

impl Key {
    /// Whether it is a rotation and a translation with numbers in a usable range.
    fn is_rigid(&self) -> bool {
        let rows = &self.world_to_camera;
        let column = |i: usize| glam::DVec3::new(rows[0][i], rows[1][i], rows[2][i]);
        let rotation = DMat3::from_cols(column(0), column(1), column(2));
        let deviation = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
        rows.iter().flatten().all(|value| value.abs() <= LARGEST)
            && deviation.iter().all(|d| d.abs() < 1e-3)
            && rotation.determinant() > 0.0
            && rows[3] == [0.0, 0.0, 0.0, 1.0]
    }
}
