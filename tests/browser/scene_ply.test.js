// The reader of scenes, the blending order and the camera mathematics, without a browser.

import assert from "node:assert/strict";
import { test } from "node:test";

import {
  between, dot, fitted, looked, matrixOf, neared, orbited, poseOf, risen, surroundingsOf, walked,
} from "../../web/scene/camera.js";
import { request } from "../../web/scene/picture.js";
import { pointsOf } from "../../web/scene/points.js";
import { GEOMETRY, SceneError, readHeader, readScene } from "../../web/scene/ply.js";
import { cameraWithin, matrixInWorld, worldOf } from "../../web/scene/world.js";
import { sorter } from "../../web/scene/sort.js";
import { ply } from "./ply.js";

/** The same bytes as a body that arrives in pieces. */
const body = (bytes, piece = 997) => new ReadableStream({
  start(stream) {
    for (let at = 0; at < bytes.length; at += piece) stream.enqueue(bytes.slice(at, at + piece));
    stream.close();
  },
});

const read = (bytes, piece) => readScene(body(bytes, piece));
const near = (a, b, what, by = 1e-6) => assert.ok(Math.abs(a - b) < by, `${what}: ${a}, not ${b}`);
const same = (a, b, what, by) => a.forEach((value, k) => near(value, b[k], what, by));
const plain = (i, name) => ({ rot_0: 1, x: i, y: 2, z: 3, opacity: 0 }[name] ?? 0);

test("scenes of every degree are read in pieces of any size", async () => {
  for (const degree of [0, 1, 2, 3]) {
    const bytes = ply(5, degree, (i, name, n) => (i + 1) * 0.37 - n * 0.11);
    const whole = await read(bytes, bytes.length);
    for (const piece of [1, 64, 1500]) assert.deepEqual(await read(bytes, piece), whole);
    assert.deepEqual([whole.count, whole.degree], [5, degree]);
    same([...whole.geometry.subarray(GEOMETRY, GEOMETRY + 3)], [0.74, 0.63, 0.52], "mean");
  }
});

test("colours of a coefficient are adjacent, unlike in the file", async () => {
  const value = (i, name) => (name.startsWith("f_rest_") ? Number(name.slice(7)) : plain(i, name));
  const { harmonics } = await read(ply(2, 2, value));
  // 27 numbers fill seven texels; the second Gaussian starts at the eighth.
  assert.deepEqual([...harmonics.subarray(28, 34)], [0, 0, 0, 0, 8, 16]);
  assert.deepEqual([...harmonics.subarray(34, 37)], [1, 9, 17]);
});

test("scale and rotation become a covariance, the logit an opacity", async () => {
  const turn = Math.sin(Math.PI / 4);
  const shape = { scale_0: Math.log(3), scale_1: Math.log(2), rot_0: 2 * turn, rot_3: 2 * turn,
    opacity: Math.log(3) };
  const { geometry } = await read(ply(1, 0, (_, name) => shape[name] ?? 0));
  // A quarter turn about z: the long axis is y.
  same([...geometry.subarray(3, 10)], [0.75, 4, 0, 0, 9, 0, 1], "opacity and covariance", 1e-5);
});

