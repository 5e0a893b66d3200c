//! Scenes as SOG version 2, PlayCanvas' layout for the web: a zip of `meta.json` and lossless WebP
//! images with a pixel for each Gaussian, along a space-filling curve so that neighbours are alike.
//! Scales, colours and higher harmonics are indices into codebooks.

mod codebook;

use std::io::{self, Cursor, Write};

use codebook::{Codebook, Palette};
use image_webp::{ColorType, WebPEncoder};
use serde_json::{Value, json};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::Gaussians;
use super::compressed::along_curve;
use super::ply::{Scene, in_file};

/// Images have sides of a multiple of this, px.
const STEP: usize = 4;

/// The longest side of a WebP image, px.
const LONGEST: usize = 16_383;

/// Codes for the largest number of a quaternion begin here.
const QUATERNIONS: u8 = 252;

/// Rows of a palette's image hold this many entries.
const ENTRIES: usize = 64;

/// Most entries of a palette.
const MOST_ENTRIES: usize = 1 << 16;

/// A pixel: red, green, blue, alpha.
type Pixel = [u8; 4];

/// Approximate size of this many Gaussians in bytes.
pub fn bytes_of(count: usize, sh_degree: u32) -> u64 {
    let harmonics = 3 * ((sh_degree + 1) * (sh_degree + 1) - 1) as usize;
    let entries = if sh_degree > 0 { entries(count) } else { 0 };
    (17 * count + entries * harmonics) as u64
}

/// Entries of the palette for this many Gaussians.
fn entries(count: usize) -> usize {
    let power = (count.max(2) as u64).ilog2().saturating_sub(1);
    (1 << power).min(MOST_ENTRIES)
}

/// Writes the file; Gaussians that are not [usable](Gaussians::is_usable) are left out.
///
/// # Errors
/// Those of the writer, and if there are no or too many Gaussians.
pub fn write_to(scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
    let gaussians = in_file(&scene.gaussians, &scene.normalisation);
    let gaussians = gaussians.select(&along_curve(&gaussians));
    let side = (gaussians.len() as f64).sqrt();
    let width = (side / STEP as f64).ceil() as usize * STEP;
    if width == 0 || width > LONGEST {
        let count = gaussians.len();
        return Err(io::Error::other(format!("SOG cannot hold a scene of {count} Gaussians")));
    }
    let mut bundle = Bundle { zip: ZipWriter::new(Cursor::default()), width };
    let mut meta = json!({
        "version": 2,
        "asset": { "generator": "fled" },
        "count": gaussians.len(),
        "means": means(&gaussians, &mut bundle)?,
        "quats": { "files": bundle.image("quats.webp", quaternions(&gaussians))? },
        "scales": scales(&gaussians, &mut bundle)?,
        "sh0": colours(&gaussians, &mut bundle)?,
    });
    if gaussians.sh_degree > 0 {
        meta["shN"] = harmonics(&gaussians, &mut bundle)?;
    }
    bundle.file("meta.json", meta.to_string().as_bytes())?;
    out.write_all(bundle.zip.finish()?.get_ref())?;
    out.flush()
}

/// The zip, in which nothing is compressed again.
struct Bundle {
    zip: ZipWriter<Cursor<Vec<u8>>>,
    /// Width of the images with a pixel for each Gaussian, px.
    width: usize,
}

impl Bundle {
    fn file(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        self.zip.start_file(name, options)?;
        self.zip.write_all(bytes)
    }

    /// Adds an image of these pixels, and returns its name in a list.
    fn image(&mut self, name: &str, pixels: Vec<Pixel>) -> io::Result<Value> {
        let rows = pixels.len().div_ceil(self.width).next_multiple_of(STEP);
        self.image_of(name, pixels, self.width, rows)
    }

    fn image_of(
        &mut self,
        name: &str,
        mut pixels: Vec<Pixel>,
        width: usize,
        rows: usize,
    ) -> io::Result<Value> {
        pixels.resize(width * rows, [0; 4]);
        let mut bytes = Vec::new();
        WebPEncoder::new(&mut bytes)
            .encode(pixels.as_flattened(), width as u32, rows as u32, ColorType::Rgba8)
            .map_err(io::Error::other)?;
        self.file(name, &bytes)?;
        Ok(json!([name]))
    }
}

