// The pixels of an invocation while splats are blended over them, front to back. Needs `camera`,
// `image`, `transmittance`.
#import shared/raster.wgsl

// A negative T marks a pixel that has stopped, or lies outside the image; its magnitude stays.
var<private> t: vec4<f32>;
var<private> red: vec4<f32>;
var<private> green: vec4<f32>;
var<private> blue: vec4<f32>;

fn begin_pixels(pixel: vec2<u32>) {
    t = select(vec4<f32>(-1.0), vec4<f32>(1.0), inside_image(pixel, camera.size));
}

// `offset`: the centre of the first pixel minus the splat's mean.
fn blend(splat: Splat, offset: vec2<f32>) {
    let alpha = min(raw_alpha(offset, splat), vec4<f32>(splat.place.w));
    let after = t * (1.0 - alpha);
    let stop = after < vec4<f32>(TRANSMITTANCE_STOP);
    let weight = select(alpha * t, vec4<f32>(0.0), stop);
    red += weight * splat.colour.x;
    green += weight * splat.colour.y;
    blue += weight * splat.colour.z;
    t = select(after, -abs(t), stop);
}

fn all_stopped() -> bool {
    return !any(t > vec4<f32>(0.0));
}

fn write_pixels(pixel: vec2<u32>) {
    let plane = camera.size.x * camera.size.y;
    let inside = inside_image(pixel, camera.size);
    for (var k = 0u; k < PIXELS; k++) {
        if (inside[k]) {
            let i = pixel.y * camera.size.x + pixel.x + k;
            let left = abs(t[k]);
            image[i] = red[k] + left * camera.background.x;
            image[plane + i] = green[k] + left * camera.background.y;
            image[2u * plane + i] = blue[k] + left * camera.background.z;
            transmittance[i] = left;
        }
    }
}
