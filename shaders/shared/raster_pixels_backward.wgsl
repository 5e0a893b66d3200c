// The pixels of an invocation while the gradients by the splats over them are found, front to back.
// Needs `camera`, `image`, `image_gradient`.
#import shared/raster.wgsl

// T (negative once stopped), the gradient by the colour, and that gradient times the colour still
// behind.
var<private> t: array<vec4<f32>, QUADS>;
var<private> red: array<vec4<f32>, QUADS>;
var<private> green: array<vec4<f32>, QUADS>;
var<private> blue: array<vec4<f32>, QUADS>;
var<private> behind: array<vec4<f32>, QUADS>;

fn begin_pixels(pixel: vec2<u32>) {
    let plane = camera.size.x * camera.size.y;
    for (var q = 0u; q < QUADS; q++) {
        let inside = inside_image(pixel + vec2<u32>(4u * q, 0u), camera.size);
        t[q] = select(vec4<f32>(-1.0), vec4<f32>(1.0), inside);
        for (var k = 0u; k < 4u; k++) {
            let i = select(0u, pixel.y * camera.size.x + pixel.x + 4u * q + k, inside[k]);
            let g = vec3<f32>(image_gradient[i], image_gradient[plane + i],
                image_gradient[2u * plane + i]);
            let upstream = select(vec3<f32>(0.0), g, inside[k]);
            red[q][k] = upstream.x;
            green[q][k] = upstream.y;
            blue[q][k] = upstream.z;
            behind[q][k] =
                dot(upstream, vec3<f32>(image[i], image[plane + i], image[2u * plane + i]));
        }
    }
}

// Sums over the pixels: the gradient by the colour r g b, then v, v dx, v dy, v dx^2, v dx dy, v
// dy^2, where v = dL/dsigma.
// `offset`: the centre of the first pixel minus the splat's mean.
fn blend_backward(splat: Splat, offset: vec2<f32>) -> array<f32, 9> {
    let row = row_exponent(splat, offset.y);
    var by_colour = vec3<f32>(0.0);
    var v0 = 0.0;
    var v1 = 0.0;
    var v2 = 0.0;
    for (var q = 0u; q < QUADS; q++) {
        let dx = offset.x + f32(4u * q) + vec4<f32>(0.0, 1.0, 2.0, 3.0);
        let raw = raw_alpha(dx, row);
        let alpha = min(raw, vec4<f32>(splat.place.w));
        let before = t[q];
        let after = before * (1.0 - alpha);
        let stop = after < vec4<f32>(TRANSMITTANCE_STOP);
        let weight = select(alpha * before, vec4<f32>(0.0), stop);
        let along = red[q] * splat.colour.x + green[q] * splat.colour.y + blue[q] * splat.colour.z;
        let rest = behind[q] - weight * along;
        let by_alpha = before * along - rest / (1.0 - alpha);
        let v = select(-by_alpha * alpha, vec4<f32>(0.0), stop | (raw >= vec4<f32>(ALPHA_MAX)));
        behind[q] = rest;
        by_colour += vec3<f32>(dot(weight, red[q]), dot(weight, green[q]), dot(weight, blue[q]));
        v0 += dot(v, vec4<f32>(1.0));
        v1 += dot(v, dx);
        v2 += dot(v, dx * dx);
        t[q] = select(after, -abs(before), stop);
    }
    let dy = offset.y;
    return array<f32, 9>(by_colour.x, by_colour.y, by_colour.z,
        v0, v1, v0 * dy, v2, v1 * dy, v0 * dy * dy);
}
