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
export function colourful(count, [x, y, z], radius) {
  let state = 1;
  // From Numerical Recipes; gives the same scene each time.
  const random = () => (state = (1664525 * state + 1013904223) >>> 0) / 2 ** 32;
  const three = (name, range) => Object.fromEntries([0, 1, 2].map((k) => [name + k, range]));
  const ranges = {
    x: [x - radius, x + radius], y: [y - radius, y + radius], z: [z - radius, z + radius],
    opacity: [-3, 6], rot_0: [-1, 1], rot_1: [-1, 1], rot_2: [-1, 1], rot_3: [-1, 1],
    ...three("scale_", [radius / 500, radius / 12].map(Math.log)), ...three("f_dc_", [-1.5, 2]),
  };
  return ply(count, 3, (_, name) => {
    const [low, high] = ranges[name] ?? [-0.4, 0.4];
    return low + (high - low) * random();
  });
}
