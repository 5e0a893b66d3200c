// The camera of one view, for every kernel that projects or tiles.
// 128 bytes; the Rust side is `CameraUniform` in src/core/splat/uniform.rs.

const TILE: u32 = 16u;

struct CameraUniform {
    // Rows of the rigid transform from world to camera (OpenCV axes), [3, 4].
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_z: vec4<f32>,
    // Focal lengths and principal point, px.
    focal: vec2<f32>,
    centre: vec2<f32>,
    // Image size, px, and its size in tiles of 16 x 16, rounded up.
    size: vec2<u32>,
    tiles: vec2<u32>,
    // Centre of projection, world units.
    position: vec3<f32>,
    // Active degree of the spherical harmonics.
    sh_degree: u32,
    // Colour of the background, seen where the splats are transparent.
    background: vec3<f32>,
    // Number of Gaussians.
    count: u32,
    // Splats nearer than this are culled, world units.
    near: f32,
    // Vectors in a row of harmonics of the allocated degree.
    sh_row: u32,
}