test("a world of any size and place is normalised for drawing but not for requests", async () => {
  const eyes = [[0, 0, -3], [1, 0, -2.8], [-1, 0.2, -2.8]];
  const [scale, offset] = [1e-3, [512345.6, 5412345.9, 310.2]];
  const far = eyes.map((eye) => camera(eye.map((value, k) => scale * value + offset[k])));
  const world = worldOf(far);
  assert.deepEqual(worldOf(eyes.map((eye) => camera(eye))), { offset: [0, 0, 0], scale: 1 });
  const drawn = far.map((one) => poseOf(cameraWithin(one, world)));
  const { radius } = surroundingsOf(far.map((one) => cameraWithin(one, world)));
  assert.ok(radius >= 1.99 && radius < 32, `radius ${radius}`);
  drawn.forEach(({ eye }, i) => {
    assert.ok(eye.every((value) => Math.abs(value) < 4 * radius), `about the origin: ${eye}`);
    same(matrixInWorld(drawn[i], world).flat(), far[i].world_to_camera.flat(), "back", 1e-8);
  });
  // The file also leaves out an offset of its own, which must not affect drawing.
  const [missing, log] = [[512344, 5412352, 312], Math.log(2 * scale)];
  const values = { x: 1.6, y: -6.1, z: -1.8, rot_0: 1, scale_0: log, scale_1: log, scale_2: log };
  const comments = ["fled: add 512344 5412352 312 to x y z for the full coordinates"];
  const bytes = ply(1, 0, (_, name) => values[name] ?? 0, 1, comments);
  const { geometry } = await readScene(body(bytes), () => {}, world);
  const place = [values.x, values.y, values.z].map((value, k) =>
    (Math.fround(value) + missing[k] - world.offset[k]) * world.scale);
  same([...geometry.subarray(0, 3)], place, "place", 1e-5);
  near(geometry[4], (2 * scale * world.scale) ** 2, "variance", 1e-4);
  const points = [0, 1, 2].map((x) => ({ position: [x * scale + offset[0], ...offset.slice(1)],
    colour: [0, 0, 0], track: 2 }));
  const sparse = pointsOf({ points }, world).geometry;
  near(sparse[GEOMETRY] - sparse[0], scale * world.scale, "points", 1e-5);
});

test("sparse points are small round Gaussians of their colour, whatever the outliers", () => {
  const point = (x, track = 2) => ({ position: [x, 1, 2], colour: [255, 128, 0], track });
  const near = [-2, -1, 0, 1, 2].map((x) => point(x));
  const { count, degree, geometry, harmonics, isGuessed } = pointsOf({ points: near });
  assert.deepEqual([count, degree, isGuessed], [5, 0, false]);
  same([...geometry.subarray(GEOMETRY, GEOMETRY + 4)], [-1, 1, 2, 0.95], "place and opacity");
  const round = [...geometry.subarray(4, 10)];
  assert.ok(round[0] > 0 && round[0] < 1e-3, `a variance of ${round[0]}`);
  same(round, [round[0], 0, 0, round[0], 0, round[0]], "round");
  same([...harmonics.subarray(0, 3)].map((v) => 0.5 + 0.2820948 * v), [1, 128 / 255, 0], "colour");
  const far = pointsOf({ points: [...near, point(1e6)] });
  assert.ok(far.geometry[4] < 5 * round[0], `one far off makes it ${far.geometry[4]}`);
  assert.equal(pointsOf({ points: [point(0, 0), point(1, 0)] }).isGuessed, true);
  assert.throws(() => pointsOf({ points: [] }), SceneError);
  assert.throws(() => pointsOf({}), SceneError);
});

test("a Gaussian with NaN has no opacity and is not drawn", async () => {
  const bad = { 1: "x", 2: "f_dc_1", 3: "rot_0" };
  const value = (i, name) => (bad[i] !== name ? plain(i, name) : i === 3 ? 0 : NaN);
  const { geometry } = await read(ply(5, 1, value));
  assert.deepEqual([...sorter(geometry)([0, 0, 1, 0], 0.01)].sort(), [0, 4]);
});

test("a file that is no scene is refused with a sentence", async () => {
  const bytes = ply(4, 1, plain);
  const text = (words) => new TextEncoder().encode(words);
  const header = (...properties) => text(["ply", "format binary_little_endian 1.0",
    "element vertex 3", ...properties.map((one) => `property ${one}`), "end_header\n"].join("\n"));
  for (const [words, wrong] of [
    ["This is not a PLY file.", text("ply of round 2")],
    ["This is not a PLY file.", text("<!doctype html><title>a page</title>")],
    ["it ends within its header", text("ply\nformat")],
    ["truncated: 1 of 4 Gaussians are missing", bytes.slice(0, -1)],
    ["not binary_little_endian", text("ply\nformat ascii 1.0\nend_header\n")],
    ['no float "opacity"', header("float x", "float y", "float z")],
    ["2 higher harmonics", header("float f_rest_0", "float f_rest_1")],
    ['header line "property list', header("list uchar int vertex_indices")],
    ["is empty", ply(0, 0, plain)],
    ["too many", ply(1, 0, plain, 1e14)],
    ["does not end", text(`ply\n${"comment x\n".repeat(10_000)}`)],
  ]) {
    await assert.rejects(read(wrong), (error) => {
      assert.ok(error instanceof SceneError, `${words}: ${error.stack}`);
      assert.ok(error.message.includes(words), error.message);
      return true;
    });
  }
  assert.equal(readHeader(text("pl")), null, "its end may still come");
});

