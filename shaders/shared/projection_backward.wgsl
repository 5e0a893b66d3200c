// The backward of projection: from the gradients by mean and inverse covariance on the image to
// those by point, rotation and covariance; tests compare it with the reference. Needs `camera` and
// shared/projection.wgsl.
#import shared/projection.wgsl

// -conic G conic, embedded in 3 x 3.
fn conic_backward(p: Projection, by_conic: vec3<f32>) -> mat3x3<f32> {
    let inverse = 1.0 / p.determinant;
    let conic = mat2x2<f32>(p.flat.z * inverse, -p.flat.y * inverse, -p.flat.y * inverse,
        p.flat.x * inverse);
    let upstream = mat2x2<f32>(by_conic.x, 0.5 * by_conic.y, 0.5 * by_conic.y, by_conic.z);
    let flat = conic * upstream * conic;
    return mat3x3<f32>(vec3<f32>(-flat[0], 0.0), vec3<f32>(-flat[1], 0.0), vec3<f32>(0.0));
}

fn point_backward(p: Projection, by_mean: vec2<f32>, by_jacobian: mat3x3<f32>) -> vec3<f32> {
    let z = p.point.z;
    let by_ratio = camera.focal / (z * z);
    let by_third = by_jacobian[2].xy;
    // J[axis][2] = -f slope / z, and the slope moves with the point unless it is clamped.
    let moves = select(vec2<f32>(1.0), vec2<f32>(0.0), p.clamped);
    let by_xy = by_mean * camera.focal / z - by_third * by_ratio * moves;
    let by_z = -by_mean * by_ratio * p.point.xy
        - vec2<f32>(by_jacobian[0].x, by_jacobian[1].y) * by_ratio
        + by_third * by_ratio * p.slope * (1.0 + moves);
    return vec3<f32>(by_xy, by_z.x + by_z.y);
}

fn quat_backward(s: Shape, g: mat3x3<f32>) -> vec4<f32> {
    let w = s.unit_quat.x;
    let x = s.unit_quat.y;
    let y = s.unit_quat.z;
    let z = s.unit_quat.w;
    // g[column][row]
    let by_unit = 2.0 * vec4<f32>(
        x * (g[1].z - g[2].y) + y * (g[2].x - g[0].z) + z * (g[0].y - g[1].x),
        y * (g[1].x + g[0].y) + z * (g[2].x + g[0].z) + w * (g[1].z - g[2].y)
            - 2.0 * x * (g[1].y + g[2].z),
        x * (g[1].x + g[0].y) + z * (g[2].y + g[1].z) + w * (g[2].x - g[0].z)
            - 2.0 * y * (g[0].x + g[2].z),
        x * (g[2].x + g[0].z) + y * (g[2].y + g[1].z) + w * (g[0].y - g[1].x)
            - 2.0 * z * (g[0].x + g[1].y),
    );
    return (by_unit - s.unit_quat * dot(by_unit, s.unit_quat)) / s.quat_norm;
}
