//! The requested viewpoint of a picture of a scene, and the camera that renders it.

use crate::camera::orbit::Orbit;
use crate::camera::{Camera, Intrinsics, NamedCamera};
use crate::capture::view_names;

/// The viewpoint of a picture of the scene.
#[derive(Clone, Debug, PartialEq)]
pub enum Viewpoint {
    /// The camera of the view with this name, or of the photograph with this name.
    View(String),
    /// On an orbit around the scene; see [`Orbit::camera`].
    Orbit {
        /// Degrees to the right of the middle of the photographers.
        azimuth: f64,
        /// Degrees above them.
        elevation: f64,
        /// Times their median distance from the centre, 0.01..=100.
        distance: f64,
    },
    /// A camera given by the caller.
    Pose(Camera),
}

/// Why a viewpoint is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ViewpointError {
    /// The run has no view with this name.
    #[error("no view `{name}`; there are {known}")]
    UnknownView {
        /// The requested name.
        name: String,
        /// The run's views.
        known: String,
    },
    /// The run's cameras do not determine where the scene is.
    #[error("the cameras of this run span no orbit")]
    NoOrbit,
    /// An angle of the orbit is more than a full turn: as an `f64` it soon means nothing.
    #[error("`{0}` is not in -360..=360")]
    Angle(&'static str),
    /// The orbit is too near or too far.
    #[error("`distance` is not in 0.01..=100")]
    Distance,
}

/// The requested size, px. A missing side follows the view's proportions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PictureSize {
    /// px.
    pub width: Option<usize>,
    /// px.
    pub height: Option<usize>,
}

impl From<Option<(usize, usize)>> for PictureSize {
    fn from(sides: Option<(usize, usize)>) -> Self {
        Self { width: sides.map(|(width, _)| width), height: sides.map(|(_, height)| height) }
    }
}

impl PictureSize {
    /// Width and height of a picture for a camera of size `own`.
    fn resolve(self, own: &Intrinsics) -> (usize, usize) {
        let in_proportion = |side: usize, this: usize, other: usize| {
            let scaled = side as f64 * other as f64 / this as f64;
            (scaled.round() as usize).max(1)
        };
        match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, in_proportion(width, own.width, own.height)),
            (None, Some(height)) => (in_proportion(height, own.height, own.width), height),
            (None, None) => (own.width, own.height),
        }
    }
}

impl Viewpoint {
    /// The camera of a picture of this size, for the scene whose views have these cameras. Pixels
    /// stay as square as the photograph's: a picture with other proportions shows all of the
    /// photograph's field of view, and more beside it.
    ///
    /// # Errors
    /// [`ViewpointError`].
    pub fn camera(
        &self,
        cameras: &[NamedCamera],
        size: PictureSize,
    ) -> Result<Camera, ViewpointError> {
        match self {
            Self::View(name) => Ok(fitted(&view_named(name, cameras)?.camera(), size)),
            Self::Pose(camera) => Ok(fitted(camera, size)),
            Self::Orbit { azimuth, elevation, distance } => {
                let azimuth = angle("azimuth", *azimuth)?;
                let elevation = angle("elevation", *elevation)?;
                if !(0.01..=100.0).contains(distance) {
                    return Err(ViewpointError::Distance);
                }
                let first = cameras.first().ok_or(ViewpointError::NoOrbit)?;
                let orbit = Orbit::from_cameras(cameras).ok_or(ViewpointError::NoOrbit)?;
                let sides = size.resolve(&first.intrinsics);
                Ok(orbit.camera(azimuth, elevation, *distance, sides))
            }
        }
    }
}

/// The view of this name, or of the photograph of this name, with its extension or without.
///
/// # Errors
/// [`ViewpointError::UnknownView`].
pub fn view_named<'a>(
    name: &str,
    cameras: &'a [NamedCamera],
) -> Result<&'a NamedCamera, ViewpointError> {
    let named = |name: &str| cameras.iter().find(|camera| camera.name == *name);
    let taken = |photograph: &str| named(&view_names([photograph].into_iter())[0]);
    // With its extension, or a name without one that contains a dot.
    let view = named(name).or_else(|| taken(name)).or_else(|| taken(&format!("{name}.")));
    view.ok_or_else(|| unknown(name, cameras))
}

fn unknown(name: &str, cameras: &[NamedCamera]) -> ViewpointError {
    let known: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    ViewpointError::UnknownView { name: name.to_owned(), known: known.join(", ") }
}

/// Checks an angle in degrees.
fn angle(name: &'static str, degrees: f64) -> Result<f64, ViewpointError> {
    if degrees.abs() <= 360.0 { Ok(degrees) } else { Err(ViewpointError::Angle(name)) }
}

