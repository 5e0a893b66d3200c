//! How much of what the views see is in a mesh.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::surface::Surface;
use super::view::View;

/// Distance along a ray that still counts as the same surface, of the depth: the depths of a scene
/// differ by two or three per cent from view to view.
const SAME: f32 = 0.05;

/// The share of the views' pixels with a surface, and of those whose ray meets the mesh near that
/// surface, at least within `tolerance`: a ray that passes through a hole and meets something
/// behind it does not count.
pub(super) fn of(views: &[View], surface: &Surface, tolerance: f32) -> [f64; 2] {
    let counts = views.par_iter().map(|view| counts(view, surface, tolerance));
    let counts: Vec<[usize; 3]> = counts.collect();
    let [all, seen, met] =
        [0, 1, 2].map(|part| counts.iter().map(|one| one[part]).sum::<usize>() as f64);
    [seen / all, met / all]
}

/// All pixels, those with a surface, those whose ray meets the mesh there.
fn counts(view: &View, surface: &Surface, tolerance: f32) -> [usize; 3] {
    let depths = depths(view, surface);
    let seen = view.pixels.iter().filter(|pixel| pixel.depth > 0.0).count();
    let is_met = |(index, depth): (usize, &f32)| {
        let along = view.ray(index).length();
        let wanted = view.pixels[index].depth;
        wanted > 0.0 && (depth - wanted).abs() * along <= tolerance.max(SAME * wanted * along)
    };
    let met = depths.iter().enumerate().filter(|&one| is_met(one)).count();
    [view.pixels.len(), seen, met]
}

/// Depth of the mesh at each pixel, infinite where its ray meets none of it.
fn depths(view: &View, surface: &Surface) -> Vec<f32> {
    let mut depths = vec![f32::INFINITY; view.pixels.len()];
    let points: Vec<Vec3> = surface.positions.iter().map(|&at| view.in_camera(at)).collect();
    for triangle in &surface.triangles {
        draw(view, triangle.map(|vertex| points[vertex as usize]), &mut depths);
    }
    depths
}

/// Draws a triangle, part of which may lie behind the camera. A ray is inside if it is on the same
/// side of all three planes through the camera and an edge.
fn draw(view: &View, [a, b, c]: [Vec3; 3], depths: &mut [f32]) {
    if a.z.max(b.z).max(c.z) <= 0.0 {
        return;
    }
    let size = Vec2::new(view.width as f32, view.height as f32);
    let (mut low, mut high) = (Vec2::ZERO, size);
    if a.z.min(b.z).min(c.z) > 0.0 {
        let images = [a, b, c].map(|point| view.image_of(point));
        low = images.iter().copied().fold(size, Vec2::min).floor().max(Vec2::ZERO);
        high = images.iter().copied().fold(Vec2::ZERO, Vec2::max).ceil().min(size);
    }
    let planes = [b.cross(c), c.cross(a), a.cross(b)];
    let volume = a.dot(planes[0]);
    for row in low.y as usize..high.y as usize {
        for column in low.x as usize..high.x as usize {
            let index = row * view.width + column;
            let ray = view.ray(index);
            let sides = planes.map(|plane| plane.dot(ray) * volume.signum());
            let sum: f32 = sides.iter().sum();
            if sum > 0.0 && sides.iter().all(|side| *side >= 0.0) {
                depths[index] = depths[index].min(volume.abs() / sum);
            }
        }
    }
}
