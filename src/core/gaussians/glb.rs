//! Scenes as binary glTF 2.0 with the ratified extension `KHR_gaussian_splatting`, for three.js,
//! Babylon.js, Cesium, PlayCanvas and other programs that read glTF. Nothing is rounded: rotations
//! are unit quaternions x y z w, scales and opacities are not logarithms and logits but the numbers
//! themselves, and an offset that `f32` cannot represent is the node's translation.
//!
//! glTF's y points up and its z backwards, so the scene is turned by half a turn about x.

use std::io::{self, Write};

use serde_json::{Map, Value, json};

use super::ply::{Scene, in_file};
use super::{Gaussians, Y00};
use crate::image::srgb_to_linear;

/// "glTF", the version, and the types of the two chunks.
const MAGIC: &[u8; 4] = b"glTF";
const VERSION: u32 = 2;
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BINARY_CHUNK: &[u8; 4] = b"BIN\0";

/// glTF's component types.
const UNSIGNED_SHORT: u32 = 5123;
const FLOAT: u32 = 5126;

/// glTF's target of vertices, and its mode of points.
const ARRAY_BUFFER: u32 = 34_962;
const POINTS: u32 = 0;

/// A number for each Gaussian and component.
struct Attribute<'a> {
    semantic: String,
    /// How many of the four numbers count.
    width: usize,
    component: u32,
    row: Box<dyn Fn(usize) -> [f32; 4] + 'a>,
}

impl<'a> Attribute<'a> {
    fn new(semantic: &str, width: usize, row: impl Fn(usize) -> [f32; 4] + 'a) -> Self {
        let (semantic, row) = (semantic.to_owned(), Box::new(row));
        Self { semantic, width, component: FLOAT, row }
    }

    /// Bytes of a Gaussian.
    fn stride(&self) -> usize {
        self.width * if self.component == FLOAT { 4 } else { 2 }
    }

    fn write(&self, index: usize, out: &mut dyn Write) -> io::Result<()> {
        for value in &(self.row)(index)[..self.width] {
            if self.component == FLOAT {
                out.write_all(&value.to_le_bytes())?;
            } else {
                // The cast clamps values outside the range.
                let share = (value * f32::from(u16::MAX)).round() as u16;
                out.write_all(&share.to_le_bytes())?;
            }
        }
        Ok(())
    }
}

/// Size of this many Gaussians in bytes, without the JSON.
pub fn bytes_of(count: usize, sh_degree: u32) -> u64 {
    let coefficients = ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let gaussians = Gaussians { sh_degree, ..Gaussians::default() };
    let stride: usize = attributes(&gaussians, coefficients).iter().map(Attribute::stride).sum();
    (count * stride) as u64
}

/// Writes the file; Gaussians that are not [usable](Gaussians::is_usable) are left out.
///
/// # Errors
/// Those of the writer, and if no Gaussian is usable, which glTF cannot express.
pub fn write_to(scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
    let gaussians = in_file(&scene.gaussians, &scene.normalisation).without_unusable();
    let gaussians = gaussians.turned_y_up();
    if gaussians.is_empty() {
        return Err(io::Error::other("glTF cannot hold a scene without Gaussians"));
    }
    let attributes = attributes(&gaussians, gaussians.coefficients());
    let length = gaussians.len() * attributes.iter().map(Attribute::stride).sum::<usize>();
    let mut document = document(&gaussians, &attributes, length);
    let offset = scene.normalisation.missing_in_files();
    if scene.normalisation.left_out {
        document["nodes"][0]["translation"] = json!([offset.x, -offset.y, -offset.z]);
    }
    let mut text = document.to_string();
    while !text.len().is_multiple_of(4) {
        text.push(' ');
    }
    let too_long = |_| io::Error::other("the scene is larger than the 4 GiB of a binary glTF");
    let whole = u32::try_from(12 + 8 + text.len() + 8 + length).map_err(too_long)?;
    out.write_all(MAGIC)?;
    out.write_all(&VERSION.to_le_bytes())?;
    out.write_all(&whole.to_le_bytes())?;
    for (kind, length) in [(JSON_CHUNK, text.len()), (BINARY_CHUNK, length)] {
        out.write_all(&(length as u32).to_le_bytes())?;
        out.write_all(kind)?;
        if kind == JSON_CHUNK {
            out.write_all(text.as_bytes())?;
        }
    }
    for attribute in &attributes {
        for index in 0..gaussians.len() {
            attribute.write(index, out)?;
        }
    }
    out.flush()
}

