//! Triangles with shared vertices: which are kept, and their measures.

use std::collections::HashMap;

use glam::Vec3;
use meshopt::SimplifyOptions;

/// A piece is kept if it has this share of all triangles, and [`LEAST`].
const CRUMB: usize = 1_000;

/// Fewest triangles of a piece before simplification.
const LEAST: usize = 64;

/// Weight of a colour from black to white against the size of the surface: patterns on a wall keep
/// vertices, but shape comes first.
const COLOUR: f32 = 0.02;

/// Triangles with shared vertices, in the training world.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Surface {
    pub positions: Vec<Vec3>,
    pub colours: Vec<[u8; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// The surface without small pieces that touch no other.
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
        let least = LEAST.max(self.triangles.len() / CRUMB);
        self.triangles.retain(|triangle| sizes[&root(&mut parents, triangle[0])] >= least);
        self.compact()
    }

    /// The surface with about `most` triangles and not more, but for the rims of its holes, which
    /// need some. Vertices stay where they are.
    pub fn simplified(mut self, most: usize) -> Self {
        if self.triangles.len() > most {
            let positions: Vec<[f32; 3]> = self.positions.iter().map(Vec3::to_array).collect();
            let colours: Vec<f32> =
                self.colours.as_flattened().iter().map(|value| f32::from(*value) / 255.0).collect();
            let kept = meshopt::simplify_with_attributes_and_locks_decoder(
                self.triangles.as_flattened(),
                &positions,
                &colours,
                &[COLOUR; 3],
                3 * size_of::<f32>(),
                &vec![false; positions.len()],
                3 * most,
                f32::MAX,
                SimplifyOptions::Prune,
                None,
            );
            self.triangles = kept.as_chunks().0.to_vec();
        }
        let (positions, triangles) = (&self.positions, &mut self.triangles);
        triangles.retain(|&triangle| across(positions, triangle).length_squared() > 0.0);
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
