//! `fled render`: an image of a finished run's scene from any viewpoint.

use std::path::{Path, PathBuf};

use fled_core::camera::{Camera, NamedCamera};
use fled_core::device::Device;
use fled_core::exposure::Gains;
use fled_core::gaussians::crop::Crop;
use fled_core::gaussians::ply::{self, Scene};
use fled_core::metrics::Report;
use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_core::render::Renderer;
use fled_core::run_folder::{PictureSize, RunFolder, Viewpoint, view_named};

use crate::failure::{Failure, io};

/// Arguments of `fled render`.
#[derive(clap::Args)]
pub struct Args {
    /// Output folder of `fled run`.
    run: PathBuf,
    /// Output file: .png, .webp (both lossless) or .jpg; with --linear .tif.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    from: From,
    /// Degrees above the horizon; with --azimuth.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, requires = "azimuth")]
    elevation: f64,
    /// Distance from the scene's centre as a multiple of the cameras' mean distance; with
    /// --azimuth.
    #[arg(long, default_value_t = 1.0, requires = "azimuth")]
    distance: f64,
    /// Width and height in px [default: those of the views].
    #[arg(long, value_parser = crate::synth::size)]
    size: Option<(usize, usize)>,
    /// Renders depth instead of colour: near is white, far is dark.
    #[arg(long)]
    depth: bool,
    /// Brightens the linear light by this many stops; negative values darken it.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = stops,
        conflicts_with = "depth")]
    ev: f64,
    /// Writes linear light as a TIFF of 16 bits, for colour grading; light above white is clipped
    /// (lower it with --ev).
    #[arg(long, conflicts_with = "depth")]
    linear: bool,
    /// Gives the picture the exposure and tint of the view's photograph, which the scene evens.
    #[arg(long, requires = "view", conflicts_with = "depth")]
    as_photographed: bool,
    /// Uses this round's scene instead of the delivered one.
    #[arg(long)]
    round: Option<u32>,
    /// Shows only the Gaussians whose centres are in box:X,Y,Z,WIDTH,HEIGHT,DEPTH or
    /// sphere:X,Y,Z,RADIUS, in the world of the poses.
    #[arg(long, value_name = "SHAPE")]
    crop: Option<Crop>,
    /// The device: auto, cpu, or part of a Vulkan adapter's name.
    #[arg(long, default_value = "auto")]
    adapter: String,
}

/// Maximum stops of brightening or darkening.
const MOST_STOPS: f64 = 16.0;

/// Where the camera stands.
#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct From {
    /// Renders from the camera of this view, or of the photograph of this name.
    #[arg(long)]
    view: Option<String>,
    /// Renders from an orbit around the scene's centre: degrees from the cameras' mean direction.
    #[arg(long, allow_negative_numbers = true)]
    azimuth: Option<f64>,
    /// Renders from the camera in a JSON file with width, height, fx, fy, cx, cy and
    /// world_to_camera (4x4, row-major).
    #[arg(long, value_name = "FILE")]
    pose: Option<PathBuf>,
}

/// Renders one image.
///
/// # Errors
/// [`Failure`] if the run, the view or the adapter is missing.
pub fn main(args: &Args) -> Result<(), Failure> {
    check_format(args)?;
    let run = RunFolder::new(&args.run);
    let cameras = read_cameras(&run.cameras())?;
    let camera =
        viewpoint(args)?.camera(&cameras, PictureSize::from(args.size)).map_err(Failure::usage)?;
    let scene = run.scene_of(args.round);
    let scene = read_scene(&scene, args.crop)?;
    let (gaussians, camera) = (scene.gaussians, scene.normalisation.within(&camera));
    let device = Device::new(&args.adapter).map_err(|e| Failure::new(ErrorKind::Environment, e))?;
    let render = |e| Failure::from(PipelineError::from(e));
    let renderer = Renderer::new(&device);
    let picture = if args.depth {
        let depth = renderer.depth(&gaussians, &camera).map_err(render)?;
        depth.picture()
    } else {
        let delivered =
            renderer.render(&gaussians, &camera, gaussians.sh_degree).map_err(render)?;
        gains(args, &run, &cameras)?.expose(&delivered).exposed(args.ev)
    };
    let written = if args.linear {
        picture.to_linear().save_tiff(&args.output)
    } else {
        picture.save(&args.output)
    };
    written.map_err(|e| Failure::new(ErrorKind::Io, e))
}

