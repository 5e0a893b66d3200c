//! `fled synth`: generates a capture with ground truth.

use std::path::PathBuf;

use fled_core::pipeline::error::ErrorKind;
use fled_core::synthetic::{self, Layout, RoomChoice, SynthOptions};

use crate::failure::Failure;

/// Arguments of `fled synth`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder to create; must not exist, or be empty.
    out: PathBuf,
    /// Number of photographs.
    #[arg(long, default_value_t = 24)]
    views: usize,
    /// Width and height in px.
    #[arg(long, default_value = "320x180", value_parser = size)]
    size: (usize, usize),
    /// Seed of the path, the shake and the noise.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Room: `study`, a furnished one at dusk, or a number; 0 is the room of the benchmarks.
    #[arg(long, default_value = "0")]
    room: RoomChoice,
    /// Folder with nothing but photographs, which cover all surfaces instead of painted patterns,
    /// at up to 2048 px.
    #[arg(long)]
    wallpapers: Option<PathBuf>,
    /// Light as a share of that of a well-exposed photograph.
    #[arg(long, default_value_t = 0.05)]
    exposure: f64,
    /// Length of the camera's shake, px.
    #[arg(long, default_value_t = 9.0)]
    blur: f64,
    /// Sensor noise; see the documentation of `SynthOptions`.
    #[arg(long, default_value_t = 0.02)]
    noise: f64,
    /// Layout of the data set: lush, llff or transforms.
    #[arg(long, default_value = "lush")]
    layout: Layout,
}

/// Parses `WxH`.
///
/// # Errors
/// A message for clap.
pub fn size(text: &str) -> Result<(usize, usize), String> {
    let parse = |side: &str| side.parse::<usize>().ok().filter(|side| (1..=16_384).contains(side));
    text.split_once('x')
        .and_then(|(width, height)| Some((parse(width)?, parse(height)?)))
        .ok_or_else(|| format!("`{text}` is not WIDTHxHEIGHT in pixels"))
}

/// Makes the capture.
///
/// # Errors
/// [`Failure`] when it cannot be written.
pub fn main(args: &Args) -> Result<(), Failure> {
    let options = SynthOptions {
        views: args.views,
        width: args.size.0,
        height: args.size.1,
        seed: args.seed,
        room: args.room,
        wallpapers: args.wallpapers.clone(),
        exposure: args.exposure,
        blur: args.blur,
        noise: args.noise,
        layout: args.layout,
    };
    synthetic::generate(&options, &args.out).map_err(|e| Failure::new(ErrorKind::Io, e))?;
    eprintln!("{} photographs in {}", args.views, args.out.display());
    Ok(())
}