/// Means as 16 bits of a signed logarithm, in two images of eight.
fn means(gaussians: &Gaussians, bundle: &mut Bundle) -> io::Result<Value> {
    let log = |value: f32| f64::from(value).abs().ln_1p().copysign(f64::from(value));
    let logs: Vec<[f64; 3]> = gaussians.means.iter().map(|mean| mean.map(log)).collect();
    let end = |pick: fn(f64, f64) -> f64, start: f64| {
        logs.iter().fold([start; 3], |end, row| std::array::from_fn(|i| pick(end[i], row[i])))
    };
    let (least, most) = (end(f64::min, f64::INFINITY), end(f64::max, f64::NEG_INFINITY));
    let share = |row: &[f64; 3], axis: usize| {
        let width = most[axis] - least[axis];
        let share = if width > 0.0 { (row[axis] - least[axis]) / width } else { 0.0 };
        (share * f64::from(u16::MAX)).round() as u16
    };
    let image = |byte: usize| {
        let pixel = |row| {
            let [x, y, z] = [0, 1, 2].map(|axis| share(row, axis).to_le_bytes()[byte]);
            [x, y, z, u8::MAX]
        };
        logs.iter().map(pixel).collect()
    };
    bundle.image("means_l.webp", image(0))?;
    bundle.image("means_u.webp", image(1))?;
    Ok(json!({ "mins": least, "maxs": most, "files": ["means_l.webp", "means_u.webp"] }))
}

/// The three smaller numbers of each quaternion w, x, y, z, and which is the largest.
fn quaternions(gaussians: &Gaussians) -> Vec<Pixel> {
    let pixel = |index: usize| {
        let quat = gaussians.rotation(index);
        let larger =
            |best: usize, i: usize| if quat[i].abs() > quat[best].abs() { i } else { best };
        let largest = (1..4).fold(0, larger);
        // A rotation equals its negative: make the largest positive, so it need not be stored.
        let sign = quat[largest].signum();
        let mut others = (0..4).filter(|&i| i != largest).map(|i| {
            let share = quat[i] * sign * std::f64::consts::FRAC_1_SQRT_2 + 0.5;
            (share * 255.0).round() as u8
        });
        let [a, b, c] = std::array::from_fn(|_| others.next().unwrap_or_default());
        [a, b, c, QUATERNIONS + largest as u8]
    };
    (0..gaussians.len()).map(pixel).collect()
}

fn scales(gaussians: &Gaussians, bundle: &mut Bundle) -> io::Result<Value> {
    let book = Codebook::of(gaussians.log_scales.as_flattened().to_vec());
    let pixel = |log_scales: &[f32; 3]| {
        let [x, y, z] = log_scales.map(|scale| book.index(scale));
        [x, y, z, u8::MAX]
    };
    let files = bundle.image("scales.webp", gaussians.log_scales.iter().map(pixel).collect())?;
    Ok(json!({ "codebook": book.values(), "files": files }))
}

/// Base colours as harmonics, and opacities.
fn colours(gaussians: &Gaussians, bundle: &mut Bundle) -> io::Result<Value> {
    let rows = gaussians.sh.chunks_exact(3 * gaussians.coefficients());
    let book = Codebook::of(rows.clone().flat_map(|row| &row[..3]).copied().collect());
    let pixel = |(index, row): (usize, &[f32])| {
        let opacity = (gaussians.opacity(index) * 255.0).round() as u8;
        [book.index(row[0]), book.index(row[1]), book.index(row[2]), opacity]
    };
    let files = bundle.image("sh0.webp", rows.enumerate().map(pixel).collect())?;
    Ok(json!({ "codebook": book.values(), "files": files }))
}

/// Higher harmonics as entries of a palette, whose numbers are indices into a codebook.
fn harmonics(gaussians: &Gaussians, bundle: &mut Bundle) -> io::Result<Value> {
    let rows = gaussians.sh.chunks_exact(3 * gaussians.coefficients());
    let rows: Vec<&[f32]> = rows.map(|row| &row[3..]).collect();
    let palette = Palette::of(&rows, entries(rows.len()));
    let book = Codebook::of(palette.entries.concat());
    let label = |&label: &u16| {
        let [low, high] = label.to_le_bytes();
        [low, high, 0, u8::MAX]
    };
    let labels = palette.labels.iter().map(label).collect();
    let colour = |rgb: &[f32]| {
        let [r, g, b] = [0, 1, 2].map(|channel| book.index(rgb[channel]));
        [r, g, b, u8::MAX]
    };
    let colours = palette.entries.iter().flat_map(|entry| entry.chunks_exact(3).map(colour));
    let (width, height) =
        (ENTRIES * (gaussians.coefficients() - 1), palette.entries.len().div_ceil(ENTRIES));
    bundle.image_of("shN_centroids.webp", colours.collect(), width, height)?;
    bundle.image("shN_labels.webp", labels)?;
    Ok(json!({
        "count": palette.entries.len(), "bands": gaussians.sh_degree, "codebook": book.values(),
        "files": ["shN_centroids.webp", "shN_labels.webp"]
    }))
}

#[cfg(test)]
mod tests;
