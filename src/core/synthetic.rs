//! `fled synth`: synthetic captures with complete ground truth.
//!
//! A room of textured boxes, balls and walls, or a furnished one, is ray-cast in linear light along
//! the path of a shaking camera. The mean over the exposure is darkened, given sensor noise and
//! stored in 8 bits, in the layout of a published data set ([`Layout`]): `images/` (dark, blurred),
//! sharp, bright ones beside them, and the poses.

mod error;
mod layout;
mod paint;
mod path;
mod room;
mod sensor;
mod shape;
mod study;
mod texture;

use std::path::{Path, PathBuf};

use glam::DVec2;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::camera::{Camera, Intrinsics};
use crate::image::{Image, Linear, Srgb};
use crate::poses::bounds::BoundedCamera;
use room::Room;

pub use error::SynthError;
pub use layout::Layout;

/// Sub-frames per exposure: they sample a blur path of ~10 px about every pixel.
const SUBFRAMES: usize = 11;

/// Rays per pixel and axis for the ground truth.
const SHARP_RAYS: usize = 3;

/// Options of a synthetic capture. Defaults are those of `fled synth`.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthOptions {
    /// Number of views.
    pub views: usize,
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Seed of path, shake and noise.
    pub seed: u64,
    /// The room.
    pub room: RoomChoice,
    /// A folder of photographs to hang on all surfaces in place of painted patterns; every file in
    /// it is read.
    pub wallpapers: Option<PathBuf>,
    /// Share of the light in the dark exposure: the factor of linear values.
    pub exposure: f64,
    /// Longest blur path in the middle of the image, px; that of a view is 0.4 to 1 times this.
    pub blur: f64,
    /// Standard deviation of the noise at white, as a share of the dark exposure's white: shot
    /// noise falls with the square root of the signal, and a tenth of it remains in the black.
    pub noise: f64,
    /// The layout of the output folder.
    pub layout: Layout,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            views: 24,
            width: 320,
            height: 180,
            seed: 0,
            room: RoomChoice::Numbered(0),
            wallpapers: None,
            exposure: 0.05,
            blur: 9.0,
            noise: 0.02,
            layout: Layout::Lush,
        }
    }
}

/// The room of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoomChoice {
    /// Painted boxes and balls. All measurements use room 0; networks train on others.
    Numbered(u64),
    /// A furnished room at dusk, for demonstrations.
    Study,
}

impl RoomChoice {
    fn built(self) -> Room {
        match self {
            Self::Numbered(number) => Room::numbered(number),
            Self::Study => study::study(),
        }
    }
}

impl std::str::FromStr for RoomChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "study" => Ok(Self::Study),
            _ => text
                .parse()
                .map(Self::Numbered)
                .map_err(|_| format!("`{text}` is neither `study` nor a number")),
        }
    }
}

/// The result of the generation.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthSummary {
    /// Names and cameras of the views, at the middle of each exposure.
    pub cameras: Vec<(String, Camera)>,
}

impl SynthOptions {
    fn check(&self) -> Result<(), SynthError> {
        let fault = |reason: String| Err(SynthError::Options(reason));
        if !(1..=1000).contains(&self.views) {
            return fault(format!("views: {} is not in 1..=1000", self.views));
        }
        if !(32..=8192).contains(&self.width) || !(32..=8192).contains(&self.height) {
            return fault(format!("size: {}x{} is not in 32..=8192", self.width, self.height));
        }
        if !(self.exposure > 0.0 && self.exposure <= 1.0) {
            return fault(format!("exposure: {} is not above 0 and at most 1", self.exposure));
        }
        if !(0.0..=200.0).contains(&self.blur) {
            return fault(format!("blur: {} px is not in 0..=200", self.blur));
        }
        if !(0.0..=1.0).contains(&self.noise) {
            return fault(format!("noise: {} is not in 0..=1", self.noise));
        }
        Ok(())
    }

    /// A lens with a horizontal field of view of 60 degrees.
    fn intrinsics(&self) -> Intrinsics {
        let (width, height) = (self.width as f64, self.height as f64);
        let focal = 0.5 * width / 30f64.to_radians().tan();
        Intrinsics {
            width: self.width,
            height: self.height,
            fx: focal,
            fy: focal,
            cx: 0.5 * width,
            cy: 0.5 * height,
        }
    }
}

