//! Triangles with shared vertices: which are kept, and their measures.

use std::collections::HashMap;

use glam::Vec3;

/// Fewest triangles of a piece, or a quarter of those of the largest one.
const LEAST: usize = 64;

/// Triangles with shared vertices, in the training world.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Surface {
    pub positions: Vec<Vec3>,
    pub colours: Vec<[u8; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// The surface without small pieces that touch no other, and without triangles of no area.
    pub fn without_crumbs(mut self) -> Self {
        let mut parents: Vec<u32> = (0..self.positions.len() as u32).collect();
        for &[a, b, c] in &self.triangles {
            for (one, other) in [(a, b), (b, c)] {
                let (one, other) = (root(&mut parents, one), root(&mut parents, other));
                parents[one.max(other) as usize] = one.min(other);
            }
        }
        let mut sizes: HashMap<u32, usize> = HashMap::new();
        for triangle in &self.triangles {
            *sizes.entry(root(&mut parents, triangle[0])).or_default() += 1;
        }
        let least = LEAST.min(sizes.values().max().map_or(0, |largest| largest / 4));
        let positions = &self.positions;
        self.triangles.retain(|&triangle| {
            let is_large = sizes[&root(&mut parents, triangle[0])] >= least;
            is_large && across(positions, triangle).length_squared() > 0.0
        });
        self.compact()
    }

    /// The surface without vertices that no triangle uses, in the order of their use.
    fn compact(self) -> Self {
        let mut places = vec![u32::MAX; self.positions.len()];
        let mut compact = Self::default();
        for triangle in &self.triangles {
            let triangle = triangle.map(|vertex| {
                let place = &mut places[vertex as usize];
                if *place == u32::MAX {
                    *place = compact.positions.len() as u32;
                    compact.positions.push(self.positions[vertex as usize]);
                    compact.colours.push(self.colours[vertex as usize]);
                }
                *place
            });
            compact.triangles.push(triangle);
        }
        compact
    }

    /// Unit normals: the mean of the triangles at a vertex by their area.
    pub fn normals(&self) -> Vec<Vec3> {
        let mut normals = vec![Vec3::ZERO; self.positions.len()];
        for &triangle in &self.triangles {
            let across = across(&self.positions, triangle);
            for vertex in triangle {
                normals[vertex as usize] += across;
            }
        }
        normals.into_iter().map(|normal| normal.normalize_or(Vec3::Z)).collect()
    }

    /// Number of edges that belong to one triangle only.
    pub fn boundary_edges(&self) -> usize {
        let mut uses: HashMap<[u32; 2], u32> = HashMap::new();
        for &[a, b, c] in &self.triangles {
            for [one, other] in [[a, b], [b, c], [c, a]] {
                *uses.entry([one.min(other), one.max(other)]).or_default() += 1;
            }
        }
        uses.values().filter(|uses| **uses == 1).count()
    }
}

/// The normal of a triangle, twice as long as its area.
fn across(positions: &[Vec3], triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
    (b - a).cross(c - a)
}

fn root(parents: &mut [u32], mut vertex: u32) -> u32 {
    while parents[vertex as usize] != vertex {
        parents[vertex as usize] = parents[parents[vertex as usize] as usize];
        vertex = parents[vertex as usize];
    }
    vertex
}
