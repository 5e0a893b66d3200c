//! Meshes as PLY and as binary glTF. Their measures are in the header, or in the node's extras.

use std::io::{self, Write};

use glam::Vec3;
use serde_json::json;

use super::{Facts, Mesh};
use crate::gaussians::glb::container::{self, Attribute};
use crate::gaussians::placement::Placement;
use crate::gaussians::ply::offset_comment;
use crate::image::srgb_to_linear;

/// Bytes of a vertex and a triangle in PLY.
const PLY: [usize; 2] = [27, 13];

/// Bytes of a vertex and a triangle in glTF.
const GLTF: [usize; 2] = [32, 12];

/// Approximate size of a PLY with this many triangles: a closed mesh has half as many vertices.
pub fn bytes_of_ply(triangles: usize) -> u64 {
    bytes_of(PLY, triangles)
}

/// Approximate size of a binary glTF with this many triangles.
pub fn bytes_of_gltf(triangles: usize) -> u64 {
    bytes_of(GLTF, triangles)
}

fn bytes_of([vertex, triangle]: [usize; 2], triangles: usize) -> u64 {
    (triangles * triangle + triangles / 2 * vertex) as u64
}

/// Writes a mesh as binary PLY in little endian, in the units of its placement.
///
/// # Errors
/// Those of the writer.
pub fn write_ply(mesh: &Mesh, placement: Placement, out: &mut dyn Write) -> io::Result<()> {
    let scale = placement.scale;
    out.write_all(b"ply\nformat binary_little_endian 1.0\n")?;
    out.write_all(offset_comment(&mesh.normalisation.of_scaled_world(scale)).as_bytes())?;
    writeln!(out, "comment {}", Facts { voxel: scale * mesh.facts.voxel, ..mesh.facts })?;
    writeln!(out, "element vertex {}", mesh.positions.len())?;
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(out, "property float {name}")?;
    }
    for name in ["red", "green", "blue"] {
        writeln!(out, "property uchar {name}")?;
    }
    writeln!(out, "element face {}", mesh.triangles.len())?;
    out.write_all(b"property list uchar int vertex_indices\nend_header\n")?;
    for ((at, normal), colour) in mesh.positions.iter().zip(&mesh.normals).zip(&mesh.colours) {
        let at = (scale * at.as_dvec3()).as_vec3();
        for value in at.to_array().into_iter().chain(normal.to_array()) {
            out.write_all(&value.to_le_bytes())?;
        }
        out.write_all(colour)?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for vertex in triangle {
            out.write_all(&vertex.to_le_bytes())?;
        }
    }
    out.flush()
}

/// Half a turn about x, which makes y point up, as in glTF.
fn y_up(at: Vec3) -> [f32; 4] {
    [at.x, -at.y, -at.z, 0.0]
}

/// Writes a mesh as binary glTF, with y up. Viewers show its colours without a lamp.
///
/// # Errors
/// Those of the writer, and if it is larger than glTF allows.
pub fn write_gltf(mesh: &Mesh, placement: Placement, out: &mut dyn Write) -> io::Result<()> {
    let colour = |vertex: usize| {
        let [r, g, b] = mesh.colours[vertex].map(|v| srgb_to_linear(f32::from(v) / 255.0));
        [r, g, b, 1.0]
    };
    let attributes = [
        Attribute::new("POSITION", 3, |vertex| y_up(mesh.positions[vertex])),
        Attribute::new("NORMAL", 3, |vertex| y_up(mesh.normals[vertex])),
        Attribute::shares("COLOR_0", 4, colour),
    ];
    let count = mesh.positions.len();
    let mut layout = container::Layout::of(&attributes, count);
    let indices = layout.indices(mesh.triangles.as_flattened().len());
    let Facts { voxel, boundary_edges, seen, met, .. } = mesh.facts;
    let mut node = json!({ "mesh": 0, "extras": { "fled": {
        "voxel": voxel, "boundary_edges": boundary_edges, "seen": seen, "met": met
    } } });
    placement.node(&mesh.normalisation).add_to(&mut node);
    let document = json!({
        "asset": { "version": "2.0", "generator": "fled" },
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "materials": [{
            "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 },
            "doubleSided": true,
            "extensions": { "KHR_materials_unlit": {} }
        }],
        "meshes": [{ "primitives": [{
            "attributes": layout.names,
            "indices": indices,
            "material": 0
        }] }],
        "buffers": [{ "byteLength": layout.length }],
        "bufferViews": layout.views,
        "accessors": layout.accessors
    });
    container::write_header(&document, layout.length, out)?;
    container::write_attributes(&attributes, count, out)?;
    for vertex in mesh.triangles.as_flattened() {
        out.write_all(&vertex.to_le_bytes())?;
    }
    out.flush()
}
