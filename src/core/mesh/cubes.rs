//! Marching cubes (Lorensen and Cline 1987). The table of the 256 cases is computed: the surface
//! crosses each face of a cube along segments that depend only on the signs at the face's corners,
//! so neighbouring cubes agree, and the segments of a cube close to loops.

use std::collections::HashMap;

use glam::{IVec3, Vec3};

use super::grid::{Grid, SIDE, Voxel, index_of};
use super::surface::Surface;

/// Largest difference of two neighbours across the surface, of the truncation. At a surface they
/// differ by a voxel; more is the border between what is seen as free and what is hidden.
const LARGEST_STEP: f32 = 1.2;

/// A vertex keeps this share of an edge from its ends, so that no two of a cube coincide.
const MARGIN: f32 = 0.02;

/// Voxels of a block and the first ones of its neighbours, along each axis.
const WIDE: usize = SIDE as usize + 1;

/// An edge of a cube: its lower corner, and the axis along which it goes.
type Edge = (usize, usize);

/// The loops of edges for each case. A corner is a bit pattern, x first; a case has the bits of the
/// corners behind the surface.
fn table() -> Vec<Vec<Vec<Edge>>> {
    (0..256).map(loops).collect()
}

/// The loops of a case, anticlockwise as seen from before the surface.
fn loops(case: usize) -> Vec<Vec<Edge>> {
    let is_behind = |corner: usize| case >> corner & 1 == 1;
    let mut next: HashMap<Edge, Edge> = HashMap::new();
    for axis in 0..3 {
        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        for side in [0, 1 << axis] {
            // Anticlockwise as seen from outside.
            let mut corners = [0, u, u | v, v].map(|corner| corner | side);
            if side == 0 {
                corners.reverse();
            }
            let edge = |i: usize| edge_between(corners[i % 4], corners[(i + 1) % 4]);
            let behind = |i: usize| is_behind(corners[i % 4]);
            for entry in (0..4).filter(|&i| !behind(i) && behind(i + 1)) {
                let exit = (entry + 1..entry + 4).find(|&i| behind(i) && !behind(i + 1));
                next.extend(exit.map(|exit| (edge(entry), edge(exit))));
            }
        }
    }
    let mut found = Vec::new();
    while let Some(&first) = next.keys().min() {
        let mut ring = Vec::new();
        let mut at = first;
        while let Some(following) = next.remove(&at) {
            ring.push(at);
            at = following;
        }
        found.push(ring);
    }
    found
}

fn edge_between(a: usize, b: usize) -> Edge {
    (a & b, (a ^ b).trailing_zeros() as usize)
}

fn corner(bits: usize) -> IVec3 {
    IVec3::new((bits & 1) as i32, (bits >> 1 & 1) as i32, (bits >> 2 & 1) as i32)
}

/// The zero of a grid.
pub(super) fn surface(grid: &Grid) -> Surface {
    let table = table();
    let mut vertices: HashMap<(IVec3, usize), u32> = HashMap::new();
    let mut surface = Surface::default();
    for &place in &grid.places {
        let voxels = with_neighbours(grid, place);
        let at = |cell: IVec3| {
            let [x, y, z] = cell.to_array().map(|value| value as usize);
            voxels[(z * WIDE + y) * WIDE + x]
        };
        for index in 0..SIDE * SIDE * SIDE {
            let cell = IVec3::new(index % SIDE, index / SIDE % SIDE, index / (SIDE * SIDE));
            let corners: [Option<Voxel>; 8] = std::array::from_fn(|bits| at(cell + corner(bits)));
            let Some(case) = case_of(&corners) else { continue };
            for ring in &table[case] {
                let ids: Vec<u32> = ring
                    .iter()
                    .map(|&(low, axis)| {
                        let from = place * SIDE + cell + corner(low);
                        let ends = [corners[low], corners[low | 1 << axis]]
                            .map(|end| end.unwrap_or(Voxel { distance: 0.0, colour: [0; 3] }));
                        *vertices
                            .entry((from, axis))
                            .or_insert_with(|| surface.push(grid.voxel, from, axis, ends))
                    })
                    .collect();
                let fan = ids.windows(2).skip(1).map(|pair| [ids[0], pair[0], pair[1]]);
                surface.triangles.extend(fan);
            }
        }
    }
    surface
}

