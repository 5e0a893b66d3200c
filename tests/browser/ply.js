// Synthetic scenes for tests.

const FIXED = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
const LAST = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];

/** The bytes of a scene with `comments`; number n of Gaussian i is `value(i, name, n)`. */
export function ply(count, degree, value, announced = count, comments = []) {
  const rest = Array.from({ length: 3 * ((degree + 1) ** 2 - 1) }, (_, n) => `f_rest_${n}`);
  const names = [...FIXED, ...rest, ...LAST];
  const lines = ["ply", "format binary_little_endian 1.0",
    ...comments.map((words) => `comment ${words}`), `element vertex ${announced}`,
    ...names.map((name) => `property float ${name}`), "end_header", ""];
  const head = new TextEncoder().encode(lines.join("\n"));
  const bytes = new Uint8Array(head.length + 4 * names.length * count);
  bytes.set(head);
  const view = new DataView(bytes.buffer, head.length);
  for (let i = 0; i < count; i++) {
    names.forEach((name, n) => {
      view.setFloat32(4 * (i * names.length + n), value(i, name, n), true);
    });
  }
  return bytes;
}

/**
 * `count` Gaussians in a ball of `radius` around `centre`, long and thin, with strongly
 * direction-dependent colours: like a trained scene, unlike the small ones of tests.
 */
export function colourful(count, centre, radius) {
  const number = numbers(centre, radius);
  return ply(count, 3, (_, name) => number(name));
}

/** The numbers of such Gaussians, one after the other. */
function numbers([x, y, z], radius) {
  let state = 1;
  // From Numerical Recipes; gives the same scene each time.
  const random = () => (state = (1664525 * state + 1013904223) >>> 0) / 2 ** 32;
  const three = (name, range) => Object.fromEntries([0, 1, 2].map((k) => [name + k, range]));
  const ranges = {
    x: [x - radius, x + radius], y: [y - radius, y + radius], z: [z - radius, z + radius],
    opacity: [-3, 6], rot_0: [-1, 1], rot_1: [-1, 1], rot_2: [-1, 1], rot_3: [-1, 1],
    ...three("scale_", [radius / 500, radius / 12].map(Math.log)), ...three("f_dc_", [-1.5, 2]),
  };
  return (name) => {
    const [low, high] = ranges[name] ?? [-0.4, 0.4];
    return low + (high - low) * random();
  };
}

/**
 * A wall through `centre`, opaque, flat and as wide as four times `radius`, with the unit vector
 * `normal`, which must not be against z, and behind it 2000 Gaussians as in `colourful`.
 */
export function walled(centre, normal, radius) {
  const across = [[1, 0, 0], [0, 1, 0]].map((axis) => {
    // From z to the normal, by the shortest turn.
    const [x, y, z] = normal;
    const [a, b] = axis;
    const turn = (x * a + y * b) / (1 + z);
    return [a - x * turn, b - y * turn, -(x * a + y * b)];
  });
  const [side, step] = [80, radius / 20];
  const thin = { scale_0: Math.log(0.6 * step), scale_1: Math.log(0.6 * step),
    scale_2: Math.log(radius / 2000), rot_0: 1 + normal[2], rot_1: -normal[1], rot_2: normal[0],
    rot_3: 0, opacity: 4 };
  const behind = [0, 1, 2].map((k) => centre[k] + 1.2 * radius * normal[k]);
  const inner = numbers(behind, radius / 2);
  return ply(side * side + 2000, 3, (i, name) => {
    if (i >= side * side) return inner(name);
    const at = [(i % side) - (side - 1) / 2, Math.floor(i / side) - (side - 1) / 2];
    const axis = ["x", "y", "z"].indexOf(name);
    if (axis >= 0) return centre[axis] + step * (at[0] * across[0][axis] + at[1] * across[1][axis]);
    if (name.startsWith("f_dc_")) return Math.sin(i * 0.7 + Number(name.slice(5)));
    return thin[name] ?? 0;
  });
}
