// Random numbers as a pure function of (seed, step, id): the same on every run, whatever the
// order of the invocations.

// Mark Jarzynski and Marc Olano, "Hash Functions for GPU Rendering", 2020: pcg4d.
fn hash4(key: vec4<u32>) -> vec4<u32> {
    var v = key * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> vec4<u32>(16u);
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// Four numbers in (0, 1).
fn uniform4(seed: u32, step: u32, id: u32) -> vec4<f32> {
    return (vec4<f32>(hash4(vec4<u32>(seed, step, id, 0x9e3779b9u)) >> vec4<u32>(8u)) + 0.5)
        / 16777216.0;
}

// Three independent standard normal numbers (Box and Muller).
fn normal3(seed: u32, step: u32, id: u32) -> vec3<f32> {
    let u = uniform4(seed, step, id);
    let radius = sqrt(-2.0 * log(u.xz));
    let angle = 6.28318531 * u.yw;
    return vec3<f32>(radius.x * cos(angle.x), radius.x * sin(angle.x), radius.y * cos(angle.y));
}
