// The light of one pixel of the render an invocation.
// Reads response [256], render [3, H, W]. Writes light [H, W] (red, green, blue, unused). Dispatch:
// H W.
// light = response^-1(render), linear between knots.
#import shared/grid.wgsl
#import shared/shake.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> shake: ShakeUniform;
@group(0) @binding(1) var<storage, read> response: array<f32>;
@group(0) @binding(2) var<storage, read> render: array<f32>;
@group(0) @binding(3) var<storage, read_write> light: array<vec4<f32>>;

fn light_of(value: f32) -> f32 {
    let place = place_of(value);
    return mix(response[place.knot], response[place.knot + 1u], place.part);
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let index = flat_workgroup(workgroup, workgroups) * WIDTH + local;
    let pixels = shake.width * shake.height;
    if index >= pixels {
        return;
    }
    light[index] = vec4<f32>(
        light_of(render[index]),
        light_of(render[index + pixels]),
        light_of(render[index + 2u * pixels]),
        0.0,
    );
}