test("sorting is farthest first, without those before the near plane, equal ones reversed", () => {
  const depths = [5, 0.02, -3, 5, 1e6, 5.0000005, 0.005, 4];
  const geometry = new Float32Array(GEOMETRY * depths.length);
  depths.forEach((z, i) => { geometry.set([0, 0, z, 0.5], GEOMETRY * i); });
  const order = sorter(geometry);
  assert.deepEqual([...order([0, 0, 1, 0], 0.01)], [4, 5, 3, 0, 7, 1]);
  assert.deepEqual([...order([0, 0, -1, 1], 0.01)], [2, 6, 1], "from the other side");
});

const camera = (eye) => ({
  name: "a", width: 200, height: 100, fx: 150, fy: 150, cx: 100, cy: 50,
  world_to_camera: [[1, 0, 0, -eye[0]], [0, 1, 0, -eye[1]], [0, 0, 1, -eye[2]], [0, 0, 0, 1]],
});
const AROUND = { centre: [0, 0, 0], radius: 2, up: [0, -1, 0] };
const START = poseOf(camera([0, 0, -2]), AROUND);

test("a photograph's pose is its camera, and back", () => {
  const rows = [[0, 0, 1, 0.5], [0, 1, 0, -2], [-1, 0, 0, 3], [0, 0, 0, 1]];
  const pose = poseOf({ world_to_camera: rows }, AROUND);
  assert.deepEqual(pose.eye, [3, 2, -0.5]);
  matrixOf(pose).forEach((row, i) => same(row, rows[i], `row ${i}`));
});

test("orbiting keeps the view on the point ahead", () => {
  near(START.distance, 2, "how far it is");
  const right = orbited(START, AROUND, Math.PI / 2, 0);
  same(right.eye, [2, 0, 0], "to the right");
  same(right.axes[2], [-1, 0, 0], "looking at it");
  const above = orbited(START, AROUND, 0, Math.PI / 4);
  assert.ok(above.eye[1] < -1.4, "up is against y");
  near(dot(above.axes[2], above.eye), -2, "looking at it");
  const steep = orbited(START, AROUND, 0, 3);
  near(Math.asin(dot(steep.axes[2], AROUND.up)), (-85 * Math.PI) / 180, "not over the pole");
  let pose = START;
  for (let i = 0; i < 5000; i++) pose = orbited(pose, AROUND, 0.01, Math.sin(i) * 0.01);
  for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) near(dot(pose.axes[i], pose.axes[j]), 0, "square");
  near(Math.hypot(...pose.eye), 2, "as far as before", 1e-4);
});

test("up is perpendicular to the cameras' level axes, and above a drone's pictures", () => {
  /** A camera in a world whose y points down, turned right by `heading` and up by `pitch`. */
  const turnedBy = (heading, pitch) => {
    const [h, p] = [heading, pitch].map((degrees) => (degrees * Math.PI) / 180);
    const y = [Math.sin(h) * Math.sin(p), Math.cos(p), Math.cos(h) * Math.sin(p)];
    const z = [Math.sin(h) * Math.cos(p), -Math.sin(p), Math.cos(h) * Math.cos(p)];
    const rows = [[Math.cos(h), 0, -Math.sin(h), 0], [...y, 0], [...z, 0], [0, 0, 0, 1]];
    return { world_to_camera: rows };
  };
  const row = [...Array(12).keys()];
  const error = (cameras) => {
    const { up } = surroundingsOf(cameras);
    return (Math.acos(Math.min(1, -up[1])) * 180) / Math.PI;
  };
  assert.ok(error(row.map((i) => turnedBy(i * 6, -40))) < 1);
  near(error(row.map(() => turnedBy(0, 3))), 3, "all look one way", 0.01);
  for (const step of [10, 15, 25, 30]) {
    near(error(row.map((i) => turnedBy(i * step, -90))), 0, `straight down, by ${step}`, 0.5);
  }
  for (const legs of [2, 3, 5]) {
    const flown = [...Array(8 * legs).keys()].map((i) => turnedBy(180 * (Math.floor(i / 8) % 2), -90));
    near(error(flown), 0, `${legs} legs`, 0.5);
  }
});

