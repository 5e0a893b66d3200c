// The derivative of the loss by one pixel of the render, all channels, an invocation.
// Reads taps [2 taps], response [256], scaled [H, W] (derivative by the weighted sums), render
// [3, H, W]. Writes render_gradient [3, H, W]. Dispatch: H W.
// dL/drender(q) = (f^-1)'(render(q)) sum_u k_u(q + u) scaled(q + u)
//     + w sum_n d_n / sqrt(d_n^2 + BEND^2),
// u over the taps with q + u inside, d_n the differences to the neighbours of q, f the response.
#import shared/grid.wgsl
#import shared/shake.wgsl

const WIDTH: u32 = 32;
const BEND: f32 = 0.02;

@group(0) @binding(0) var<uniform> shake: ShakeUniform;
@group(0) @binding(1) var<storage, read> taps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> response: array<f32>;
@group(0) @binding(3) var<storage, read> scaled: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> render: array<f32>;
@group(0) @binding(5) var<storage, read_write> render_gradient: array<f32>;

// The derivative of the sum over neighbours of sqrt(d^2 + e^2) by one value.
fn roughness(at: u32, here: vec2<i32>, last: vec2<i32>) -> f32 {
    let value = render[at];
    var sum = 0.0;
    if here.x > 0 { sum += bent(value - render[at - 1u]); }
    if here.x < last.x { sum += bent(value - render[at + 1u]); }
    if here.y > 0 { sum += bent(value - render[at - shake.width]); }
    if here.y < last.y { sum += bent(value - render[at + shake.width]); }
    return sum;
}

fn bent(d: f32) -> f32 {
    return d / sqrt(d * d + BEND * BEND);
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
    var sum = vec3<f32>(0.0);
    for (var n = 0u; n < shake.taps; n++) {
        let first = taps[2u * n];
        let second = taps[2u * n + 1u];
        let place = here + vec2<i32>(vec2<f32>(first.w, second.w));
        let held = clamp(place, vec2<i32>(0), last);
        let there = weight_in(cells_at(held, last), first.xyz, second.xyz);
        let weight = select(0.0, there, all(place == held));
        let at = u32(held.y) * shake.width + u32(held.x);
        sum += weight * scaled[at].xyz;
    }
    for (var c = 0u; c < 3u; c++) {
        let at = index + c * pixels;
        let knot = place_of(render[at]).knot;
        render_gradient[at] = f32(KNOTS - 1u) * (response[knot + 1u] - response[knot]) * sum[c]
            + shake.smooth_weight * roughness(at, here, last);
    }
}
