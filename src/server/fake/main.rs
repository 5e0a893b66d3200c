//! A server with fake child processes, for the tests of the service.
//!
//! `serve DATA ADDRESS_FILE` starts it; the other verbs run as its child processes. The option
//! `adapter`, the only free text that the service does not interpret, selects the behaviour of a
//! job.

mod death;
mod job;
mod mesh;
mod protocol;
mod saved;
mod scores;
mod video;

use std::ffi::OsString;
use std::io::{self, BufRead};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use fled_core::group::{GUARD, become_guarded};
use fled_core::image::Image;
use fled_server::render::{RenderRequest, Shown};
use fled_server::validator::{AssessReply, AssessRequest, assess};
use fled_server::{Limits, Retention, ServeConfig};
use protocol::say;
use rustix::process::{Resource, Rlimit, setrlimit};

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    if arguments.first().is_some_and(|verb| verb == GUARD) {
        return Ok(become_guarded(&arguments[1..]));
    }
    fled_server::die_with_parent()?;
    play(&arguments).map(|()| ExitCode::SUCCESS)
}

fn play(arguments: &[OsString]) -> Result<(), Box<dyn std::error::Error>> {
    match arguments.first().and_then(|verb| verb.to_str()) {
        Some("serve") => serve(Path::new(&arguments[1]), Path::new(&arguments[2])),
        Some("run") => job::run(&arguments[1..]),
        Some("render-worker") => render_worker(),
        Some("assess-worker") => assess_worker(),
        Some("video") => video::make(&arguments[1..]),
        Some("export") => mesh::make(&arguments[1..]),
        Some("doctor") => {
            say(
                r#"{"checks":[{"name":"adapter","ok":true,"detail":"played"},{"name":"colmap","ok":false,"detail":"no /usr/bin/colmap","hint":"apt-get install colmap"}],"has_gpu":false}"#,
            );
            Ok(())
        }
        _ => Err("one of serve, run, render-worker, assess-worker, video, export, doctor".into()),
    }
}

fn serve(data: &Path, address_file: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let program = std::env::current_exe()?;
    limit_descriptors()?;
    let command = |verb: &str| vec![program.clone().into_os_string(), verb.into()];
    let config = ServeConfig {
        data: data.to_owned(),
        database: std::env::var("FLED_FAKE_DB").ok(),
        files: std::env::var("FLED_FAKE_STORE").ok(),
        about: std::env::var("FLED_FAKE_ABOUT")
            .ok()
            .map(|about| serde_json::from_str(&about))
            .transpose()?,
        listen: std::env::var("FLED_FAKE_LISTEN")
            .unwrap_or_else(|_| "127.0.0.1:0".to_owned())
            .parse()?,
        open: false,
        hosts: vec!["fled.test".to_owned()],
        workers: number("FLED_FAKE_WORKERS", 2)? as usize,
        job_command: command("run"),
        render_command: command("render-worker"),
        assess_command: command("assess-worker"),
        video_command: command("video"),
        export_command: command("export"),
        doctor_command: command("doctor"),
        inner_webhooks: number("FLED_FAKE_INNER", 0)? > 0,
        ffmpeg: std::env::var_os("FLED_FAKE_FFMPEG").unwrap_or_else(|| "ffmpeg".into()).into(),
        models: std::env::var_os("FLED_MODELS").into_iter().map(Into::into).collect(),
        retention: Retention {
            age: milliseconds("FLED_FAKE_KEEP_MS")?,
            jobs: None,
            notice: milliseconds("FLED_FAKE_NOTICE_MS")?.unwrap_or_default(),
        },
        watcher: death::planned()?,
        limits: limits()?,
    };
    tokio::runtime::Runtime::new()?.block_on(async {
        // A worker has no address: its empty file shows that it is ready.
        let server = match std::env::var_os("FLED_FAKE_WORKER") {
            Some(_) => fled_server::Server::start_worker(config).await?,
            None => fled_server::Server::start(config).await?,
        };
        let address = server.address().map(|address| address.to_string());
        // Renamed into place, so that the file is complete once it exists.
        let beside = address_file.with_extension("tmp");
        std::fs::write(&beside, address.unwrap_or_default())?;
        std::fs::rename(beside, address_file)?;
        tokio::signal::ctrl_c().await?;
        server.stop().await;
        Ok(())
    })
}

/// Limits open files to the number that a test sets.
fn limit_descriptors() -> Result<(), Box<dyn std::error::Error>> {
    let descriptors = number("FLED_FAKE_DESCRIPTORS", 0)?;
    if descriptors > 0 {
        let limit = Rlimit { current: Some(descriptors), maximum: Some(descriptors) };
        setrlimit(Resource::Nofile, limit)?;
    }
    Ok(())
}