test("a view straight down, as from a drone, can look up again", () => {
  const down = orbited(START, { ...AROUND, up: [0, 0, -1] }, 0, 0);
  const raised = looked(down, { ...AROUND, up: [0, 0, -1] }, 0, 0.5);
  near(dot(raised.axes[2], START.axes[2]), Math.cos(0.5), "half a radian");
});

test("turning keeps the position, and walking follows the view", () => {
  const right = looked(START, AROUND, Math.PI / 2, 0);
  same(right.axes[2], [1, 0, 0], "looks right");
  same(right.eye, START.eye, "where one stood");
  assert.ok(looked(START, AROUND, 0, 0.5).axes[2][1] < 0, "looks up");
  same(walked(right, [0, 0, 1]).eye, [1, 0, -2], "forward");
  same(risen(right, AROUND, 1).eye, [0, -1, -2], "up");
});

test("zooming in at last passes through the point, and zooming out has a limit", () => {
  const half = neared(START, AROUND, 0.5);
  same(half.eye, [0, 0, -1], "half the way");
  near(half.distance, 1, "it is nearer");
  let pose = START;
  for (let i = 0; i < 40; i++) pose = neared(pose, AROUND, 0.5);
  assert.ok(pose.eye[2] > 1, "beyond");
  for (let i = 0; i < 40; i++) pose = neared(pose, AROUND, 2);
  assert.ok(Math.hypot(...pose.eye) < 100, "not beyond what is far");
});

test("a flight has the right ends and orthogonal axes all the way", () => {
  const there = orbited(START, AROUND, 1.2, 0.3);
  assert.equal(between(START, there, 1), there);
  same(between(START, there, 0).eye, START.eye, "the beginning");
  const { axes } = between(START, there, 0.5);
  for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) near(dot(axes[i], axes[j]), 0, "square");
});

test("the ring's centre is where the lines of sight meet", () => {
  const ring = [-60, -30, 0, 30, 60].map((degrees) => {
    const angle = (degrees * Math.PI) / 180;
    const to = orbited(START, AROUND, angle, 0);
    return { ...camera([0, 0, 0]), world_to_camera: matrixOf(to) };
  });
  const found = surroundingsOf(ring);
  same(found.centre, [0, 0, 0], "the centre", 0.05);
  same(found.up, [0, -1, 0], "up");
  near(found.radius, 2, "the radius", 0.05);
  const alone = surroundingsOf([camera([1, 2, 3])]);
  assert.ok([...alone.centre, alone.radius].every(Number.isFinite), "one photograph will do");
});

test("all of a photograph is visible on a frame of another shape, and requested from the server", () => {
  const k = fitted(camera([0, 0, 0]), 400, 400);
  assert.deepEqual(k, { width: 400, height: 400, fx: 300, fy: 300, cx: 200, cy: 200 });
  const off = fitted({ ...camera([0, 0, 0]), cx: 110 }, 400, 200);
  assert.equal(off.cx, 220);
  const large = fitted(camera([0, 0, 0]), 4096, 2048);
  const asked = request({ round: 2, isDelivered: false }, matrixOf(START), large);
  assert.deepEqual([asked.round, asked.format], [2, "png"]);
  assert.deepEqual(asked.intrinsics,
    { width: 2048, height: 1024, fx: 1536, fy: 1536, cx: 1024, cy: 512 });
  assert.equal("round" in request({ round: 2, isDelivered: true }, matrixOf(START), k), false);
});
