// The surface that a ray meets, and crops, without a browser.

import assert from "node:assert/strict";
import { test } from "node:test";

import { rayOf, surroundingsOf, unit } from "../../web/scene/camera.js";
import {
  contains, cropWithin, firstCrop, outline, reshaped, roundedPoint,
} from "../../web/scene/crop.js";
import { cropText } from "../../web/lib/shaping.js";
import { readScene } from "../../web/scene/ply.js";
import { surfaceAt } from "../../web/scene/surface.js";
import { walled } from "./ply.js";

const read = async (bytes) => (await readScene(new Blob([bytes]).stream())).geometry;
const RAY = { eye: [0.2, -0.1, -4], direction: [0, 0, 1], pixel: 1 / 800, near: 0.01 };
const near = (a, b, by, what) => assert.ok(Math.abs(a - b) < by, `${what}: ${a}, not ${b}`);

/** Rows of round Gaussians: x, y, z, opacity, standard deviation. */
function balls(...rows) {
  const geometry = new Float32Array(12 * rows.length);
  rows.forEach(([x, y, z, opacity, deviation], i) => {
    const variance = deviation ** 2;
    geometry.set([x, y, z, opacity, variance, 0, 0, variance, 0, variance], 12 * i);
  });
  return geometry;
}

test("rays of all directions meet a slanted wall where it is, whatever is behind", async () => {
  const [centre, normal] = [[0.3, -0.2, 5], unit([0.5, -0.3, 1])];
  const geometry = await read(walled(centre, normal, 2));
  const k = { fx: 800, fy: 800, cx: 400, cy: 300 };
  const pose = { axes: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], eye: [0.1, 0.2, -1] };
  for (const pixel of [[400, 300], [280, 350], [501.5, 212.25], [333, 410]]) {
    const ray = { ...rayOf(pose, k, pixel), near: 0.01 };
    const point = surfaceAt(geometry, ray);
    assert.ok(point, `nothing at ${pixel}`);
    const off = point.reduce((sum, value, i) => sum + (value - centre[i]) * normal[i], 0);
    near(off, 0, 0.005, `from the wall at ${pixel}`);
    const [x, y, z] = point.map((value, i) => value - pose.eye[i]);
    near((k.fx * x) / z + k.cx, pixel[0], 1e-6, "x of its pixel");
    near((k.fy * y) / z + k.cy, pixel[1], 1e-6, "y of its pixel");
  }
});

test("the surface is where half of the light is left", () => {
  const thin = [0.2, -0.1, 1, 0.3, 0.05];
  const solid = [0.2, -0.1, 3, 0.95, 0.05];
  near(surfaceAt(balls(solid, thin), RAY)[2], 3, 1e-6, "behind what lets most through");
  near(surfaceAt(balls(solid, [0.2, -0.1, 2, 0.3, 0.05], thin), RAY)[2], 2, 1e-6, "two of these");
  assert.equal(surfaceAt(balls(thin), RAY), null, "half is left at the end");
  assert.equal(surfaceAt(balls([0.2, -0.1, -6, 0.95, 0.05]), RAY), null, "behind the eye");
  assert.equal(surfaceAt(balls([1.2, -0.1, 3, 0.95, 0.05]), RAY), null, "beside the ray");
  assert.equal(surfaceAt(balls([NaN, 0, 3, 0.95, 0.05], [0.2, -0.1, 2, 0, 0.05]), RAY), null);
  // Its middle is beside the ray, which passes its thickest part before that.
  const long = balls([0.2, -0.1, 3, 0.95, 1]);
  long.set([1, 0, 0.9, 1, 0, 0.82], 4);
  const slanted = surfaceAt(long, { ...RAY, eye: [-0.3, -0.1, -4] });
  near(slanted[2], 3 - 0.5 * 0.9, 0.02, "along a slanted one");
});

test("what is outside a crop is not met", () => {
  const geometry = balls([0.2, -0.1, 1, 0.95, 0.05], [0.2, -0.1, 3, 0.95, 0.05]);
  const crop = { isBox: false, centre: [0, 0, 3], half: [1, 1, 1] };
  near(surfaceAt(geometry, { ...RAY, crop })[2], 3, 1e-6, "the one inside");
  near(surfaceAt(geometry, RAY)[2], 1, 1e-6, "the nearer one");
});

const WORLD = { offset: [512_352, -5_412_352, 64], scale: 0.0625 };

test("a crop is drawn where the world of the poses has it", () => {
  const box = { shape: "box", centre: [512_368, -5_412_320, 112], size: [32, 64, 16] };
  const drawn = cropWithin(box, WORLD);
  assert.deepEqual(drawn, { isBox: true, centre: [1, 2, 3], half: [1, 2, 0.5] });
  for (const [point, isInside] of [[[1, 2, 3], true], [[2, 4, 3.5], true], [[2.1, 2, 3], false],
    [[1, 4.1, 3], false], [[1, 2, 2.4], false], [[NaN, 2, 3], false]]) {
    assert.equal(contains(drawn, ...point), isInside, String(point));
  }
  assert.equal(cropText(box), "box:512368,-5412320,112,32,64,16");
  const ball = cropWithin({ shape: "sphere", centre: box.centre, size: [32] }, WORLD);
  assert.deepEqual(ball, { isBox: false, centre: [1, 2, 3], half: [2, 2, 2] });
  assert.ok(contains(ball, 2, 3, 4) && !contains(ball, 2.2, 3.2, 4.2));
  for (const edges of [outline(drawn), outline(ball)]) {
    for (const point of edges.flat()) {
      const { centre } = drawn;
      const grown = (by) => point.map((value, k) => centre[k] + by * (value - centre[k]));
      const crop = edges.length === 12 ? drawn : ball;
      assert.ok(contains(crop, ...grown(0.999)), "within its border");
      assert.ok(!contains(crop, ...grown(1.001)), "beyond its border");
    }
  }
});

test("the first crop is around what the cameras look at, with numbers that can be read", () => {
  const camera = (eye, axes) => ({ width: 200, height: 100, fx: 150, fy: 150, cx: 100, cy: 50,
    world_to_camera: [...axes.map((axis) =>
      [...axis, -axis.reduce((sum, value, k) => sum + value * eye[k], 0)]), [0, 0, 0, 1]] });
  const cameras = [camera([0, 0, -2], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    camera([-2, 0, 0], [[0, 0, -1], [0, 1, 0], [1, 0, 0]])];
  const crop = firstCrop(surroundingsOf(cameras), WORLD);
  assert.equal(crop.shape, "sphere");
  near(crop.size[0], 16, 0.1, "half the ring of 2 / 0.0625");
  [512_352, -5_412_352, 64].forEach((value, k) => near(crop.centre[k], value, 0.1, "its middle"));
  const text = /^sphere:5123\d\d(\.\d)?,-54123\d\d(\.\d)?,6\d(\.\d)?,1[56](\.\d)?$/;
  assert.match(cropText(crop), text);
  assert.deepEqual(reshaped(crop, "box").size, Array(3).fill(2 * crop.size[0]));
  assert.deepEqual(reshaped(reshaped(crop, "box"), "sphere"), crop);
  assert.deepEqual(roundedPoint([1.23456, -0.0004, 1000], 0.5), [1.235, -0, 1000]);
});
