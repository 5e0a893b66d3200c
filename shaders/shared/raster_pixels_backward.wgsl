// The pixels of an invocation while the gradients by the splats over them are found, front to back.
// Needs `camera`, `image`, `image_gradient`.
#import shared/raster.wgsl

// T (negative once stopped), the gradient by the colour, and that gradient times the colour still
// behind.
var<private> t: vec4<f32>;
var<private> red: vec4<f32>;
var<private> green: vec4<f32>;
var<private> blue: vec4<f32>;
var<private> behind: vec4<f32>;

fn begin_pixels(pixel: vec2<u32>) {
    let plane = camera.size.x * camera.size.y;
    let inside = inside_image(pixel, camera.size);
    t = select(vec4<f32>(-1.0), vec4<f32>(1.0), inside);
    for (var k = 0u; k < PIXELS; k++) {
        let i = select(0u, pixel.y * camera.size.x + pixel.x + k, inside[k]);
        let g = vec3<f32>(image_gradient[i], image_gradient[plane + i],
            image_gradient[2u * plane + i]);
        let upstream = select(vec3<f32>(0.0), g, inside[k]);
        red[k] = upstream.x;
        green[k] = upstream.y;
        blue[k] = upstream.z;
        behind[k] = dot(upstream, vec3<f32>(image[i], image[plane + i], image[2u * plane + i]));
    }
}

// Sums over the pixels: the gradient by the colour r g b, then v, v dx, v dy, v dx^2, v dx dy, v
// dy^2, where v = dL/dsigma.
// `offset`: the centre of the first pixel minus the splat's mean.
fn blend_backward(splat: Splat, offset: vec2<f32>) -> array<f32, 9> {
    let dx = offset_of_pixels(offset);
    let dy = offset.y;
    let raw = raw_alpha(offset, splat);
    let alpha = min(raw, vec4<f32>(splat.place.w));
    let after = t * (1.0 - alpha);
    let stop = after < vec4<f32>(TRANSMITTANCE_STOP);
    let weight = select(alpha * t, vec4<f32>(0.0), stop);
    let along = red * splat.colour.x + green * splat.colour.y + blue * splat.colour.z;
    let rest = behind - weight * along;
    let by_alpha = t * along - rest / (1.0 - alpha);
    let v = select(-by_alpha * alpha, vec4<f32>(0.0), stop | (raw >= vec4<f32>(ALPHA_MAX)));
    behind = rest;
    t = select(after, -abs(t), stop);
    let v0 = dot(v, vec4<f32>(1.0));
    let v1 = dot(v, dx);
    return array<f32, 9>(dot(weight, red), dot(weight, green), dot(weight, blue),
        v0, v1, v0 * dy, dot(v, dx * dx), v1 * dy, v0 * dy * dy);
}
