// The formulas of shaders/ for WebGL 2; a browser test compares them with the server's pictures.
// One instance per Gaussian: a quad of four vertices around it.

const HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\n";

/** From shaders/shared/harmonics.wgsl, gaussian_rows.wgsl, projection.wgsl and tiles.wgsl. */
export const projecting = (degree) => `${HEAD}
#define DEGREE ${degree}
precision highp sampler2D;
uniform sampler2D geometry;
uniform sampler2D harmonics;
// Gaussians in a row of each texture.
uniform ivec2 in_row;
// World to camera, its rows, and where the camera stands.
uniform vec4 row_x, row_y, row_z;
uniform vec3 position;
uniform vec2 focal, centre, size;
// Only Gaussians with their centres inside are drawn: 0 everywhere, 1 in a sphere, 2 in a box.
uniform int crop_shape;
uniform vec3 crop_centre, crop_half;
in uint index;
// Where a corner lies in the Gaussian's own unit, and how it is coloured.
out vec2 offset;
flat out vec4 splat;

const float LOW_PASS = 0.3;
const float DETERMINANT_GUARD = 1e-6;
const float FOV_MARGIN = 0.15;

vec4 texel(sampler2D rows, int per_row, int width, int k) {
  int i = int(index);
  return texelFetch(rows, ivec2((i % per_row) * width + k, i / per_row), 0);
}

const int WIDTH = ${(3 * (degree + 1) ** 2 + 3) >> 2};

// The colours of four coefficients that lie one after the other.
vec3 four(int k, vec4 basis) {
  vec4 a = texel(harmonics, in_row.y, WIDTH, k);
  vec4 b = k + 1 < WIDTH ? texel(harmonics, in_row.y, WIDTH, k + 1) : vec4(0.0);
  vec4 c = k + 2 < WIDTH ? texel(harmonics, in_row.y, WIDTH, k + 2) : vec4(0.0);
  return mat4x3(a.xyz, vec3(a.w, b.xy), vec3(b.zw, c.x), c.yzw) * basis;
}

vec3 colour(vec3 d) {
  float x = d.x, y = d.y, z = d.z;
  vec3 s = d * d;
#if DEGREE == 0
  return vec3(0.5) + four(0, vec4(0.28209479, 0.0, 0.0, 0.0));
#else
  vec3 sum = vec3(0.5)
    + four(0, vec4(0.28209479, 0.48860251 * vec3(-y, z, -x)));
#if DEGREE >= 2
  float e = DEGREE >= 3 ? 1.0 : 0.0;
  sum += four(3, vec4(1.09254843 * x * y, -1.09254843 * y * z,
    0.31539157 * (2.0 * s.z - s.x - s.y), -1.09254843 * x * z));
  sum += four(6, vec4(0.54627422 * (s.x - s.y), -e * 0.59004359 * y * (3.0 * s.x - s.y),
    e * 2.89061144 * x * y * z, -e * 0.45704580 * y * (4.0 * s.z - s.x - s.y)));
#endif
#if DEGREE >= 3
  sum += four(9, vec4(0.37317633 * z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y),
    -0.45704580 * x * (4.0 * s.z - s.x - s.y), 1.44530572 * z * (s.x - s.y),
    -0.59004359 * x * (s.x - 3.0 * s.y)));
#endif
  return sum;
#endif
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  vec4 a = texel(geometry, in_row.x, 3, 0);
  vec4 b = texel(geometry, in_row.x, 3, 1);
  vec4 c = texel(geometry, in_row.x, 3, 2);
  vec3 mean = a.xyz;
  vec3 away = abs(mean - crop_centre) / crop_half;
  if (crop_shape == 1 && !(dot(away, away) <= 1.0)) return;
  if (crop_shape == 2 && !all(lessThanEqual(away, vec3(1.0)))) return;
  mat3 sigma = mat3(b.x, b.y, b.z, b.y, b.w, c.x, b.z, c.x, c.y);
  vec3 point = vec3(dot(row_x.xyz, mean) + row_x.w, dot(row_y.xyz, mean) + row_y.w,
    dot(row_z.xyz, mean) + row_z.w);
  // The exponent at which alpha falls to 1/255.
  float limit = log(max(a.w, 1e-12) * 255.0);
  if (limit < 0.0) return;
  vec2 margin = FOV_MARGIN * size / focal;
  vec2 slope = clamp(point.xy / point.z, -centre / focal - margin,
    (size - centre) / focal + margin);
  // The rows of J W.
  vec3 u = focal.x / point.z * (row_x.xyz - slope.x * row_z.xyz);
  vec3 v = focal.y / point.z * (row_y.xyz - slope.y * row_z.xyz);
  vec3 flat_ = vec3(dot(u, sigma * u) + LOW_PASS, dot(u, sigma * v), dot(v, sigma * v) + LOW_PASS);
  float determinant = flat_.x * flat_.z - flat_.y * flat_.y;
  if (!(determinant > DETERMINANT_GUARD)) return;
  // The axes of the ellipse: half the lengths of the quad, px.
  float spread = length(vec2(0.5 * (flat_.x - flat_.z), flat_.y));
  float larger = 0.5 * (flat_.x + flat_.z) + spread;
  vec2 axis = flat_.x >= flat_.z ? vec2(larger - flat_.z, flat_.y)
    : vec2(flat_.y, larger - flat_.x);
  axis = spread > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  offset = corner * sqrt(2.0 * limit);
  vec2 pixel = focal * point.xy / point.z + centre + axis * (offset.x * sqrt(larger))
    + vec2(-axis.y, axis.x) * (offset.y * sqrt(determinant / larger));
  vec3 towards = mean - position;
  splat = vec4(max(colour(towards / max(length(towards), 1e-12)), vec3(0.0)), a.w);
  gl_Position = vec4(pixel / size * vec2(2.0, -2.0) + vec2(-1.0, 1.0), 0.0, 1.0);
}`;

/** From shaders/shared/raster.wgsl; premultiplied, blended over the background. */
export const BLENDING = `${HEAD}
in vec2 offset;
flat in vec4 splat;
out vec4 pixel;

const float ALPHA_CUT = 1.0 / 255.0;
const float ALPHA_MAX = 0.99;

void main() {
  float raw = splat.a * exp(-0.5 * dot(offset, offset));
  if (raw < ALPHA_CUT) discard;
  float alpha = min(raw, min(ALPHA_MAX, splat.a));
  pixel = vec4(splat.rgb * alpha, alpha);
}`;

/** One triangle over everything. */
export const COVERING = `${HEAD}
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;

/** From blended half floats to the screen. */
export const SHOWING = `${HEAD}
uniform sampler2D image;
uniform vec2 size;
// Of light; 1 leaves every value as it is.
uniform float gain;
out vec4 pixel;
vec3 light(vec3 value) {
  return mix(value / 12.92, pow((value + 0.055) / 1.055, vec3(2.4)), step(0.04045, value));
}
vec3 encoded(vec3 light) {
  return mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, light));
}
void main() {
  vec3 shown = max(texture(image, gl_FragCoord.xy / size).rgb, 0.0);
  if (gain != 1.0) shown = encoded(gain * light(shown));
  pixel = vec4(min(shown, 1.0), 1.0);
}`;
