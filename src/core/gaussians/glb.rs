//! Scenes as binary glTF 2.0 with the ratified extension `KHR_gaussian_splatting`, for three.js,
//! Babylon.js, Cesium, PlayCanvas and other programs that read glTF. Nothing is rounded: rotations
//! are unit quaternions x y z w, scales and opacities are not logarithms and logits but the numbers
//! themselves, and the node has the placement, with an offset that `f32` cannot represent.
//!
//! glTF's y points up and its z backwards, so the scene is turned by half a turn about x; the node
//! has the rest of the rotation.

pub(crate) mod container;

use std::io::{self, Write};

use serde_json::{Value, json};

use super::placement::Placement;
use super::ply::{Scene, in_file};
use super::{Gaussians, Y00};
use crate::image::srgb_to_linear;
use container::{Attribute, Layout, write_attributes, write_header};

/// glTF's mode of points.
const POINTS: u32 = 0;

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
pub fn write_to(scene: &Scene, placement: Placement, out: &mut dyn Write) -> io::Result<()> {
    let gaussians = in_file(&scene.gaussians, &scene.normalisation).without_unusable();
    let gaussians = gaussians.turned_y_up();
    if gaussians.is_empty() {
        return Err(io::Error::other("glTF cannot hold a scene without Gaussians"));
    }
    let attributes = attributes(&gaussians, gaussians.coefficients());
    let layout = Layout::of(&attributes, gaussians.len());
    let length = layout.length;
    let mut document = document(&layout);
    placement.node(&scene.normalisation).add_to(&mut document["nodes"][0]);
    write_header(&document, length, out)?;
    write_attributes(&attributes, gaussians.len(), out)?;
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
        Attribute::shares("COLOR_0", 4, colour),
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

/// The JSON of one node with one mesh.
fn document(layout: &Layout) -> Value {
    json!({
        "asset": { "version": "2.0", "generator": "fled" },
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{
            "mode": POINTS,
            "attributes": layout.names,
            "extensions": { "KHR_gaussian_splatting": {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "projection": "perspective",
                "sortingMethod": "cameraDistance"
            } }
        }] }],
        "buffers": [{ "byteLength": layout.length }],
        "bufferViews": layout.views,
        "accessors": layout.accessors
    })
}

#[cfg(test)]
mod tests;
