//! A fake video: as long and as large as a real one, but with a simple moving picture.
//!
//! Its frame rate selects the outcome: at 5 each frame takes a tenth of a second, at 7 it fails, at
//! 9 the process dies.

use std::error::Error;
use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use fled_core::camera::{Camera, NamedCamera};
use fled_core::event::Event;
use fled_core::group::guarded;
use fled_core::image::Image;
use fled_core::video::{EncodeError, Plan, Target, write};

use crate::protocol::{argument, tell};

pub fn make(arguments: &[OsString]) -> Result<(), Box<dyn Error>> {
    let plan: Plan = serde_json::from_slice(&fs::read(argument(arguments, "--plan")?)?)?;
    let views = Path::new(&arguments[0]).join("cameras.json");
    let views: Vec<NamedCamera> = serde_json::from_slice(&fs::read(views)?)?;
    let cameras = plan.cameras(&views)?;
    let (program, file) = (argument(arguments, "--ffmpeg")?, argument(arguments, "--output")?);
    let target = Target { command: &guarded(&program)?, file: &file, fps: plan.fps() };
    let total = cameras.len();
    let picture = |number: usize, camera: &Camera| {
        match plan.fps() {
            5 => sleep(Duration::from_millis(100)),
            7 => {
                let path = file.display();
                let reason = format!("planned for {path}");
                return Err(EncodeError::Refused { reason });
            }
            9 => std::process::abort(),
            _ => {}
        }
        let done = (number + 1) as f64;
        tell(&Event::Progress { progress: done / total as f64, eta_seconds: None });
        Ok(drawn(camera, number as f32 / total as f32))
    };
    let outcome = write(&target, &cameras, picture);
    tell(&match &outcome {
        Ok(()) => Event::Finished { best_round: 0, seconds: 0.0 },
        Err(error) => Event::Failed {
            kind: "io".to_owned(),
            detail: error.to_string(),
            hint: error.hint().to_owned(),
        },
    });
    Ok(outcome?)
}

/// A plain background with a bright bar that moves from left to right.
fn drawn(camera: &Camera, share: f32) -> Image {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut picture = Image::new(width, height);
    for y in 0..height {
        for x in 0..width {
            let (x_share, y_share) = (x as f32 / width as f32, y as f32 / height as f32);
            let bar = if (x_share - share).abs() < 0.05 { 0.5 } else { 0.0 };
            picture.set(x, y, [0.2 + bar, 0.2 + 0.3 * y_share, 0.3 + bar]);
        }
    }
    picture
}
