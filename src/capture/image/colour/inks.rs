//! CMYK by the table of an ICC profile (`lut8Type`, `lut16Type`): from inks to light.
//!
//! `moxcms` reads the table and does not evaluate it, because moxcms 0.8.1 rounds inks to 8 bits
//! and cuts light at sRGB's borders in each node of a coarse grid, which shifts colours beside them
//! by up to 15 levels of 255. It is evaluated here as LittleCMS does: linearly in the first ink and
//! tetrahedrally in the others.

use glam::{DMat3, Mat3, Vec3};
use half::f16;
use moxcms::{ColorProfile, DataColorSpace, LutDataType, LutStore, LutWarehouse};

/// The white of ICC's connection space, XYZ.
const WHITE: Vec3 = Vec3::new(0.9642, 1.0, 0.8249);

/// From shares of four inks to light of sRGB's primaries, unclipped.
pub(in crate::image) struct Inks {
    /// From an ink to its place in the grid, 0..=1.
    curves: [Vec<f32>; 4],
    /// Nodes along each side of the grid.
    side: usize,
    /// The last ink changes first.
    nodes: Vec<Vec3>,
    outputs: [Vec<f32>; 3],
    /// Lab of the largest outputs, and of the smallest.
    lab: (Vec3, Vec3),
    srgb_of_xyz: Mat3,
}

impl Inks {
    /// # Errors
    /// Why the profile cannot be used.
    pub(super) fn new(profile: &ColorProfile) -> Result<Self, String> {
        if profile.pcs != DataColorSpace::Lab {
            return Err("its table does not lead to Lab".to_owned());
        }
        // ICC.1:2022, 8.10: the first table serves an intent that has none.
        let colorimetric = profile.lut_a_to_b_colorimetric.as_ref();
        match colorimetric.or(profile.lut_a_to_b_perceptual.as_ref()) {
            Some(LutWarehouse::Lut(table)) => Self::of_table(table),
            Some(LutWarehouse::Multidimensional(_)) => {
                Err("its table is a lutAToBType, which is not read for CMYK".to_owned())
            }
            None => Err("it has no table from inks to colours".to_owned()),
        }
    }

    fn of_table(table: &LutDataType) -> Result<Self, String> {
        let broken = || "its table is broken".to_owned();
        let side = usize::from(table.num_clut_grid_points);
        let inputs = usize::from(table.num_input_table_entries);
        let outputs = usize::from(table.num_output_table_entries);
        let is_of_inks = (table.num_input_channels, table.num_output_channels) == (4, 3);
        if !is_of_inks || side.min(inputs).min(outputs) < 2 {
            return Err(broken());
        }
        let nodes = values(&table.clut_table);
        if nodes.len() != 3 * side.pow(4) {
            return Err(broken());
        }
        let curves = values(&table.input_table).chunks_exact(inputs).map(<[f32]>::to_vec).collect();
        let outputs =
            values(&table.output_table).chunks_exact(outputs).map(<[f32]>::to_vec).collect();
        // 16 bits have version 2's code of Lab in later versions, too (ICC.1:2022, lut16Type).
        let lab = match table.clut_table {
            LutStore::Store8(_) => (Vec3::new(100.0, 127.0, 127.0), Vec3::new(0.0, -128.0, -128.0)),
            LutStore::Store16(_) => {
                let largest = 65_535.0 / 65_280.0;
                let largest_ab = 65_535.0 / 256.0 - 128.0;
                let top = Vec3::new(100.0 * largest, largest_ab, largest_ab);
                (top, Vec3::new(0.0, -128.0, -128.0))
            }
        };
        let xyz_of_srgb = ColorProfile::new_srgb().rgb_to_xyz_matrix();
        let xyz_of_srgb = DMat3::from_cols_array_2d(&xyz_of_srgb.v).transpose();
        Ok(Self {
            curves: Vec::try_into(curves).map_err(|_| broken())?,
            side,
            nodes: nodes.chunks_exact(3).map(Vec3::from_slice).collect(),
            outputs: Vec::try_into(outputs).map_err(|_| broken())?,
            lab,
            srgb_of_xyz: xyz_of_srgb.inverse().as_mat3(),
        })
    }

    /// Light of interleaved inks in 0..=`top`, as the bits of half floats: the precision of a
    /// prepared photograph.
    pub(in crate::image) fn halves<T: Copy + Into<f32>>(&self, inks: &[T], top: f32) -> Vec<u16> {
        let light = |inks: &[T]| {
            let light = self.light([0, 1, 2, 3].map(|ink| inks[ink].into() / top));
            light.to_array().map(|v| f16::from_f32(v).to_bits())
        };
        inks.chunks_exact(4).flat_map(light).collect()
    }

    /// Light of inks in 0..=1.
    fn light(&self, inks: [f32; 4]) -> Vec3 {
        let (mut first, mut rest) = (0, [0.0; 4]);
        for (ink, curve) in self.curves.iter().enumerate() {
            let place = between(curve, inks[ink]) * (self.side - 1) as f32;
            let node = (place as usize).min(self.side - 2);
            first += node * self.stride(ink);
            rest[ink] = place - node as f32;
        }
        let [of_first, others @ ..] = rest;
        let near = self.tetrahedral(first, others);
        let far = self.tetrahedral(first + self.stride(0), others);
        let coded = near.lerp(far, of_first).to_array();
        let share = Vec3::from([0, 1, 2].map(|c| between(&self.outputs[c], coded[c])));
        let (top, bottom) = self.lab;
        self.srgb_of_xyz * xyz(bottom + share * (top - bottom))
    }

    /// Interpolates in the last three inks.
    fn tetrahedral(&self, first: usize, rest: [f32; 3]) -> Vec3 {
        let mut inks = [0, 1, 2];
        inks.sort_by(|a: &usize, b: &usize| rest[*b].total_cmp(&rest[*a]));
        // From the nearest node to the farthest, the longest way first.
        let (mut node, mut before, mut sum) = (first, 1.0, Vec3::ZERO);
        for ink in inks {
            sum += (before - rest[ink]) * self.nodes[node];
            before = rest[ink];
            node += self.stride(ink + 1);
        }
        sum + before * self.nodes[node]
    }

    fn stride(&self, ink: usize) -> usize {
        self.side.pow(3 - ink as u32)
    }
}

/// A table's values in 0..=1.
fn values(store: &LutStore) -> Vec<f32> {
    match store {
        LutStore::Store8(values) => values.iter().map(|v| f32::from(*v) / 255.0).collect(),
        LutStore::Store16(values) => values.iter().map(|v| f32::from(*v) / 65_535.0).collect(),
    }
}

/// A curve of at least two evenly spaced values, at a place in 0..=1.
fn between(curve: &[f32], place: f32) -> f32 {
    let place = place.clamp(0.0, 1.0) * (curve.len() - 1) as f32;
    let below = (place as usize).min(curve.len() - 2);
    let (low, high) = (curve[below], curve[below + 1]);
    low + (high - low) * (place - below as f32)
}

/// Lab of D50 to XYZ (CIE 15).
fn xyz(lab: Vec3) -> Vec3 {
    let middle = (lab.x + 16.0) / 116.0;
    let roots = [middle + lab.y / 500.0, middle, middle - lab.z / 200.0];
    let knee = 6.0 / 29.0;
    let light = |root: f32| match root > knee {
        true => root.powi(3),
        false => 3.0 * knee * knee * (root - 4.0 / 29.0),
    };
    WHITE * Vec3::from(roots.map(light))
}
