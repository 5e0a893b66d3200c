use std::io::Read;

use image_webp::WebPDecoder;
use zip::ZipArchive;

use super::super::fixtures::{differences, scattered};
use super::*;
use crate::camera::normalisation::Normalisation;

fn written(gaussians: &Gaussians) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let scene = Scene { gaussians: gaussians.clone(), normalisation: Normalisation::default() };
    write_to(&scene, &mut bytes).map(|()| bytes)
}

fn file(bytes: &[u8], name: &str) -> Vec<u8> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).expect("a zip");
    let mut content = Vec::new();
    archive.by_name(name).expect("there").read_to_end(&mut content).expect("read");
    content
}

/// The pixels and the width of an image.
fn pixels(bytes: &[u8], name: &str) -> (Vec<Pixel>, usize) {
    let mut decoder = WebPDecoder::new(Cursor::new(file(bytes, name))).expect("WebP");
    let mut pixels = vec![0; decoder.output_buffer_size().expect("a size")];
    decoder.read_image(&mut pixels).expect("pixels");
    let channels = if decoder.has_alpha() { 4 } else { 3 };
    let pixel = |p: &[u8]| [p[0], p[1], p[2], p.get(3).copied().unwrap_or(u8::MAX)];
    (pixels.chunks_exact(channels).map(pixel).collect(), decoder.dimensions().0 as usize)
}

fn numbers(value: &Value) -> Vec<f32> {
    serde_json::from_value(value.clone()).expect("numbers")
}

/// Reads a file as PlayCanvas' tools do.
fn read(bytes: &[u8]) -> Gaussians {
    let meta: Value = serde_json::from_slice(&file(bytes, "meta.json")).expect("JSON");
    let count = meta["count"].as_u64().expect("a count") as usize;
    let sh_degree = meta["shN"]["bands"].as_u64().unwrap_or_default() as u32;
    let mut scene = Gaussians { sh_degree, ..Gaussians::default() };
    let image = |name: &str| pixels(bytes, name).0;
    let (low, high, quats) = (image("means_l.webp"), image("means_u.webp"), image("quats.webp"));
    let (scales, sh0) = (image("scales.webp"), image("sh0.webp"));
    let (least, most) = (numbers(&meta["means"]["mins"]), numbers(&meta["means"]["maxs"]));
    let (of_scales, of_colours) =
        (numbers(&meta["scales"]["codebook"]), numbers(&meta["sh0"]["codebook"]));
    let higher = (sh_degree > 0).then(|| {
        let ((entries, width), labels) =
            (pixels(bytes, "shN_centroids.webp"), image("shN_labels.webp"));
        let book = numbers(&meta["shN"]["codebook"]);
        assert_eq!(width, 64 * (scene.coefficients() - 1));
        (entries, labels, book)
    });
    for i in 0..count {
        scene.means.push(std::array::from_fn(|axis| {
            let share = f32::from(u16::from_le_bytes([low[i][axis], high[i][axis]])) / 65_535.0;
            let log = least[axis] + (most[axis] - least[axis]) * share;
            log.abs().exp_m1().copysign(log)
        }));
        let others = [0, 1, 2].map(|n| (f32::from(quats[i][n]) / 255.0 - 0.5) * 2_f32.sqrt());
        let mut quat = others.to_vec();
        let largest = (1.0 - others.iter().map(|q| q * q).sum::<f32>()).max(0.0).sqrt();
        quat.insert(usize::from(quats[i][3] - 252), largest);
        scene.quats.push(quat.try_into().expect("four"));
        scene.log_scales.push([0, 1, 2].map(|n| of_scales[usize::from(scales[i][n])]));
        let opacity = f32::from(sh0[i][3]) / 255.0;
        scene.opacity_logits.push((opacity / (1.0 - opacity)).ln());
        scene.sh.extend([0, 1, 2].map(|n| of_colours[usize::from(sh0[i][n])]));
        if let Some((entries, labels, book)) = &higher {
            let label = usize::from(u16::from_le_bytes([labels[i][0], labels[i][1]]));
            let row = scene.coefficients() - 1;
            let entry = &entries[label * row..][..row];
            let value = |n: u8| book[usize::from(n)];
            scene.sh.extend(entry.iter().flat_map(|p| [p[0], p[1], p[2]]).map(value));
        }
    }
    scene
}

#[test]
fn a_round_trip_differs_by_at_most_the_codebooks_steps() {
    for degree in 0..=3 {
        let scene = scattered(1000, 8.0, degree);
        let bytes = written(&scene).expect("written");
        let back = read(&bytes);
        let expected = scene.select(&along_curve(&scene));
        let found = differences(&expected, &back);
        // 16 bits of ln 9 at 8; 256 values for six; for two; 8 bits; a step of a rotation. The
        // harmonics here have nothing in common, so a palette cannot hold them.
        let bounds = [1.6e-4, 6.0 / 255.0, 0.006, 1.0 / 510.0, 0.02, 3.0];
        for (found, bound) in found.iter().zip(bounds) {
            assert!(*found <= bound, "degree {degree}: {found} > {bound}");
        }
    }
}

#[test]
fn harmonics_of_a_few_kinds_are_kept() {
    let mut scene = scattered(640, 2.0, 2);
    let kinds = scattered(40, 2.0, 2).sh;
    for (index, row) in scene.sh.chunks_exact_mut(27).enumerate() {
        row[3..].copy_from_slice(&kinds[27 * (index % 40)..][3..27]);
    }
    let back = read(&written(&scene).expect("written"));
    let harmonics = differences(&scene.select(&along_curve(&scene)), &back)[5];
    assert!(harmonics < 3.0 / 255.0, "{harmonics}");
}

#[test]
fn non_finite_gaussians_are_left_out_and_an_empty_scene_is_refused() {
    let mut scene = scattered(9, 1.0, 1);
    scene.means[1][2] = f32::NAN;
    let bytes = written(&scene).expect("written");
    assert_eq!(read(&bytes).len(), 8);
    assert_eq!(bytes, written(&scene).expect("written"), "it depends on the scene alone");
    let error = written(&scene.select(&[1])).expect_err("empty");
    assert!(error.to_string().contains("0 Gaussians"), "{error}");
}