/// # Errors
/// [`Failure`] if the output's extension is not that of the format that is asked for.
fn check_format(args: &Args) -> Result<(), Failure> {
    let extension = args.output.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let is_tiff = ["tif", "tiff"].iter().any(|tiff| extension.eq_ignore_ascii_case(tiff));
    let refused = match (args.linear, is_tiff) {
        (true, false) => "--linear writes a TIFF: name the output file .tif",
        (false, true) => "a TIFF is written in linear light: add --linear, or name the file .png",
        _ => return Ok(()),
    };
    Err(Failure::usage(refused))
}

/// The exposure that the picture gets: that of the view's photograph, relative to the scene's.
fn gains(args: &Args, run: &RunFolder, cameras: &[NamedCamera]) -> Result<Gains, Failure> {
    let Some(name) = args.from.view.as_ref().filter(|_| args.as_photographed) else {
        return Ok(Gains::default());
    };
    let view = view_named(name, cameras).map_err(Failure::usage)?;
    let path = run.metrics();
    let bytes = std::fs::read(&path).map_err(io(&path))?;
    let report: Report = serde_json::from_slice(&bytes)
        .map_err(|e| Failure::new(ErrorKind::BadInput, format!("{}: {e}", path.display())))?;
    let Some(exposure) = report.exposure else {
        return Err(Failure::usage("the run left the photographs as taken (exposure=as_taken)"));
    };
    let Some(of) = exposure.views.get(&view.name) else {
        return Err(Failure::usage(format!("the exposure of {name} was not found")));
    };
    Ok(Gains::of(of.stops, of.tint).scaled(exposure.share))
}

/// Parses stops of exposure.
///
/// # Errors
/// A message for anything but a number within [`MOST_STOPS`].
pub fn stops(text: &str) -> Result<f64, String> {
    let ev: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if ev.abs() <= MOST_STOPS {
        return Ok(ev);
    }
    Err(format!("must be from -{MOST_STOPS} to {MOST_STOPS} stops"))
}

/// Reads a scene, or the part of it inside `crop`.
///
/// # Errors
/// [`Failure`] if the file is missing or malformed, or if nothing is inside the crop.
pub fn read_scene(path: &Path, crop: Option<Crop>) -> Result<Scene, Failure> {
    let scene = ply::read(path).map_err(|e| Failure::from(PipelineError::from(e)))?;
    scene.within(crop).map_err(|e| Failure::new(ErrorKind::BadInput, e))
}

/// Reads the cameras of a run's views.
///
/// # Errors
/// [`Failure`] if the file is missing or malformed.
pub fn read_cameras(path: &Path) -> Result<Vec<NamedCamera>, Failure> {
    let bytes = std::fs::read(path).map_err(io(path))?;
    serde_json::from_slice(&bytes)
        .map_err(|e| Failure::new(ErrorKind::BadInput, format!("{}: {e}", path.display())))
}

fn viewpoint(args: &Args) -> Result<Viewpoint, Failure> {
    if let Some(name) = &args.from.view {
        return Ok(Viewpoint::View(name.clone()));
    }
    if let Some(path) = &args.from.pose {
        return Ok(Viewpoint::Pose(read_pose(path)?));
    }
    Ok(Viewpoint::Orbit {
        azimuth: args.from.azimuth.unwrap_or_default(),
        elevation: args.elevation,
        distance: args.distance,
    })
}

/// Reads a camera from a separate file, which need not have a name or a split.
fn read_pose(path: &Path) -> Result<Camera, Failure> {
    let unreadable = |e: serde_json::Error| Failure::usage(format!("{}: {e}", path.display()));
    let bytes = std::fs::read(path).map_err(io(path))?;
    let mut value: serde_json::Value = serde_json::from_slice(&bytes).map_err(unreadable)?;
    if let Some(object) = value.as_object_mut() {
        object.entry("name").or_insert_with(|| "pose".into());
        object.entry("split").or_insert_with(|| "held_out".into());
    }
    let named: NamedCamera = serde_json::from_value(value).map_err(unreadable)?;
    Ok(named.camera())
}
