//! `fled synth`: generates a capture with ground truth.

use std::path::PathBuf;

use fled_core::pipeline::error::ErrorKind;
use fled_core::synthetic::{self, Layout, RoomChoice, SynthOptions};

use crate::failure::Failure;

/// Arguments of `fled synth`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder to make; must not exist or be empty.
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
    /// Which room: `study`, a furnished one at dusk, or a number; 0 is the one of the benchmarks.
    #[arg(long, default_value = "0")]
    room: RoomChoice,
    /// Folder of photographs, and nothing else, that hang on all surfaces in place of painted
    /// patterns, at 2048 px at most.
    #[arg(long)]
    wallpapers: Option<PathBuf>,
    /// Share of a well-exposed photograph's light.
    #[arg(long, default_value_t = 0.05)]
    exposure: f64,
    /// Length of the camera's shake, px.
    #[arg(long, default_value_t = 9.0)]
    blur: f64,
    /// Noise of the sensor; see the documentation of `SynthOptions`.
    #[arg(long, default_value_t = 0.02)]
    noise: f64,
    /// As which data set it lies there: lush, llff or transforms.
    #[arg(long, default_value = "lush")]
    layout: Layout,
}

/// Parses `WxH`.
///
/// # Errors
/// A message for clap.
pub fn size(text: &str) -> Result<(usize, usize), String> {
    let parse = |side: &str| {
        side.parse::<usize>()
            .ok()
            .filter(|side| (1..=16_384).contains(side))
    };
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
