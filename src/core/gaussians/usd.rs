//! Scenes as OpenUSD text: one `ParticleField3DGaussianSplat` of UsdVol, which OpenUSD has from
//! 26.03 on. Nothing is rounded: rotations are unit quaternions w x y z, scales and opacities are
//! not logarithms and logits but the numbers themselves, and the prim above has the placement, with
//! an offset that `f32` cannot represent.
//!
//! The stage's y points up, so the scene is turned by half a turn about x; the prim above has the
//! rest of the rotation.

use std::fmt::{self, Display};
use std::io::{self, Write};

use super::Gaussians;
use super::placement::{Node, Placement};
use super::ply::{Scene, in_file};

/// Standard deviations from a Gaussian's middle to the border of its extent.
const REACH: f32 = 3.0;

/// Approximate characters of a number, with what separates it from the next.
const CHARACTERS: u64 = 13;

/// Approximate size of this many Gaussians in bytes.
pub fn bytes_of(count: usize, sh_degree: u32) -> u64 {
    let harmonics = 3 * u64::from((sh_degree + 1) * (sh_degree + 1));
    // Mean, rotation, scales, opacity.
    count as u64 * (11 + harmonics) * CHARACTERS
}

/// Writes the file; Gaussians that are not [usable](Gaussians::is_usable) are left out.
///
/// # Errors
/// Those of the writer.
pub fn write_to(scene: &Scene, placement: Placement, out: &mut dyn Write) -> io::Result<()> {
    let gaussians = in_file(&scene.gaussians, &scene.normalisation).without_unusable();
    let gaussians = gaussians.turned_y_up();
    let unit = if placement.scale == 1.0 {
        "A unit of the world of the poses is called a metre.".to_owned()
    } else {
        format!("A unit of the world of the poses is {} m.", placement.scale)
    };
    write!(
        out,
        "#usda 1.0\n(\n    defaultPrim = \"Scene\"\n    doc = \"Made by fled. {unit}\"\n    \
         metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef Xform \"Scene\"\n{{\n",
    )?;
    write_node(placement.node(&scene.normalisation), out)?;
    writeln!(out, "    def ParticleField3DGaussianSplat \"Gaussians\"\n    {{")?;
    let each = 0..gaussians.len();
    if let Some(extent) = extent(&gaussians) {
        list(out, "float3[] extent", extent.into_iter().map(Tuple))?;
    }
    list(out, "point3f[] positions", gaussians.means.iter().copied().map(Tuple))?;
    let rotation = |index| Tuple(gaussians.rotation(index).map(|q| q as f32));
    list(out, "quatf[] orientations", each.clone().map(rotation))?;
    let scales = gaussians.log_scales.iter();
    list(out, "float3[] scales", scales.map(|axes| Tuple(axes.map(f32::exp))))?;
    list(out, "float[] opacities", each.map(|index| gaussians.opacity(index) as f32))?;
    writeln!(
        out,
        "        uniform int radiance:sphericalHarmonicsDegree = {}",
        gaussians.sh_degree
    )?;
    let harmonics = gaussians.sh.chunks_exact(3).map(|rgb| Tuple([rgb[0], rgb[1], rgb[2]]));
    list(out, "float3[] radiance:sphericalHarmonicsCoefficients", harmonics)?;
    writeln!(out, "    }}\n}}")?;
    out.flush()
}

/// Writes the transform of the prim above, if it is not the identity.
fn write_node(node: Node, out: &mut dyn Write) -> io::Result<()> {
    let mut operations = Vec::new();
    if node.translates() {
        let place = Tuple(node.translation.to_array());
        writeln!(out, "    double3 xformOp:translate = {place}")?;
        operations.push("\"xformOp:translate\"");
    }
    if node.rotates() {
        let [x, y, z, w] = node.rotation.to_array();
        writeln!(out, "    quatd xformOp:orient = {}", Tuple([w, x, y, z]))?;
        operations.push("\"xformOp:orient\"");
    }
    if node.scale != 1.0 {
        writeln!(out, "    double3 xformOp:scale = {}", Tuple([node.scale; 3]))?;
        operations.push("\"xformOp:scale\"");
    }
    if !operations.is_empty() {
        writeln!(out, "    uniform token[] xformOpOrder = [{}]\n", operations.join(", "))?;
    }
    Ok(())
}

/// Corners of the box around the Gaussians.
fn extent(gaussians: &Gaussians) -> Option<[[f32; 3]; 2]> {
    let reaches = gaussians.means.iter().zip(&gaussians.log_scales).map(|(mean, axes)| {
        let reach = REACH * axes.iter().copied().fold(f32::MIN, f32::max).exp();
        [mean.map(|v| v - reach), mean.map(|v| v + reach)]
    });
    reaches.reduce(|[least, greatest], [low, high]| {
        let least = std::array::from_fn(|axis| least[axis].min(low[axis]));
        [least, std::array::from_fn(|axis| greatest[axis].max(high[axis]))]
    })
}

/// Numbers in round brackets, in the fewest digits that are read as the same.
struct Tuple<T, const N: usize>([T; N]);

impl<T: Display, const N: usize> Display for Tuple<T, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = '(';
        for number in &self.0 {
            write!(f, "{separator}{number}")?;
            separator = ',';
        }
        write!(f, ")")
    }
}

/// An attribute that is a list.
fn list(
    out: &mut dyn Write,
    attribute: &str,
    values: impl Iterator<Item = impl Display>,
) -> io::Result<()> {
    write!(out, "        {attribute} = [")?;
    for (index, value) in values.enumerate() {
        let separator = if index == 0 { "" } else { ", " };
        write!(out, "{separator}{value}")?;
    }
    writeln!(out, "]")
}

#[cfg(test)]
mod tests;
