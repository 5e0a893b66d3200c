// One shaken pixel, all channels, an invocation.
// Reads taps [2 taps] (weights of three cells and dx, those of the other three and dy), response
// [256], light [H, W]. Writes blurred [3, H, W] and factor [H, W] (derivative of blurred by the
// weighted sum of light). Dispatch: H W.
// blurred(p) = response(sum_u k_u(p) light(p - u) / sum_u k_u(p)), u over the taps with p - u
// inside the image.
#import shared/grid.wgsl
#import shared/shake.wgsl

const WIDTH: u32 = 32;

@group(0) @binding(0) var<uniform> shake: ShakeUniform;
@group(0) @binding(1) var<storage, read> taps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> response: array<f32>;
@group(0) @binding(3) var<storage, read> light: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> blurred: array<f32>;
@group(0) @binding(5) var<storage, read_write> factor: array<vec4<f32>>;

// The last knot but one whose light is not above; the first for less light than any has.
fn knot_below(light_here: f32) -> u32 {
    var low = 0u;
    var high = KNOTS - 1u;
    // Halves 255 to 1.
    for (var n = 0u; n < 8u; n++) {
        let middle = (low + high) / 2u;
        let above = response[middle] > light_here;
        high = select(high, middle, above);
        low = select(middle, low, above);
    }
    return min(low, KNOTS - 2u);
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
    let here = vec2<i32>(i32(index % shake.width), i32(index / shake.width));
    let last = vec2<i32>(i32(shake.width), i32(shake.height)) - 1;
    let cells = cells_at(here, last);
    var sum = vec3<f32>(0.0);
    var weights = 0.0;
    for (var n = 0u; n < shake.taps; n++) {
        let first = taps[2u * n];
        let second = taps[2u * n + 1u];
        let place = here - vec2<i32>(vec2<f32>(first.w, second.w));
        let held = clamp(place, vec2<i32>(0), last);
        let weight = select(0.0, weight_in(cells, first.xyz, second.xyz), all(place == held));
        let at = u32(held.y) * shake.width + u32(held.x);
        sum += weight * light[at].xyz;
        weights += weight;
    }
    let scale = select(0.0, 1.0 / weights, weights > 0.0);
    var slopes = vec4<f32>(0.0);
    for (var c = 0u; c < 3u; c++) {
        let value = sum[c] * scale;
        let knot = knot_below(value);
        let slope = 1.0 / (f32(KNOTS - 1u) * (response[knot + 1u] - response[knot]));
        blurred[index + c * pixels] = f32(knot) / f32(KNOTS - 1u)
            + slope * (value - response[knot]);
        slopes[c] = slope * scale;
    }
    factor[index] = slopes;
}
