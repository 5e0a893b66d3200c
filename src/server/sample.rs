//! The sample that the server ships: photographs of a made-up dark room, and the recorded result of
//! a run of them. `tools/make_sample.sh` makes both.

use std::borrow::Cow;
use std::fs;
use std::io::{self, Read};
use std::path::Path;

use flate2::read::GzDecoder;
use fled_core::camera::NamedCamera;
use fled_core::camera::normalisation::Normalisation;
use fled_core::device::{Device, PROCESSOR};
use fled_core::event::Event;
use fled_core::gaussians::{Gaussians, ply, spz};
use fled_core::image::EncodeFormat;
use fled_core::pipeline::config::Options;
use fled_core::render::Renderer;
use fled_core::run_folder::RunFolder;
use rust_embed::RustEmbed;
use serde_json::{Map, Value};

/// The name of the sample's capture and job.
pub const NAME: &str = "Sample: a dark room";

/// Where the photographs are, below the sample's folder.
const CAPTURE: &str = "capture/";

/// Where the result is.
const RESULT: &str = "result/";

/// The scene, in a layout that takes a seventh of a PLY.
const SCENE: &str = "result/scene.spz";

#[derive(RustEmbed)]
#[folder = "sample"]
struct Files;

/// The run that made the result.
#[derive(Debug)]
pub struct Recording {
    /// What it reported, in order, without progress.
    pub events: Vec<Event>,
    /// The delivered round.
    pub best_round: u32,
    /// Its options.
    pub options: Map<String, Value>,
}

/// The recorded run.
///
/// # Errors
/// [`io::ErrorKind::InvalidData`] if a file of the sample is damaged.
pub fn recording() -> io::Result<Recording> {
    let text = |name: &str| String::from_utf8(unpacked(name)?).map_err(damaged);
    let options = serde_json::from_str(&text("result/config.json.gz")?)?;
    let version = text("run/version.txt.gz")?;
    let events = text("run/events.jsonl.gz")?;
    let mut recording = Recording {
        events: vec![Event::Warning {
            code: "recorded".to_owned(),
            message: format!(
                "This result was recorded by {} and ships with the server. To compute it on this \
                 machine, start a job from the sample's photographs.",
                version.trim()
            ),
        }],
        best_round: 0,
        options: Options::known(&options),
    };
    for line in events.lines() {
        match serde_json::from_str(line)? {
            Event::Finished { best_round, .. } => recording.best_round = best_round,
            Event::DetailChosen { mut detail } => {
                // Not of this machine.
                detail.because = "as recorded".to_owned();
                recording.events.push(Event::DetailChosen { detail });
            }
            event => recording.events.push(event),
        }
    }
    Ok(recording)
}

/// Writes the photographs, poses and ground truth, and returns the number of files.
///
/// # Errors
/// When a file cannot be written.
pub fn write_capture(dir: &Path) -> io::Result<usize> {
    let names = names_below(CAPTURE);
    for name in &names {
        write(&dir.join(&name[CAPTURE.len()..]), &embedded(name)?)?;
    }
    Ok(names.len())
}

/// Writes the folder of the recorded run, without the scene of earlier rounds. What other files
/// hold is not shipped: pictures of the photographs and of their truth are copies, and restored
/// views are rendered, but for a processor without AVX2, which has none.
///
/// # Errors
/// When a file cannot be written or a view cannot be rendered.
pub fn write_result(run: &RunFolder, delivered: u32) -> io::Result<()> {
    for name in names_below(RESULT).iter().filter(|name| *name != SCENE) {
        let to = run.root().join(&name[RESULT.len()..]);
        match name.strip_suffix(".gz") {
            Some(_) => write(&to.with_extension(""), &unpacked(name)?)?,
            None => write(&to, &embedded(name)?)?,
        }
    }
    for (from, to) in [("capture/images/", run.inputs()), ("capture/HL/", run.truths())] {
        for name in names_below(from) {
            write(&to.join(&name[from.len()..]), &embedded(&name)?)?;
        }
    }
    let scene = spz::read_version_3(&embedded(SCENE)?)?;
    ply::write(&scene, &Normalisation::default(), &run.scene()).map_err(io::Error::other)?;
    fs::copy(run.scene(), run.round(delivered).scene())?;
    render(run, &scene)
}

/// Renders the restored views.
fn render(run: &RunFolder, scene: &Gaussians) -> io::Result<()> {
    // The driver of a GPU is for other processes, whose crash costs less.
    let device = match Device::new(PROCESSOR) {
        Ok(device) => device,
        Err(error) => {
            tracing::warn!(%error, "the sample lacks its restored views");
            return Ok(());
        }
    };
    let renderer = Renderer::new(&device);
    let scene = renderer.upload(scene).map_err(io::Error::other)?;
    let cameras: Vec<NamedCamera> = serde_json::from_slice(&fs::read(run.cameras())?)?;
    fs::create_dir_all(run.restored())?;
    for named in cameras {
        let image = renderer.render_scene(&scene, &named.camera()).map_err(io::Error::other)?;
        let path = run.restored_view(&named.name);
        image.save_as(&path, EncodeFormat::Png16).map_err(io::Error::other)?;
    }
    Ok(())
}

fn names_below(folder: &str) -> Vec<Cow<'static, str>> {
    Files::iter().filter(|name| name.starts_with(folder)).collect()
}

fn embedded(name: &str) -> io::Result<Cow<'static, [u8]>> {
    let missing = || io::Error::new(io::ErrorKind::NotFound, format!("the sample lacks {name}"));
    Ok(Files::get(name).ok_or_else(missing)?.data)
}

fn unpacked(name: &str) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    GzDecoder::new(&*embedded(name)?).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    fs::create_dir_all(path.parent().unwrap_or(path))?;
    fs::write(path, bytes)
}

fn damaged(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}

#[cfg(test)]
mod tests {
    use fled_core::image::Image;
    use fled_core::metrics;
    use fled_core::pipeline::config::Preset;

    use super::*;

    #[test]
    fn the_recorded_run_was_asked_for_what_a_job_is_asked_for_today() {
        let recording = recording().expect("a recording");
        let default = Preset::Auto.options();
        let options = default.with_overrides(&recording.options).expect("options");
        assert_eq!(options, default, "run tools/make_sample.sh");
        assert_eq!(recording.best_round, 2);
        let finished = |event: &&Event| matches!(event, Event::RoundFinished { .. });
        assert_eq!(recording.events.iter().filter(finished).count(), 2);
    }

    #[test]
    fn the_sample_takes_two_megabytes() {
        let bytes = |name: Cow<'_, str>| Files::get(&name).expect("a file").data.len();
        let all: usize = Files::iter().map(bytes).sum();
        assert!((1_000_000..2_000_000).contains(&all), "{all}");
    }

    #[test]
    fn the_scene_that_ships_looks_as_the_run_rendered_it() {
        let dir = tempfile::tempdir().expect("a folder");
        let run = RunFolder::new(dir.path());
        write_result(&run, 2).expect("written");
        for view in ["000", "008", "015"] {
            let path = run.restored_view(view);
            let restored = Image::load(&path).expect("a view");
            let recorded = run.root().join(format!("rounds/2/renders/{view}.jpg"));
            let recorded = Image::load(&recorded).expect("a render");
            // The recorded one is a small JPEG.
            let psnr = metrics::psnr(&restored, &recorded);
            assert!(psnr > 32.0, "{view}: {psnr} dB");
        }
    }
}