/// The case of a cube; `None` without a surface in it, or if a corner is unknown.
fn case_of(corners: &[Option<Voxel>; 8]) -> Option<usize> {
    let mut case = 0;
    for (bits, corner) in corners.iter().enumerate() {
        if (*corner)?.distance < 0.0 {
            case |= 1 << bits;
        }
    }
    if case == 0 || case == 255 {
        return None;
    }
    let distance = |bits: usize| corners[bits].map_or(f32::NAN, |voxel| voxel.distance);
    let is_steep = |&(low, axis): &Edge| {
        let (a, b) = (distance(low), distance(low | 1 << axis));
        (a < 0.0) != (b < 0.0) && (a - b).abs() > LARGEST_STEP
    };
    let edges = (0..3).flat_map(|axis| (0..8).map(move |low| (low, axis)));
    let mut edges = edges.filter(|&(low, axis)| low >> axis & 1 == 0);
    (!edges.any(|edge| is_steep(&edge))).then_some(case)
}

/// The voxels of a block, each axis with the first one of the next block; `None` where unknown.
fn with_neighbours(grid: &Grid, place: IVec3) -> Vec<Option<Voxel>> {
    let blocks: [Option<&[Voxel]>; 8] =
        std::array::from_fn(|bits| grid.block(place + corner(bits)));
    let voxel = |index: usize| {
        let at = [index % WIDE, index / WIDE % WIDE, index / (WIDE * WIDE)];
        let bits = (0..3).filter(|&axis| at[axis] == WIDE - 1).map(|axis| 1 << axis).sum::<usize>();
        let within = IVec3::from(at.map(|value| value as i32)) % SIDE;
        let voxel = blocks[bits]?[index_of(within)];
        (!voxel.distance.is_nan()).then_some(voxel)
    };
    (0..WIDE * WIDE * WIDE).map(voxel).collect()
}

impl Surface {
    /// Adds the vertex on an edge of the grid, and says its index.
    fn push(&mut self, voxel: f32, from: IVec3, axis: usize, ends: [Voxel; 2]) -> u32 {
        let [a, b] = ends;
        let share = (a.distance / (a.distance - b.distance)).clamp(MARGIN, 1.0 - MARGIN);
        let place = from.as_vec3() + share * Vec3::AXES[axis];
        self.positions.push(place * voxel);
        let [low, high] = [a, b].map(|end| Vec3::from(end.colour.map(f32::from)));
        let colour = low.lerp(high, share).round();
        self.colours.push(colour.to_array().map(|value| value as u8));
        self.positions.len() as u32 - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_case_crosses_each_edge_that_changes_sign_once() {
        for (case, loops) in table().iter().enumerate() {
            let mut crossed: Vec<Edge> = loops.concat();
            crossed.sort_unstable();
            let is_crossing = |&(low, axis): &Edge| {
                low >> axis & 1 == 0 && (case >> low ^ case >> (low | 1 << axis)) & 1 == 1
            };
            let all = (0..8).flat_map(|low| (0..3).map(move |axis| (low, axis)));
            let wanted: Vec<Edge> = all.filter(is_crossing).collect();
            assert_eq!(crossed, wanted, "{case}");
            assert!(loops.iter().all(|ring| ring.len() >= 3), "{case}");
        }
    }

    #[test]
    fn a_loop_turns_anticlockwise_before_the_surface() {
        // The corner at 0 is behind the surface, whose normal is (1, 1, 1).
        assert_eq!(loops(1), [vec![(0, 0), (0, 1), (0, 2)]]);
    }
}
