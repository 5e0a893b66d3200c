//! `fled doctor`: checks the requirements of this machine.

use std::convert::Infallible;
use std::io::Write;
use std::path::PathBuf;
use std::process::Command;

use fled_capture::group;
use fled_capture::image::libraw_version;
use fled_core::colmap::ColmapCli;
use fled_core::deblur::{self, DeblurError, NetworkChoice};
use fled_core::device::Device;
use fled_core::features::weights::Package;
use fled_core::inference::runtime;
use fled_core::pipeline::error::ErrorKind;
use fled_core::reconstruct::{self, TrialError};
use fled_gpu::GpuError;
use serde::Serialize;

use crate::failure::Failure;
use crate::tools;

/// Free space below which a run of 60 photographs may not finish, in bytes.
const LEAST_SPACE: u64 = 2 << 30;

/// Arguments of `fled doctor`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder whose disk is checked.
    #[arg(long, value_name = "DIR", default_value = ".")]
    data: PathBuf,
    /// The device: auto, cpu, or part of a Vulkan adapter's name.
    #[arg(long, default_value = "auto")]
    adapter: String,
    /// Leaves out the check that trains.
    #[arg(long)]
    no_training: bool,
    /// Prints one line of JSON instead of a table.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    ffmpeg: tools::Ffmpeg,
    #[command(flatten)]
    tools: tools::Args,
}

/// A requirement of the machine.
#[derive(Serialize)]
struct Check {
    name: &'static str,
    ok: bool,
    /// What was found, or what is wrong.
    detail: String,
    /// What to do if it is not met.
    hint: &'static str,
}

impl Check {
    fn new(
        name: &'static str,
        found: Result<String, impl std::fmt::Display>,
        hint: &'static str,
    ) -> Self {
        match found {
            Ok(detail) => Self { name, ok: true, detail, hint: "" },
            Err(error) => Self { name, ok: false, detail: error.to_string(), hint },
        }
    }
}

/// Prints every check.
///
/// # Errors
/// [`Failure`] of kind `environment` if anything is missing.
pub fn main(args: &Args) -> Result<(), Failure> {
    let device = Device::new(&args.adapter);
    let has_gpu = device.as_ref().is_ok_and(Device::is_gpu);
    let checks = checks(args, device);
    let mut out = std::io::stdout().lock();
    let written = if args.json {
        writeln!(out, "{}", serde_json::json!({ "checks": checks, "has_gpu": has_gpu }))
    } else {
        checks.iter().try_for_each(|check| {
            let state = if check.ok { "ok" } else { "MISSING" };
            writeln!(out, "{state:8} {:12} {} {}", check.name, check.detail, check.hint)
        })
    };
    written.map_err(|e| Failure::new(ErrorKind::Io, e))?;
    let missing = checks.iter().filter(|check| !check.ok).count();
    if missing > 0 {
        let detail = format!("{missing} of {} checks failed", checks.len());
        return Err(Failure {
            hint: String::new(),
            ..Failure::new(ErrorKind::Environment, detail)
        });
    }
    Ok(())
}

fn checks(args: &Args, device: Result<Device, GpuError>) -> Vec<Check> {
    let search = tools::Args::library_folders();
    let runtime = runtime::find(args.tools.onnxruntime.as_deref(), &search)
        .map(|found| format!("{} at {}", found.version, found.path.display()));
    let open = deblur::OpenOptions {
        runtime: args.tools.onnxruntime.as_deref(),
        search: &search,
        ..deblur::OpenOptions::default()
    };
    let model = models(&open);
    let training = device.as_ref().ok().filter(|_| !args.no_training).map(trial);
    let adapter = device.map(|device| device.to_string());
    let checks = [
        Check::new(
            "adapter",
            adapter,
            "A GPU needs its Vulkan driver, a processor AVX2; without either, install \
             mesa-vulkan-drivers",
        ),
        Check::new(
            "training",
            training.unwrap_or_else(|| Ok("not tried".to_owned())),
            "Update the driver, or choose another device, such as `--adapter cpu`",
        ),
        Check::new(
            "colmap",
            ColmapCli::new(&args.tools.colmap).version(),
            "apt-get install colmap",
        ),
        Check::new("onnxruntime", runtime, "Run `make onnxruntime`, or set ORT_DYLIB_PATH"),
        Check::new("models", model, "Set ORT_DYLIB_PATH"),
        Check::new("matcher", Ok::<_, Infallible>(matcher(args)), ""),
        Check::new("ffmpeg", Ok::<_, Infallible>(ffmpeg(args)), ""),
        Check::new("libraw", Ok::<_, Infallible>(libraw()), ""),
        Check::new("disk", disk(args), "Free some space; a run may need 2 GiB"),
    ];
    checks.into()
}

/// Trains ten steps on the device.
fn trial(device: &Device) -> Result<String, TrialError> {
    let seconds = reconstruct::trial(device)?;
    Ok(format!("ten steps and a render in {seconds:.1} s"))
}

/// The weights that find and match key points. A machine without them is not faulty: COLMAP has its
/// own key points.
fn matcher(args: &Args) -> String {
    let state = Package::embedded().state(&args.tools.matcher_folders());
    state.unwrap_or_else(|error| {
        format!("none; poses are found with COLMAP's own key points: {error}")
    })
}

/// The version of FFmpeg. A machine without it can still read photographs.
fn ffmpeg(args: &Args) -> String {
    let output = group::output(Command::new(&args.ffmpeg.program).arg("-version"));
    let first = output.map(|output| {
        let output = String::from_utf8_lossy(&output.stdout).into_owned();
        output.lines().next().unwrap_or("unknown version").to_owned()
    });
    first.unwrap_or_else(|error| {
        format!("none; videos can be neither read nor made (apt-get install ffmpeg): {error}")
    })
}

/// The version of LibRaw. A machine without it can still read most raw files.
fn libraw() -> String {
    libraw_version().map_or_else(
        || "none; some raw files cannot be read (apt-get install libraw-bin)".to_owned(),
        str::to_owned,
    )
}

/// Opens and describes the default network.
fn models(open: &deblur::OpenOptions<'_>) -> Result<String, DeblurError> {
    let opened = deblur::open(&NetworkChoice::Default, open)?;
    let info = opened.deblurrer.describe();
    let mut found = format!("{} on {}, sha256 {}", info.id, info.provider, info.sha256);
    for fallback in opened.fallbacks {
        found = format!("{found}; {fallback}");
    }
    Ok(found)
}

fn disk(args: &Args) -> Result<String, String> {
    let stat =
        rustix::fs::statvfs(&args.data).map_err(|e| format!("{}: {e}", args.data.display()))?;
    let free = stat.f_bavail * stat.f_frsize;
    let text =
        format!("{:.1} GiB free at {}", free as f64 / f64::from(1 << 30), args.data.display());
    if free < LEAST_SPACE { Err(text) } else { Ok(text) }
}
