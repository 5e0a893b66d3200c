//! `fled render-worker`: renders for the service, one JSON line per image, until its standard input
//! ends. A crash of the graphics driver ends this process but not the service.

use std::fmt::Display;
use std::fs;
use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use fled_core::camera::normalisation::Normalisation;
use fled_core::device::Device;
use fled_core::gaussians::crop::{Crop, EmptyCrop};
use fled_core::gaussians::ply;
use fled_core::image::{EncodeFormat, Image, write_atomic};
use fled_core::pipeline::error::ErrorKind;
use fled_core::render::{Renderer, UploadedGaussians};
use fled_server::render::{Format, RenderReply, RenderRequest, Shown};

use crate::failure::Failure;

/// JPEG quality: small files for turning a view live, and good enough to judge the view.
const JPEG_QUALITY: u8 = 90;

/// Answers requests.
///
/// # Errors
/// [`Failure`] if there is no adapter, or the service has gone.
pub fn main() -> Result<(), Failure> {
    let gone = |error: io::Error| Failure::new(ErrorKind::Io, error);
    let mut worker: Option<Worker> = None;
    for line in io::stdin().lock().lines() {
        let reply = match answer(&mut worker, &line.map_err(gone)?) {
            Ok(()) => RenderReply::Ok(true),
            Err(Fault::Failed(why)) => RenderReply::Error(why),
            Err(Fault::Empty(crop)) => RenderReply::Empty(crop.to_string()),
        };
        let text =
            serde_json::to_string(&reply).map_err(|e| Failure::new(ErrorKind::Internal, e))?;
        let mut out = io::stdout().lock();
        writeln!(out, "{text}").and_then(|()| out.flush()).map_err(gone)?;
    }
    Ok(())
}

/// Why there is no picture.
enum Fault {
    Failed(String),
    Empty(EmptyCrop),
}

impl From<EmptyCrop> for Fault {
    fn from(crop: EmptyCrop) -> Self {
        Self::Empty(crop)
    }
}

fn answer(worker: &mut Option<Worker>, line: &str) -> Result<(), Fault> {
    let request: RenderRequest = serde_json::from_str(line).map_err(words)?;
    let worker = match worker {
        Some(worker) => worker,
        // Opened on the first request, so that the answer reports a missing driver.
        None => worker.insert(Worker::open()?),
    };
    worker.render(&request)
}

fn words(error: impl Display) -> Fault {
    Fault::Failed(error.to_string())
}

/// The scene on the device: a version of a file, and its crop.
#[derive(PartialEq)]
struct Stamp {
    path: PathBuf,
    crop: Option<Crop>,
    bytes: u64,
    modified: Option<SystemTime>,
}

impl Stamp {
    fn of(path: &Path, crop: Option<Crop>) -> io::Result<Self> {
        let metadata = fs::metadata(path)?;
        Ok(Self {
            path: path.to_owned(),
            crop,
            bytes: metadata.len(),
            modified: metadata.modified().ok(),
        })
    }
}

/// The device and the last rendered scene: turning a view requests the same scene repeatedly.
struct Worker {
    renderer: Renderer,
    scene: Option<(Stamp, UploadedGaussians, Normalisation)>,
}

impl Worker {
    fn open() -> Result<Self, Fault> {
        let device = Device::new("auto").map_err(words)?;
        Ok(Self { renderer: Renderer::new(&device), scene: None })
    }

    fn render(&mut self, request: &RenderRequest) -> Result<(), Fault> {
        let image = match request.shown {
            Shown::Colour => self.colour(request)?.exposed(request.ev),
            Shown::Depth => self.depth(request)?,
        };
        let format = match request.format {
            Format::Jpeg => EncodeFormat::Jpeg(JPEG_QUALITY),
            Format::Png => EncodeFormat::Png,
            Format::Webp => EncodeFormat::Webp,
        };
        write_atomic(&request.out, &image.encode(format).map_err(words)?).map_err(words)
    }

    /// Renders depth, which replaces the colours on the device by colours that depend on the
    /// camera.
    fn depth(&self, request: &RenderRequest) -> Result<Image, Fault> {
        let scene = ply::read(&request.scene).map_err(words)?.within(request.crop)?;
        let camera = scene.normalisation.within(&request.camera.camera());
        let depth = self.renderer.depth(&scene.gaussians, &camera).map_err(words)?;
        Ok(depth.picture())
    }

    fn colour(&mut self, request: &RenderRequest) -> Result<Image, Fault> {
        let stamp = Stamp::of(&request.scene, request.crop).map_err(words)?;
        let known = self.scene.take().filter(|(known, ..)| *known == stamp);
        let (_, scene, normalisation) = self.scene.insert(match known {
            Some(known) => known,
            None => {
                let scene = ply::read(&request.scene).map_err(words)?.within(request.crop)?;
                let uploaded = self.renderer.upload(&scene.gaussians).map_err(words)?;
                (stamp, uploaded, scene.normalisation)
            }
        });
        let camera = normalisation.within(&request.camera.camera());
        self.renderer.render_scene(scene, &camera).map_err(words)
    }
}
