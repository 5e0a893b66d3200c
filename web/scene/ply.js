// Reads scenes of Gaussians: PLY files in the layout that 3DGS viewers share, binary little endian.

import { AS_IT_IS, pointWithin } from "./world.js";

/** What is wrong with a scene, as a sentence. */
export class SceneError extends Error {}

/** Longest header accepted, bytes; ours have 1.5 kB. */
const LONGEST_HEADER = 64 * 1024;
const END = "end_header\n";
const SIZES = {
  char: 1, uchar: 1, int8: 1, uint8: 1, short: 2, ushort: 2, int16: 2, uint16: 2, int: 4, uint: 4,
  int32: 4, uint32: 4, float: 4, float32: 4, double: 8, float64: 8,
};
/** The limits and guards of shaders/shared/projection.wgsl. */
const LOG_SCALE = [-30, 20];
const LOGIT = 80;
const QUAT_GUARD = 1e-8;
/** Floats per Gaussian in `geometry`: mean, opacity, six of the covariance, padding. */
export const GEOMETRY = 12;

/** Floats per Gaussian in `harmonics`: R, G, B of each coefficient, padded to whole texels. */
export const harmonicsRow = (degree) => 4 * Math.ceil((3 * (degree + 1) ** 2) / 4);

/**
 * The header at the start of `bytes`: `{ start, count, stride, degree, offsets, missing }`; `null`
 * until its end has arrived. `missing` is the offset to add to x y z; `offsets` are the positions
 * of x y z, the logit, log-scales, quaternion and then R, G, B of each coefficient.
 */
export function readHeader(bytes) {
  const text = new TextDecoder("latin1").decode(bytes.subarray(0, LONGEST_HEADER));
  if (!/^ply\r?\n/.test(text.padEnd(4, "\n")) && bytes.length >= 4) {
    throw new SceneError("This is not a PLY file.");
  }
  const end = text.replaceAll("\r\n", " \n").indexOf(END);
  if (end < 0) {
    if (bytes.length >= LONGEST_HEADER) throw new SceneError("The PLY header does not end.");
    return null;
  }
  return layout(text.slice(0, end).split("\n").slice(1), end + END.length);
}

function layout(lines, start) {
  const properties = new Map();
  let [count, stride, missing] = [null, 0, [0, 0, 0]];
  for (const line of lines) {
    const [kind, ...words] = line.trim().split(/\s+/);
    if (kind === "comment" && words[0] === "fled:" && words[1] === "add") {
      missing = words.slice(2, 5).map(Number);
    }
    if (kind === "" || kind === "comment" || kind === "obj_info") continue;
    if (kind === "format" && words[0] === "binary_little_endian") continue;
    if (kind === "format") {
      throw new SceneError(`The PLY file has the format ${words[0]}, not binary_little_endian.`);
    }
    if (kind === "element" && words[0] === "vertex" && /^\d+$/.test(words[1]) && count === null) {
      count = Number(words[1]);
    } else if (kind === "property" && count !== null && SIZES[words[0]]) {
      properties.set(words[1], { at: stride, isFloat: /^float/.test(words[0]) });
      stride += SIZES[words[0]];
    } else {
      throw new SceneError(`This PLY file does not hold Gaussians: unexpected header line "${line.trim()}".`);
    }
  }
  const rest = [...properties.keys()].filter((name) => name.startsWith("f_rest_")).length;
  const degree = [0, 1, 2, 3].find((one) => 3 * ((one + 1) ** 2 - 1) === rest);
  if (degree === undefined) throw new SceneError(`The PLY file has ${rest} higher harmonics, which match no degree.`);
  const offsets = names(degree).map((name) => {
    const found = properties.get(name);
    if (found?.isFloat) return found.at;
    throw new SceneError(`This PLY file does not hold Gaussians: it has no float "${name}".`);
  });
  if (!count) throw new SceneError("The scene is empty.");
  return { start, count, stride, degree, offsets, missing };
}

/** The file's harmonics are channel-major; here the colours of each coefficient are adjacent. */
function names(degree) {
  const higher = (degree + 1) ** 2 - 1;
  const number = (name, many) => Array.from({ length: many }, (_, n) => `${name}_${n}`);
  const rest = Array.from({ length: 3 * higher }, (_, n) =>
    `f_rest_${(n % 3) * higher + Math.floor(n / 3)}`);
  const colour = [...number("f_dc", 3), ...rest];
  return ["x", "y", "z", "opacity", ...number("scale", 3), ...number("rot", 4), ...colour];
}

