// Finds the surface under a pixel.

import { contains } from "./crop.js";
import { GEOMETRY } from "./ply.js";

/** As in shaders/shared/: the blur of a pixel, px², the least and the largest alpha. */
const LOW_PASS = 0.3;
const ALPHA_CUT = 1 / 255;
const ALPHA_MAX = 0.99;
/** Share of the light that is left at the surface. */
const HALF = 0.5;

/**
 * The point at which less than half of a ray's light is left, from the Gaussians in the order in
 * which the ray passes their greatest densities; `null` if more is left at the end. `eye` and the
 * unit vector `direction` are as drawn, `pixel` is the angle of a pixel in radians; Gaussians
 * nearer than `near` or outside the drawn `crop`, if any, are left out.
 */
export function surfaceAt(geometry, { eye, direction, pixel, near, crop = null }) {
  const hits = [];
  const [dx, dy, dz] = direction;
  for (let at = 0; at < geometry.length; at += GEOMETRY) {
    const [x, y, z] = [geometry[at] - eye[0], geometry[at + 1] - eye[1], geometry[at + 2] - eye[2]];
    const ahead = x * dx + y * dy + z * dz;
    const opacity = geometry[at + 3];
    if (!(opacity > ALPHA_CUT) || !(ahead > near)) continue;
    const limit = 2 * Math.log(opacity / ALPHA_CUT);
    const blur = LOW_PASS * (pixel * ahead) ** 2;
    // No variance is larger than their sum.
    const most = geometry[at + 4] + geometry[at + 7] + geometry[at + 9] + blur;
    if (x * x + y * y + z * z - ahead * ahead > limit * most) continue;
    if (crop && !contains(crop, geometry[at], geometry[at + 1], geometry[at + 2])) continue;
    const met = passed(geometry, at, [x, y, z], direction, blur);
    if (!met || !(met.distance > near)) continue;
    const alpha = Math.min(opacity * Math.exp(-met.away / 2), ALPHA_MAX);
    if (alpha >= ALPHA_CUT) hits.push({ distance: met.distance, alpha });
  }
  hits.sort((a, b) => a.distance - b.distance);
  let left = 1;
  for (const { distance, alpha } of hits) {
    left *= 1 - alpha;
    if (left < HALF) return eye.map((value, k) => value + distance * direction[k]);
  }
  return null;
}

/**
 * Where a ray passes the greatest density of a Gaussian with `blur` added to its variances:
 * `{ distance, away }`, in which `away` is the squared Mahalanobis distance there; `null` if it has
 * no density.
 */
function passed(geometry, at, [x, y, z], [dx, dy, dz], blur) {
  const [a, b, c] = [geometry[at + 4] + blur, geometry[at + 5], geometry[at + 6]];
  const [d, e, f] = [geometry[at + 7] + blur, geometry[at + 8], geometry[at + 9] + blur];
  // The adjugate of the covariance: its inverse times its determinant.
  const [xx, xy, xz] = [d * f - e * e, c * e - b * f, b * e - c * d];
  const [yy, yz, zz] = [a * f - c * c, b * c - a * e, a * d - b * b];
  const determinant = a * xx + b * xy + c * xz;
  if (!(determinant > 0)) return null;
  const [u, v, w] = [xx * dx + xy * dy + xz * dz, xy * dx + yy * dy + yz * dz,
    xz * dx + yz * dy + zz * dz];
  const distance = (u * x + v * y + w * z) / (u * dx + v * dy + w * dz);
  const [p, q, r] = [x - distance * dx, y - distance * dy, z - distance * dz];
  const away = (p * (xx * p + xy * q + xz * r) + q * (xy * p + yy * q + yz * r)
    + r * (xz * p + yz * q + zz * r)) / determinant;
  return { distance, away };
}