/// Writes a capture into `out`, which is created. Replaces existing files of the same names. The
/// same options and photographs on the walls give the same bytes.
///
/// # Errors
/// [`SynthError`].
pub fn generate(options: &SynthOptions, out: &Path) -> Result<SynthSummary, SynthError> {
    options.check()?;
    let wallpapers =
        options.wallpapers.as_deref().map(load_wallpapers).transpose()?.unwrap_or_default();
    for folder in ["images", options.layout.truths()] {
        let path = out.join(folder);
        std::fs::create_dir_all(&path).map_err(|source| SynthError::Io { path, source })?;
    }
    let room = options.room.built().papered(wallpapers);
    let cameras = path::cameras(options.views, options.intrinsics(), options.seed);
    let named: Vec<(String, Camera)> = cameras
        .iter()
        .enumerate()
        .map(|(index, camera)| (format!("{index:03}"), *camera))
        .collect();
    named.par_iter().enumerate().try_for_each(|(index, (name, camera))| {
        write_view(options, &room, out, (index, name, camera))
    })?;
    let bounded = |camera: &Camera| {
        let (near, far) = room.depth_range(camera);
        BoundedCamera { camera: *camera, near, far }
    };
    let rows: Vec<BoundedCamera> = cameras.iter().map(bounded).collect();
    let names: Vec<String> = named.iter().map(|(name, _)| name.clone()).collect();
    options.layout.write_poses(out, &names, &rows)?;
    Ok(SynthSummary { cameras: named })
}

/// Longer side to which photographs on walls are reduced, px: more would hardly be visible, and all
/// are in memory at once.
const LARGEST_WALLPAPER: usize = 2048;

/// Loads the photographs of a folder, in the order of their names.
fn load_wallpapers(folder: &Path) -> Result<Vec<Image<Linear>>, SynthError> {
    let failed = |source| SynthError::Io { path: folder.to_owned(), source };
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut paths: Vec<PathBuf> =
        entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<_>>().map_err(failed)?;
    paths.sort();
    if paths.is_empty() {
        return Err(SynthError::Options(format!(
            "wallpapers: {} holds no photograph",
            folder.display()
        )));
    }
    let load = |path: PathBuf| match Image::<Srgb>::load_at_most(&path, LARGEST_WALLPAPER) {
        Ok(photograph) => Ok(photograph.to_linear()),
        Err(source) => Err(SynthError::Wallpaper { path, source }),
    };
    paths.into_iter().map(load).collect()
}

fn write_view(
    options: &SynthOptions,
    room: &Room,
    out: &Path,
    (index, name, camera): (usize, &str, &Camera),
) -> Result<(), SynthError> {
    let mut rng =
        Pcg64Mcg::seed_from_u64(options.seed.wrapping_mul(1_000_003).wrapping_add(index as u64));
    let shake = path::shake(camera, room.focus_distance(camera), options.blur, SUBFRAMES, &mut rng);
    let mut light = Image::<Linear>::new(options.width, options.height);
    for (moment, offset) in shake.iter().zip(spread_offsets(shake.len())) {
        let frame = room.render_at(moment, &[offset]);
        for (sum, value) in light.data_mut().iter_mut().zip(frame.data()) {
            *sum += value / shake.len() as f32;
        }
    }
    let dark = sensor::expose(&light, options.exposure, options.noise, &mut rng);
    let file = format!("{name}.png");
    dark.to_srgb().save(&out.join("images").join(&file))?;
    room.render_at(camera, &grid_offsets(SHARP_RAYS))
        .to_srgb()
        .save(&out.join(options.layout.truths()).join(&file))?;
    Ok(())
}

/// Positions of `rays` x `rays` rays in a pixel.
fn grid_offsets(rays: usize) -> Vec<DVec2> {
    let place =
        |i: usize| DVec2::new((i % rays) as f64 + 0.5, (i / rays) as f64 + 0.5) / rays as f64;
    (0..rays * rays).map(place).collect()
}

/// One position per sub-frame, spread over the pixel (Roberts' R2 sequence) around its centre, so
/// that their mean samples the pixel's area although each frame takes a single ray.
fn spread_offsets(count: usize) -> Vec<DVec2> {
    let place = |i: usize| (DVec2::new(0.754_877_666, 0.569_840_291) * (i + 1) as f64).fract();
    let places: Vec<DVec2> = (0..count).map(place).collect();
    let mean = places.iter().sum::<DVec2>() / count.max(1) as f64;
    places.iter().map(|p| *p - mean + 0.5).collect()
}

#[cfg(test)]
mod tests;