/**
 * Reads a scene from a body, to be drawn in `world`; `progress(bytes)` takes the bytes received.
 * @param {ReadableStream<Uint8Array>} body
 * @param {(bytes: number) => void} progress
 * @param {{ offset: number[], scale: number }} world
 */
export async function readScene(body, progress = () => {}, world = AS_IT_IS) {
  const reader = body.getReader();
  let [head, header, rows, filled, received] = [new Uint8Array(0), null, null, 0, 0];
  const take = (bytes) => {
    if (filled + bytes.length > rows.length) bytes = bytes.subarray(0, rows.length - filled);
    rows.set(bytes, filled);
    filled += bytes.length;
  };
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    received += value.length;
    if (header) {
      take(value);
    } else {
      head = joined(head, value);
      header = readHeader(head);
      if (header) {
        rows = room(header);
        take(head.subarray(header.start));
      }
    }
    progress(received);
  }
  if (!header) throw new SceneError("This is not a PLY file: it ends within its header.");
  if (filled < rows.length) {
    const missing = header.count - Math.floor(filled / header.stride);
    throw new SceneError(`The file is truncated: ${missing} of ${header.count} Gaussians are missing.`);
  }
  return unpack(rows, header, world);
}

function room({ count, stride }) {
  try {
    return new Uint8Array(count * stride);
  } catch {
    throw new SceneError(`The scene claims to have ${count} Gaussians, too many for this page.`);
  }
}

function joined(a, b) {
  const both = new Uint8Array(a.length + b.length);
  both.set(a);
  both.set(b, a.length);
  return both;
}

/**
 * `{ count, degree, geometry, harmonics }` of the rows of a file, in the layout of the renderer's
 * textures. A Gaussian with NaN is kept, without opacity.
 */
export function unpack(rows, { count, stride, degree, offsets, missing }, world) {
  const view = new DataView(rows.buffer, rows.byteOffset, rows.byteLength);
  const geometry = new Float32Array(GEOMETRY * count);
  const width = harmonicsRow(degree);
  const harmonics = new Float32Array(width * count);
  const first = 11;
  const row = new Float64Array(offsets.length);
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < row.length; k++) row[k] = view.getFloat32(i * stride + offsets[k], true);
    const norm = row[7] ** 2 + row[8] ** 2 + row[9] ** 2 + row[10] ** 2;
    if (!row.every(Number.isFinite) || norm < QUAT_GUARD) continue;
    const at = GEOMETRY * i;
    const place = [0, 1, 2].map((k) => row[k] + missing[k]);
    geometry.set(pointWithin(place, world), at);
    geometry[at + 3] = 1 / (1 + Math.exp(-Math.min(LOGIT, Math.max(-LOGIT, row[3]))));
    covariance(row, Math.sqrt(norm), world.scale, geometry, at + 4);
    harmonics.set(row.subarray(first), width * i);
  }
  return { count, degree, geometry, harmonics };
}

/** R S S^T R^T of a Gaussian: xx, xy, xz, yy, yz, zz. */
function covariance(row, norm, scale, out, at) {
  const [w, x, y, z] = [row[7] / norm, row[8] / norm, row[9] / norm, row[10] / norm];
  const variance = (k) =>
    (scale * Math.exp(Math.min(LOG_SCALE[1], Math.max(LOG_SCALE[0], row[4 + k])))) ** 2;
  const [a, b, c] = [variance(0), variance(1), variance(2)];
  const [xx, xy, xz] = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)];
  const [yx, yy, yz] = [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)];
  const [zx, zy, zz] = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
  out[at] = a * xx * xx + b * xy * xy + c * xz * xz;
  out[at + 1] = a * xx * yx + b * xy * yy + c * xz * yz;
  out[at + 2] = a * xx * zx + b * xy * zy + c * xz * zz;
  out[at + 3] = a * yx * yx + b * yy * yy + c * yz * yz;
  out[at + 4] = a * yx * zx + b * yy * zy + c * yz * zz;
  out[at + 5] = a * zx * zx + b * zy * zy + c * zz * zz;
}