/// Short timeouts, overridden by a test's settings.
fn limits() -> Result<Limits, std::num::ParseIntError> {
    Ok(Limits {
        lease: Duration::from_secs(5),
        heartbeat: Duration::from_millis(500),
        unheard: Duration::from_secs(4),
        publish: Duration::from_millis(500),
        look: Duration::from_millis(500),
        silence: Duration::from_secs(3),
        progress_interval: Duration::from_millis(100),
        retry_base: Duration::from_millis(50),
        connections: number("FLED_FAKE_CONNECTIONS", 1024)? as usize,
        header: Duration::from_millis(number("FLED_FAKE_HEADER_MS", 30_000)?),
        stall: Duration::from_millis(number("FLED_FAKE_STALL_MS", 30_000)?),
        render: Duration::from_secs(3),
        rate: number("FLED_FAKE_RATE", 50)? as u32,
        burst: number("FLED_FAKE_BURST", 1000)? as u32,
        queue: number("FLED_FAKE_QUEUE", 200)? as u32,
        io_retry_base: Duration::from_millis(number("FLED_FAKE_IO_RETRY_MS", 50)?),
        min_free_bytes: number("FLED_FAKE_MIN_FREE", 1 << 20)?,
        max_upload_bytes: number("FLED_FAKE_UPLOAD_BYTES", 1 << 30)?,
        max_uploads: number("FLED_FAKE_UPLOADS", 1000)? as u32,
        upload_life: Duration::from_millis(number("FLED_FAKE_UPLOAD_MS", 60_000)?),
        max_decoding_bytes: number("FLED_FAKE_DECODING", 1 << 30)?,
        assessing_bytes: number("FLED_FAKE_ASSESSING", 4 << 30)?,
        photograph: Duration::from_millis(number("FLED_FAKE_PHOTOGRAPH_MS", 60_000)?),
        deaths_without_progress: number("FLED_FAKE_DEATHS", 5)? as u32,
        exports: number("FLED_FAKE_EXPORTS", 4)? as usize,
        meshing: Duration::from_millis(number("FLED_FAKE_MESHING_MS", 60_000)?),
        ..Limits::default()
    })
}

/// A duration that a test sets through the environment.
fn milliseconds(name: &str) -> Result<Option<Duration>, std::num::ParseIntError> {
    let text = std::env::var(name).ok().map(|text| text.parse());
    Ok(text.transpose()?.map(Duration::from_millis))
}

/// A limit that a test sets through the environment.
fn number(name: &str, default: u64) -> Result<u64, std::num::ParseIntError> {
    std::env::var(name).map_or(Ok(default), |text| text.parse())
}

/// Draws the camera's azimuth as a shade, and depth much brighter. A scene that contains `crash`
/// ends the process, `refuse` is refused, and `slow` takes longer.
fn render_worker() -> Result<(), Box<dyn std::error::Error>> {
    for line in io::stdin().lock().lines() {
        let request: RenderRequest = serde_json::from_str(&line?)?;
        let scene = std::fs::read(&request.scene)?;
        let scene = String::from_utf8_lossy(&scene);
        if scene.contains("crash") {
            std::process::exit(139);
        }
        if scene.contains("slow") {
            std::thread::sleep(Duration::from_millis(700));
        }
        if scene.contains("refuse") {
            say(r#"{"error":"/srv/fled/jobs/1/output/scene.ply: damaged"}"#);
            continue;
        }
        if request.crop.is_some_and(|crop| !crop.contains(glam::DVec3::ZERO)) {
            say(r#"{"empty":"no Gaussian's centre is inside the crop"}"#);
            continue;
        }
        let k = request.camera.intrinsics;
        let turn = request.camera.world_to_camera[0][0] as f32;
        let shade = match request.shown {
            Shown::Colour => 0.3 + 0.3 * turn,
            Shown::Depth => 0.9,
        };
        let shade = if request.crop.is_some() { 0.5 * shade } else { shade };
        let picture: Image = Image::new(k.width, k.height).map(|_| shade);
        let out = PathBuf::from(&request.out);
        let format = match request.format {
            fled_server::render::Format::Png => fled_core::image::EncodeFormat::Png,
            fled_server::render::Format::Jpeg => fled_core::image::EncodeFormat::Jpeg(90),
            fled_server::render::Format::Webp => fled_core::image::EncodeFormat::Webp,
        };
        std::fs::write(out, picture.encode(format)?)?;
        say(r#"{"ok":true}"#);
    }
    Ok(())
}

/// Validates an upload like the real process, but crashes on a photograph named `crash.png` and
/// never finishes `endless.png`.
fn assess_worker() -> Result<(), Box<dyn std::error::Error>> {
    let mut input = io::stdin().lock();
    let mut line = String::new();
    input.read_line(&mut line)?;
    let request: AssessRequest = serde_json::from_str(&line)?;
    for name in ["crash.png", "endless.png"] {
        if request.dir.join("images").join(name).exists() {
            say(&serde_json::to_string(&AssessReply::Begins(name.to_owned()))?);
            if name == "crash.png" {
                std::process::abort();
            }
            std::thread::sleep(Duration::from_secs(600));
        }
    }
    Ok(assess(&request, &mut input)?)
}
