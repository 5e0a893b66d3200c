//! `fled video`: a video of a finished run's scene.

use std::path::PathBuf;
use std::time::Instant;

use fled_core::camera::Camera;
use fled_core::cancel::{CancelToken, Cancelled};
use fled_core::device::Device;
use fled_core::event::Event;
use fled_core::gaussians::crop::Crop;
use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_core::render::Renderer;
use fled_core::run_folder::RunFolder;
use fled_core::video::{self, EncodeError, Kind, Plan, PlanError, Target};
use indicatif::ProgressBar;
use rustix::process::setpriority_process;

use crate::failure::{Failure, io};
use crate::progress::{overall_bar, print};
use crate::render::{read_cameras, read_scene};
use crate::tools;

/// The lowest scheduling priority.
const BACKGROUND: i32 = 19;

/// Arguments of `fled video`.
#[derive(clap::Args)]
pub struct Args {
    /// Output folder of `fled run`.
    run: PathBuf,
    /// Output file: .mp4.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    way: Way,
    /// Total angle of the orbit. 360 goes once around, less swings to both sides and back [default:
    /// as far as the photographs reach].
    #[arg(long, conflicts_with_all = ["cameras", "plan"])]
    degrees: Option<f64>,
    /// Degrees above the photographs; with --orbit.
    #[arg(long, allow_negative_numbers = true, conflicts_with_all = ["cameras", "plan"])]
    elevation: Option<f64>,
    /// Distance from the scene's centre as a multiple of the cameras' median distance; with
    /// --orbit.
    #[arg(long, conflicts_with_all = ["cameras", "plan"])]
    distance: Option<f64>,
    /// Duration, up to 60 s [default: 8].
    #[arg(long, value_name = "S", conflicts_with = "plan")]
    seconds: Option<f64>,
    /// Frames per second, up to 30 [default: 24].
    #[arg(long, value_name = "N", conflicts_with = "plan")]
    fps: Option<u32>,
    /// Width and height in px, up to 1920 [default: those of the views].
    #[arg(long, value_parser = crate::synth::size, conflicts_with = "plan")]
    size: Option<(usize, usize)>,
    /// Brightens the linear light by this many stops; negative values darken it.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true,
        value_parser = crate::render::stops)]
    ev: f64,
    /// Uses this round's scene instead of the delivered one.
    #[arg(long, conflicts_with = "plan")]
    round: Option<u32>,
    /// Shows only the Gaussians whose centres are in box:X,Y,Z,WIDTH,HEIGHT,DEPTH or
    /// sphere:X,Y,Z,RADIUS, in the world of the poses.
    #[arg(long, value_name = "SHAPE", conflicts_with = "plan")]
    crop: Option<Crop>,
    /// The device: auto, cpu, or part of a Vulkan adapter's name.
    #[arg(long, default_value = "auto")]
    adapter: String,
    /// Prints progress as JSON lines on standard output.
    #[arg(long)]
    json: bool,
    /// Runs at the lowest priority.
    #[arg(long)]
    background: bool,
    #[command(flatten)]
    ffmpeg: tools::Ffmpeg,
}

/// Which way the camera goes.
#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct Way {
    /// Moves around the centre of the scene.
    #[arg(long)]
    orbit: bool,
    /// Moves through the cameras of the photographs, in their order.
    #[arg(long)]
    cameras: bool,
    /// Follows a JSON file, the body of `POST /v1/jobs/ID/videos`; it may hold a path of poses.
    #[arg(long, value_name = "FILE")]
    plan: Option<PathBuf>,
}

/// Makes the video.
///
/// # Errors
/// [`Failure`] if the run, FFmpeg or the adapter is missing.
pub fn main(args: &Args) -> Result<(), Failure> {
    if args.background {
        setpriority_process(None, BACKGROUND).map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    }
    let cancel = tools::cancel_on_signals()?;
    let started = Instant::now();
    let outcome = make(args, &cancel);
    if args.json {
        print(&match &outcome {
            Ok(round) => {
                Event::Finished { best_round: *round, seconds: started.elapsed().as_secs_f64() }
            }
            Err(failure) => failure.event(),
        });
    }
    outcome.map(drop)
}

/// Returns the round that the video shows; 0 for the delivered scene.
fn make(args: &Args, cancel: &CancelToken) -> Result<u32, Failure> {
    let run = RunFolder::new(&args.run);
    let plan = plan(args)?;
    let cameras = plan.cameras(&read_cameras(&run.cameras())?)?;
    let scene = run.scene_of(plan.round);
    let scene = read_scene(&scene, plan.crop)?;
    let within = |camera: &Camera| scene.normalisation.within(camera);
    let cameras: Vec<Camera> = cameras.iter().map(within).collect();
    let device = Device::new(&args.adapter).map_err(|e| Failure::new(ErrorKind::Environment, e))?;
    let renderer = Renderer::new(&device);
    let uploaded = renderer.upload(&scene.gaussians).map_err(PipelineError::from)?;
    drop(scene);
    let command = args.ffmpeg.command()?;
    let target = Target { command: &command, file: &args.output, fps: plan.fps() };
    let progress = Progress::new(args.json, cameras.len());
    video::write(&target, &cameras, |number, camera| {
        cancel.check()?;
        progress.show(number);
        let picture = renderer.render_scene(&uploaded, camera);
        Ok::<_, Failure>(picture.map_err(PipelineError::from)?.exposed(args.ev))
    })?;
    progress.show(cameras.len());
    Ok(plan.round.unwrap_or(0))
}

fn plan(args: &Args) -> Result<Plan, Failure> {
    if let Some(path) = &args.way.plan {
        let bytes = std::fs::read(path).map_err(io(path))?;
        let unreadable = |e| Failure::usage(format!("{}: {e}", path.display()));
        return serde_json::from_slice(&bytes).map_err(unreadable);
    }
    let kind = if args.way.cameras { Kind::Cameras } else { Kind::Orbit };
    Ok(Plan {
        seconds: args.seconds,
        fps: args.fps,
        width: args.size.map(|(width, _)| width),
        height: args.size.map(|(_, height)| height),
        round: args.round,
        crop: args.crop,
        degrees: args.degrees,
        elevation: args.elevation,
        distance: args.distance,
        ..Plan::new(kind)
    })
}

/// Progress of the video: a bar for users, JSON lines for programs.
struct Progress {
    bar: Option<ProgressBar>,
    total: usize,
}

impl Progress {
    fn new(json: bool, total: usize) -> Self {
        let bar = (!json).then(overall_bar);
        Self { bar, total }
    }

    fn show(&self, done: usize) {
        match &self.bar {
            Some(bar) => {
                bar.set_position((1000 * done / self.total) as u64);
                bar.set_message(format!("{done} of {} pictures", self.total));
                if done == self.total {
                    bar.finish_and_clear();
                }
            }
            None => print(&Event::Progress {
                progress: done as f64 / self.total as f64,
                eta_seconds: None,
            }),
        }
    }
}

impl From<PlanError> for Failure {
    fn from(error: PlanError) -> Self {
        Self::usage(error)
    }
}

impl From<EncodeError> for Failure {
    fn from(error: EncodeError) -> Self {
        let kind = match error {
            EncodeError::Missing { .. } => ErrorKind::Environment,
            EncodeError::Refused { .. } | EncodeError::Io { .. } => ErrorKind::Io,
        };
        Self { hint: error.hint().to_owned(), ..Self::new(kind, error) }
    }
}

impl From<Cancelled> for Failure {
    fn from(error: Cancelled) -> Self {
        Self::new(ErrorKind::Cancelled, error)
    }
}