/// The same pose for a picture of another size: one scale for both axes, so that the whole field of
/// view is visible, and the principal point at the same distance from the centre.
fn fitted(camera: &Camera, size: PictureSize) -> Camera {
    let own = &camera.intrinsics;
    let (width, height) = size.resolve(own);
    if (width, height) == (own.width, own.height) {
        return *camera;
    }
    let scale = (width as f64 / own.width as f64).min(height as f64 / own.height as f64);
    let (right, down) = (own.cx - own.width as f64 / 2.0, own.cy - own.height as f64 / 2.0);
    let intrinsics = Intrinsics {
        width,
        height,
        fx: own.fx * scale,
        fy: own.fy * scale,
        cx: width as f64 / 2.0 + right * scale,
        cy: height as f64 / 2.0 + down * scale,
    };
    Camera { intrinsics, ..*camera }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::camera::Split;

    fn cameras() -> Vec<NamedCamera> {
        let intrinsics =
            Intrinsics { width: 200, height: 100, fx: 150.0, fy: 150.0, cx: 104.0, cy: 47.0 };
        let camera = |x: f64| {
            let eye = DVec3::new(x, -0.2, -4.0);
            Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y)
        };
        ["a", "b", "c"]
            .into_iter()
            .zip([-1.0, 0.0, 1.0])
            .map(|(name, x)| NamedCamera::new(name, &camera(x), Split::Train))
            .collect()
    }

    fn everywhere() -> [Viewpoint; 3] {
        let orbit = Viewpoint::Orbit { azimuth: 10.0, elevation: 5.0, distance: 1.0 };
        let pose = Viewpoint::Pose(cameras()[2].camera());
        [Viewpoint::View("b".to_owned()), orbit, pose]
    }

    #[test]
    fn a_picture_of_other_proportions_keeps_square_pixels_and_shows_the_whole_view() {
        for viewpoint in everywhere() {
            for (width, height) in [(50, 50), (400, 100), (64, 333)] {
                let size = PictureSize::from(Some((width, height)));
                let camera = viewpoint.camera(&cameras(), size).expect("a camera");
                let k = camera.intrinsics;
                assert_eq!((k.width, k.height), (width, height), "{viewpoint:?}");
                assert_eq!(k.fx, k.fy, "{viewpoint:?} at {width}x{height}");
                // The shorter side keeps the photograph's field of view; the other grows.
                let own = [200.0 / 150.0, 100.0 / 150.0];
                let seen = [width as f64 / k.fx, height as f64 / k.fy];
                let grown = [seen[0] / own[0], seen[1] / own[1]];
                assert!((grown[0].min(grown[1]) - 1.0).abs() < 1e-12, "{grown:?}");
            }
        }
    }

    #[test]
    fn without_a_size_a_view_is_its_own_camera_and_one_side_gives_the_other() {
        let view = Viewpoint::View("b".to_owned());
        let own = cameras()[1].camera();
        let camera = |size| view.camera(&cameras(), size).expect("a camera");
        assert_eq!(camera(PictureSize::default()), own);
        let width_only = PictureSize { width: Some(100), height: None };
        assert_eq!(camera(width_only), own.resized(100, 50));
        let height_only = PictureSize { width: None, height: Some(200) };
        assert_eq!(camera(height_only), own.resized(400, 200));
    }

    #[test]
    fn a_view_is_found_by_its_own_name_and_its_photographs() {
        let mut cameras = cameras();
        for (camera, name) in cameras.iter_mut().zip(["003", "cam0_K_che_1", "004_jpg"]) {
            camera.name = name.to_owned();
        }
        for (name, at) in [
            ("003", 0),
            ("003.png", 0),
            ("003.JPG", 0),
            ("cam0/Küche 1.heic", 1),
            ("cam0_K_che_1", 1),
            ("004_jpg", 2),
            ("004.jpg.png", 2),
            ("004.jpg", 2),
        ] {
            let view = Viewpoint::View(name.to_owned());
            let camera = view.camera(&cameras, PictureSize::default()).expect(name);
            assert_eq!(camera, cameras[at].camera(), "{name}");
        }
        let other = Viewpoint::View("cam1/003.png".to_owned());
        let error = other.camera(&cameras, PictureSize::default()).expect_err("another folder");
        assert_eq!(
            error.to_string(),
            "no view `cam1/003.png`; there are 003, cam0_K_che_1, 004_jpg"
        );
    }

    #[test]
    fn invalid_viewpoints_give_a_reason() {
        let cameras = cameras();
        let why = |viewpoint: Viewpoint, cameras: &[NamedCamera]| {
            viewpoint.camera(cameras, PictureSize::default()).expect_err("no camera")
        };
        let orbit =
            |azimuth: f64, distance: f64| Viewpoint::Orbit { azimuth, elevation: 0.0, distance };
        assert_eq!(
            why(Viewpoint::View("d".to_owned()), &cameras).to_string(),
            "no view `d`; there are a, b, c"
        );
        assert_eq!(why(orbit(0.0, 1.0), &[]), ViewpointError::NoOrbit);
        for azimuth in [f64::NAN, f64::INFINITY, 1e300, -360.5] {
            assert_eq!(why(orbit(azimuth, 1.0), &cameras), ViewpointError::Angle("azimuth"));
        }
        assert!(orbit(-360.0, 1.0).camera(&cameras, PictureSize::default()).is_ok());
        assert_eq!(why(orbit(0.0, f64::NAN), &cameras), ViewpointError::Distance);
        assert_eq!(why(orbit(0.0, 0.0), &cameras), ViewpointError::Distance);
    }
}