/// The attributes of a Gaussian in the extension, each a multiple of four bytes.
fn attributes(scene: &Gaussians, coefficients: usize) -> Vec<Attribute<'_>> {
    let sh = move |index: usize, coefficient: usize| {
        let at = 3 * (index * coefficients + coefficient);
        wide(std::array::from_fn(|channel| scene.sh[at + channel]))
    };
    let colour = move |index: usize| {
        let [r, g, b, _] = sh(index, 0);
        let [r, g, b] = [r, g, b].map(|value| srgb_to_linear((0.5 + Y00 * value).clamp(0.0, 1.0)));
        [r, g, b, scene.opacity(index) as f32]
    };
    let rotation = |index: usize| {
        let [w, x, y, z] = scene.rotation(index);
        [x, y, z, w].map(|q| q as f32)
    };
    let opacity = |index: usize| [scene.opacity(index) as f32, 0.0, 0.0, 0.0];
    let extension = |name: &str| format!("KHR_gaussian_splatting:{name}");
    let mut attributes = vec![
        Attribute::new("POSITION", 3, |index| wide(scene.means[index])),
        // For viewers without the extension: points in linear light, as glTF has vertex colours.
        Attribute { component: UNSIGNED_SHORT, ..Attribute::new("COLOR_0", 4, colour) },
        Attribute::new(&extension("ROTATION"), 4, rotation),
        Attribute::new(&extension("SCALE"), 3, |i| wide(scene.log_scales[i].map(f32::exp))),
        Attribute::new(&extension("OPACITY"), 1, opacity),
    ];
    for coefficient in 0..coefficients {
        let degree = coefficient.isqrt();
        let name = format!("SH_DEGREE_{degree}_COEF_{}", coefficient - degree * degree);
        let row = move |index| sh(index, coefficient);
        attributes.push(Attribute::new(&extension(&name), 3, row));
    }
    attributes
}

fn wide([x, y, z]: [f32; 3]) -> [f32; 4] {
    [x, y, z, 0.0]
}

/// The JSON of one node with one mesh whose attributes lie one after the other in the buffer.
fn document(scene: &Gaussians, attributes: &[Attribute<'_>], length: usize) -> Value {
    let mut at = 0;
    let (mut views, mut accessors, mut names) = (Vec::new(), Vec::new(), Map::new());
    for (number, attribute) in attributes.iter().enumerate() {
        let bytes = attribute.stride() * scene.len();
        views.push(json!({
            "buffer": 0, "byteOffset": at, "byteLength": bytes, "target": ARRAY_BUFFER
        }));
        at += bytes;
        let kind = if attribute.width == 1 { "SCALAR" } else { &format!("VEC{}", attribute.width) };
        let mut accessor = json!({
            "bufferView": number, "componentType": attribute.component, "count": scene.len(),
            "type": kind
        });
        if attribute.component != FLOAT {
            accessor["normalized"] = true.into();
        }
        if attribute.semantic == "POSITION" {
            let end = |pick: fn(f32, f32) -> f32| {
                scene.means.iter().copied().reduce(|a, b| std::array::from_fn(|i| pick(a[i], b[i])))
            };
            accessor["min"] = json!(end(f32::min));
            accessor["max"] = json!(end(f32::max));
        }
        accessors.push(accessor);
        names.insert(attribute.semantic.clone(), number.into());
    }
    json!({
        "asset": { "version": "2.0", "generator": "fled" },
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{
            "mode": POINTS,
            "attributes": names,
            "extensions": { "KHR_gaussian_splatting": {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "projection": "perspective",
                "sortingMethod": "cameraDistance"
            } }
        }] }],
        "buffers": [{ "byteLength": length }],
        "bufferViews": views,
        "accessors": accessors
    })
}

#[cfg(test)]
mod tests;
