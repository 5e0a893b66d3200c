//! Masked pixels have no part in a result.

use std::fs;
use std::path::Path;

use fled_core::image::Image;
use fled_core::synthetic::{SynthOptions, generate};

use crate::support::{fled, succeed};

/// The scene of a capture with an object of this colour before every photograph.
fn scene(folder: &Path, colour: [f32; 3], masked: bool) -> Vec<u8> {
    let (capture, out) = (folder.join("capture"), folder.join("out"));
    let options =
        SynthOptions { views: 12, width: 96, height: 64, seed: 3, ..SynthOptions::default() };
    let made = generate(&options, &capture).expect("a synthetic capture");
    fs::create_dir(capture.join("masks")).expect("created");
    for (name, _) in &made.cameras {
        let path = capture.join("images").join(name).with_extension("png");
        let mut photograph = Image::load(&path).expect("a photograph");
        let mut mask = photograph.map(|_| 1.0);
        for (x, y) in (30..54).flat_map(|x| (20..44).map(move |y| (x, y))) {
            photograph.set(x, y, colour);
            mask.set(x, y, [0.0; 3]);
        }
        photograph.save(&path).expect("written");
        if masked {
            let file = path.file_name().expect("a name");
            mask.save(&capture.join("masks").join(file)).expect("written");
        }
    }
    let mut command = fled();
    // Without COLMAP, the points are drawn from the seed; COLMAP's differ each time.
    command.env("PATH", "/nowhere").arg("run").arg(&capture).arg("--out").arg(&out);
    command.args(["--preset", "preview", "--cache", "none"]);
    // A network would spread the content below the mask.
    for set in
        ["size=64", "steps=30", "rounds=1", "cap=500", "pose_source=given", "deblur=identity"]
    {
        command.args(["--set", set]);
    }
    let output = succeed(&mut command);
    let log = String::from_utf8_lossy(&output.stderr);
    assert_eq!(log.contains("12 of 12 photographs have masks"), masked, "{log}");
    fs::read(out.join("scene.ply")).expect("a scene")
}

#[test]
fn the_colour_of_masked_pixels_does_not_change_a_byte_of_the_scene() {
    let scene = |colour, masked| {
        let folder = tempfile::tempdir().expect("temporary folder");
        scene(folder.path(), colour, masked)
    };
    let (magenta, green) = ([1.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
    assert_eq!(scene(magenta, true), scene(green, true));
    assert_ne!(scene(magenta, false), scene(green, false), "the test cannot fail");
}
