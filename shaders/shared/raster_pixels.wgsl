// The pixels of an invocation while splats are blended over them, front to back. Needs `camera`,
// `image`, `transmittance`.
#import shared/raster.wgsl

// A negative T marks a pixel that has stopped, or lies outside the image; its magnitude stays.
var<private> t: array<vec4<f32>, QUADS>;
var<private> red: array<vec4<f32>, QUADS>;
var<private> green: array<vec4<f32>, QUADS>;
var<private> blue: array<vec4<f32>, QUADS>;

fn begin_pixels(pixel: vec2<u32>) {
    for (var q = 0u; q < QUADS; q++) {
        let inside = inside_image(pixel + vec2<u32>(4u * q, 0u), camera.size);
        t[q] = select(vec4<f32>(-1.0), vec4<f32>(1.0), inside);
    }
}

// `offset`: the centre of the first pixel minus the splat's mean.
fn blend(splat: Splat, offset: vec2<f32>) {
    let row = row_exponent(splat, offset.y);
    for (var q = 0u; q < QUADS; q++) {
        let dx = offset.x + f32(4u * q) + vec4<f32>(0.0, 1.0, 2.0, 3.0);
        let alpha = min(raw_alpha(dx, row), vec4<f32>(splat.place.w));
        let before = t[q];
        let after = before * (1.0 - alpha);
        let stop = after < vec4<f32>(TRANSMITTANCE_STOP);
        let weight = select(alpha * before, vec4<f32>(0.0), stop);
        red[q] += weight * splat.colour.x;
        green[q] += weight * splat.colour.y;
        blue[q] += weight * splat.colour.z;
        t[q] = select(after, -abs(before), stop);
    }
}

fn all_stopped() -> bool {
    var most = t[0];
    for (var q = 1u; q < QUADS; q++) {
        most = max(most, t[q]);
    }
    return !any(most > vec4<f32>(0.0));
}

fn write_pixels(pixel: vec2<u32>) {
    let plane = camera.size.x * camera.size.y;
    for (var k = 0u; k < PIXELS; k++) {
        if (pixel.x + k < camera.size.x && pixel.y < camera.size.y) {
            let i = pixel.y * camera.size.x + pixel.x + k;
            let left = abs(t[k / 4u][k % 4u]);
            image[i] = red[k / 4u][k % 4u] + left * camera.background.x;
            image[plane + i] = green[k / 4u][k % 4u] + left * camera.background.y;
            image[2u * plane + i] = blue[k / 4u][k % 4u] + left * camera.background.z;
            transmittance[i] = left;
        }
    }
}
