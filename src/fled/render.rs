//! `fled render`: a picture of a finished run's scene from any side.

use std::path::{Path, PathBuf};

use fled_core::camera::orbit::Orbit;
use fled_core::camera::{Camera, Intrinsics, NamedCamera};
use fled_core::gaussians::ply;
use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_core::render::Renderer;
use fled_gpu::Gpu;

use crate::failure::{Failure, io};

/// Arguments of `fled render`.
#[derive(clap::Args)]
pub struct Args {
    /// Output folder of `fled run`.
    run: PathBuf,
    /// Where the picture goes: .png, .webp (both lossless) or .jpg.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    from: From,
    /// Height above the horizon, degrees; with --azimuth.
    #[arg(
        long,
        default_value_t = 0.0,
        allow_negative_numbers = true,
        requires = "azimuth"
    )]
    elevation: f64,
    /// Distance from the scene's centre as a multiple of the cameras' mean; with --azimuth.
    #[arg(long, default_value_t = 1.0, requires = "azimuth")]
    distance: f64,
    /// Width and height in px; default: the views' own.
    #[arg(long, value_parser = crate::synth::size)]
    size: Option<(usize, usize)>,
    /// A round's scene instead of the delivered one.
    #[arg(long)]
    round: Option<u32>,
    /// Part of an adapter's name, or auto.
    #[arg(long, default_value = "auto")]
    adapter: String,
}

/// Where the camera stands.
#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct From {
    /// At the camera of this view.
    #[arg(long)]
    view: Option<String>,
    /// Around the scene's centre, degrees from the cameras' mean direction.
    #[arg(long, allow_negative_numbers = true)]
    azimuth: Option<f64>,
    /// A JSON file with width, height, fx, fy, cx, cy and world_to_camera (4x4, row-major).
    #[arg(long, value_name = "FILE")]
    pose: Option<PathBuf>,
}

/// Renders one picture.
///
/// # Errors
/// [`Failure`] when the run, the view or the adapter is not there.
pub fn main(args: &Args) -> Result<(), Failure> {
    let cameras = read_cameras(&args.run.join("cameras.json"))?;
    let camera = camera(args, &cameras)?;
    let scene = match args.round {
        Some(round) => args
            .run
            .join("rounds")
            .join(round.to_string())
            .join("scene.ply"),
        None => args.run.join("scene.ply"),
    };
    let gaussians = ply::read(&scene).map_err(|e| Failure::from(PipelineError::from(e)))?;
    let gpu = Gpu::new(&args.adapter).map_err(|e| Failure::new(ErrorKind::Environment, e))?;
    let render = |e| Failure::from(PipelineError::from(e));
    let renderer = Renderer::new(&gpu);
    let picture = renderer
        .render(&gaussians, &camera, gaussians.sh_degree)
        .map_err(render)?;
    picture
        .save(&args.output)
        .map_err(|e| Failure::new(ErrorKind::Io, e))
}

fn read_cameras(path: &Path) -> Result<Vec<NamedCamera>, Failure> {
    let bytes = std::fs::read(path).map_err(io(path))?;
    serde_json::from_slice(&bytes)
        .map_err(|e| Failure::new(ErrorKind::BadInput, format!("{}: {e}", path.display())))
}

fn camera(args: &Args, cameras: &[NamedCamera]) -> Result<Camera, Failure> {
    let camera = if let Some(name) = &args.from.view {
        let known = || {
            cameras
                .iter()
                .map(|camera| camera.name.as_str())
                .collect::<Vec<_>>()
                .join(", ")
        };
        cameras
            .iter()
            .find(|camera| camera.name == *name)
            .ok_or_else(|| Failure::usage(format!("no view `{name}`; there are {}", known())))?
            .camera()
    } else if let Some(path) = &args.from.pose {
        let bytes = std::fs::read(path).map_err(io(path))?;
        let mut value: serde_json::Value = serde_json::from_slice(&bytes)
            .map_err(|e| Failure::usage(format!("{}: {e}", path.display())))?;
        if let Some(object) = value.as_object_mut() {
            object.entry("name").or_insert_with(|| "pose".into());
            object.entry("split").or_insert_with(|| "held_out".into());
        }
        let named: NamedCamera = serde_json::from_value(value)
            .map_err(|e| Failure::usage(format!("{}: {e}", path.display())))?;
        named.camera()
    } else {
        let orbit = Orbit::from_cameras(cameras).ok_or_else(|| {
            Failure::usage("the run's cameras say nothing about where the scene is")
        })?;
        let first = orbit_size(cameras);
        let azimuth = args.from.azimuth.unwrap_or_default();
        return Ok(orbit.camera(
            azimuth,
            args.elevation,
            args.distance,
            args.size.unwrap_or(first),
        ));
    };
    Ok(match args.size {
        Some((width, height)) => fitted(&camera, width, height),
        None => camera,
    })
}

/// The size of the first view.
fn orbit_size(cameras: &[NamedCamera]) -> (usize, usize) {
    cameras.first().map_or((1, 1), |camera| {
        (camera.intrinsics.width, camera.intrinsics.height)
    })
}

/// The same pose and vertical field of view in a picture of another size, pixels kept square.
fn fitted(camera: &Camera, width: usize, height: usize) -> Camera {
    let k = camera.intrinsics;
    let scale = height as f64 / k.height as f64;
    let shift = (k.cx - k.width as f64 / 2.0) * scale;
    let intrinsics = Intrinsics {
        width,
        height,
        fx: k.fx * scale,
        fy: k.fy * scale,
        cx: width as f64 / 2.0 + shift,
        cy: k.cy * scale,
    };
    Camera {
        intrinsics,
        ..*camera
    }
}
