// The projection of one Gaussian (EWA splatting), up to its 2-D covariance, shared by the forward
// and the backward kernels. The reference is src/core/splat/reference/projection.rs.
#import shared/camera.wgsl

const LOW_PASS: f32 = 0.3;
const DETERMINANT_GUARD: f32 = 1e-6;
const FOV_MARGIN: f32 = 0.15;
const QUAT_GUARD: f32 = 1e-8;
const LOG_SCALE_LOW: f32 = -30.0;
const LOG_SCALE_HIGH: f32 = 20.0;

// One row of `geometry`, stride 12: mean, log-scale, quaternion w x y z, opacity logit, padding.
struct Geometry {
    mean: vec3<f32>,
    log_scale: vec3<f32>,
    quat: vec4<f32>,
    logit: f32,
}

// The part that does not depend on the camera.
struct Shape {
    unit_quat: vec4<f32>,
    quat_norm: f32,
    scale: vec3<f32>,
    rotation: mat3x3<f32>,
    covariance: mat3x3<f32>,
    opacity: f32,
}

struct Projection {
    usable: bool,
    point: vec3<f32>,
    slope: vec2<f32>,
    clamped: vec2<bool>,
    to_camera: mat3x3<f32>,
    // J W with a third row of zeros.
    linear: mat3x3<f32>,
    // 2-D covariance a, b, c with the low-pass, and its determinant.
    flat: vec3<f32>,
    determinant: f32,
}

// By bits: WGSL promises nothing about comparisons with NaN.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn is_finite3(v: vec3<f32>) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

fn is_finite4(v: vec4<f32>) -> bool {
    return is_finite3(v.xyz) && is_finite(v.w);
}

fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-clamp(x, -80.0, 80.0)));
}

fn quat_to_rotation(q: vec4<f32>) -> mat3x3<f32> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return mat3x3<f32>(
        vec3<f32>(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3<f32>(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3<f32>(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}

fn geometry_usable(g: Geometry) -> bool {
    return is_finite3(g.mean) && is_finite3(g.log_scale) && is_finite4(g.quat) && is_finite(g.logit)
        && dot(g.quat, g.quat) >= QUAT_GUARD;
}

fn world_rotation(camera: CameraUniform) -> mat3x3<f32> {
    return transpose(mat3x3<f32>(camera.row_x.xyz, camera.row_y.xyz, camera.row_z.xyz));
}

// Only for a usable geometry.
fn shape_of(g: Geometry) -> Shape {
    var s: Shape;
    s.quat_norm = length(g.quat);
    s.unit_quat = g.quat / s.quat_norm;
    s.rotation = quat_to_rotation(s.unit_quat);
    s.scale = exp(clamp(g.log_scale, vec3<f32>(LOG_SCALE_LOW), vec3<f32>(LOG_SCALE_HIGH)));
    let rotated = scaled_columns(s.rotation, s.scale);
    s.covariance = rotated * transpose(rotated);
    s.opacity = sigmoid(g.logit);
    return s;
}

fn scaled_columns(m: mat3x3<f32>, s: vec3<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(m[0] * s.x, m[1] * s.y, m[2] * s.z);
}

fn project_shape(mean: vec3<f32>, shape: Shape, camera: CameraUniform) -> Projection {
    var p: Projection;
    p.usable = false;
    p.to_camera = world_rotation(camera);
    p.point = p.to_camera * mean + vec3<f32>(camera.row_x.w, camera.row_y.w, camera.row_z.w);
    if (p.point.z < camera.near) {
        return p;
    }
    let inverse = 1.0 / p.point.z;
    let size = vec2<f32>(camera.size);
    let margin = FOV_MARGIN * size / camera.focal;
    let slope = p.point.xy * inverse;
    p.slope = clamp(slope, -camera.centre / camera.focal - margin,
        (size - camera.centre) / camera.focal + margin);
    p.clamped = p.slope != slope;
    let jacobian = mat3x3<f32>(
        vec3<f32>(camera.focal.x * inverse, 0.0, 0.0),
        vec3<f32>(0.0, camera.focal.y * inverse, 0.0),
        vec3<f32>(-camera.focal * p.slope * inverse, 0.0),
    );
    p.linear = jacobian * p.to_camera;
    let projected = p.linear * shape.covariance * transpose(p.linear);
    p.flat = vec3<f32>(projected[0].x + LOW_PASS, projected[0].y, projected[1].y + LOW_PASS);
    p.determinant = p.flat.x * p.flat.z - p.flat.y * p.flat.y;
    p.usable = is_finite(p.determinant) && p.determinant > DETERMINANT_GUARD && is_finite3(p.flat);
    return p;
}
