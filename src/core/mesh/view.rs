//! The view of a camera: depth, colour, and how directly it faces the surface.

use glam::{DVec3, Mat3, Vec2, Vec3};

use crate::camera::Camera;
use crate::image::Image;
use crate::render::Depth;

/// Least cosine between a ray and the normal of the surface. Pixels that mix the depths of two
/// surfaces look like less; a floor needs little.
const LEAST_FACING: f32 = 0.05;

/// Distance of the neighbours whose depths show the normal, px. The depths of nearer ones differ by
/// their noise.
const NEIGHBOUR: usize = 3;

/// Depths beyond this multiple of the median of all views are left out: they are uncertain, and
/// their surfaces take most of the memory.
const FARTHEST: f32 = 4.0;

/// A pixel of a view.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pixel {
    /// Along the camera's axis; 0 without a surface.
    pub depth: f32,
    /// Cosine between the ray and the normal, of 255; 0 if the pixel is not to be fused.
    pub facing: u8,
    /// sRGB.
    pub colour: [u8; 3],
}

/// A camera with its pixels.
pub(super) struct View {
    rotation: Mat3,
    translation: Vec3,
    focal: Vec2,
    middle: Vec2,
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<Pixel>,
}

impl View {
    pub fn new(camera: &Camera, depth: &Depth, colour: &Image) -> Self {
        let k = &camera.intrinsics;
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        let pixel = |(index, depth): (usize, &Option<f32>)| Pixel {
            depth: depth.filter(|z| z.is_finite() && *z > 0.0).unwrap_or(0.0),
            facing: 0,
            colour: colour.get(index % k.width, index / k.width).map(byte),
        };
        let mut view = Self {
            rotation: camera.rotation().as_mat3(),
            translation: camera.translation().as_vec3(),
            focal: DVec3::new(k.fx, k.fy, 0.0).truncate().as_vec2(),
            middle: DVec3::new(k.cx, k.cy, 0.0).truncate().as_vec2(),
            width: k.width,
            height: k.height,
            pixels: depth.values().iter().enumerate().map(pixel).collect(),
        };
        for index in 0..view.pixels.len() {
            view.pixels[index].facing = (view.facing(index).unwrap_or(0.0) * 255.0) as u8;
        }
        view
    }

    /// A ray through the middle of a pixel, with z of 1.
    pub fn ray(&self, index: usize) -> Vec3 {
        let at = Vec2::new((index % self.width) as f32, (index / self.width) as f32) + 0.5;
        ((at - self.middle) / self.focal).extend(1.0)
    }

    /// The place in the world of a point of the camera.
    pub fn in_world(&self, point: Vec3) -> Vec3 {
        self.rotation.transpose() * (point - self.translation)
    }

    /// A point of the world as the camera has it.
    pub fn in_camera(&self, point: Vec3) -> Vec3 {
        self.rotation * point + self.translation
    }

    /// The pixel in which a point of the camera lies.
    pub fn pixel_at(&self, point: Vec3) -> Option<&Pixel> {
        let at = point.truncate() / point.z * self.focal + self.middle;
        let is_inside = at.x >= 0.0 && at.y >= 0.0;
        let (x, y) = (at.x as usize, at.y as usize);
        (is_inside && x < self.width && y < self.height).then(|| &self.pixels[y * self.width + x])
    }

    /// Whether a ball, given in the camera, may be in the picture.
    pub fn may_show(&self, centre: Vec3, radius: f32) -> bool {
        if centre.z <= radius {
            return centre.z > -radius;
        }
        let nearest = centre.z - radius;
        let at = centre.truncate() / centre.z * self.focal + self.middle;
        // Away from the axis a ball looks longer than it is wide.
        let reach =
            2.0 * radius / nearest * self.focal * (1.0 + centre.truncate().abs() / centre.z);
        let size = Vec2::new(self.width as f32, self.height as f32);
        (at + reach).cmpge(Vec2::ZERO).all() && (at - reach).cmple(size).all()
    }

    /// The columns and rows that contain a point of the camera before it.
    pub fn image_of(&self, point: Vec3) -> Vec2 {
        point.truncate() / point.z * self.focal + self.middle
    }

    /// Length of a pixel's side at depth 1.
    fn pixel(&self) -> f32 {
        1.0 / self.focal.min_element()
    }

    /// Cosine between ray and normal from the depths of four neighbours; `None` without one of
    /// them, or if it is too small.
    fn facing(&self, index: usize) -> Option<f32> {
        let (x, y) = (index % self.width, index / self.width);
        let is_inner = x >= NEIGHBOUR
            && y >= NEIGHBOUR
            && x + NEIGHBOUR < self.width
            && y + NEIGHBOUR < self.height;
        if !is_inner || self.pixels[index].depth == 0.0 {
            return None;
        }
        let point = |index: usize| {
            let depth = self.pixels[index].depth;
            (depth > 0.0).then(|| self.ray(index) * depth)
        };
        let across = point(index + NEIGHBOUR)? - point(index - NEIGHBOUR)?;
        let below = NEIGHBOUR * self.width;
        let down = point(index + below)? - point(index - below)?;
        let normal = across.cross(down).try_normalize()?;
        let facing = normal.dot(self.ray(index).normalize()).abs();
        (facing >= LEAST_FACING).then_some(facing)
    }
}

/// Length of a pixel's side at the median depth of the views, which lose their far depths; `None`
/// if nothing can be fused.
pub(super) fn without_far_depths(views: &mut [View]) -> Option<f32> {
    let fused = |view: &View| -> Vec<f32> {
        view.pixels.iter().filter(|p| p.facing > 0).map(|p| p.depth).collect()
    };
    let mut depths: Vec<f32> = views.iter().flat_map(fused).collect();
    let middle = depths.len() / 2;
    if depths.is_empty() {
        return None;
    }
    let median = *depths.select_nth_unstable_by(middle, f32::total_cmp).1;
    for view in views.iter_mut() {
        for pixel in view.pixels.iter_mut().filter(|p| p.depth > FARTHEST * median) {
            pixel.facing = 0;
        }
    }
    let mut pixels: Vec<f32> = views.iter().map(View::pixel).collect();
    pixels.sort_by(f32::total_cmp);
    Some(median * pixels[pixels.len() / 2])
}
