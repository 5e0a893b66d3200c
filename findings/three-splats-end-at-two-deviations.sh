#!/usr/bin/env bash
# three.js 0.187.0 draws Gaussian splats otherwise than the programs that train them: a splat ends at two standard
# deviations, and a splat smaller than a pixel keeps its light, not its opacity.
#
# 3D Gaussian splatting blends a splat down to an alpha of 1/255 (3.3 standard deviations at opacity 1) and adds 0.3 px^2
# to its area without a change of opacity. three.js' GaussianSplat, which draws glTF's KHR_gaussian_splatting, cuts where
# the alpha is still 13.5 % of the opacity, which leaves a rim of 34 levels of 255 and more. It also multiplies the
# opacity by the root of the area before over the area after, as Mip-Splatting does for scenes that were trained so.
# Neither is an option, and a scene trained as published is darker where it is fine: a made-up room is 26 dB from its
# published picture.
# Below is one white splat of opacity 1 on black, at a focal length of 100 px, first 10 and then 0.25 px wide (one
# standard deviation). As published, the first would end at 3.3 standard deviations with level 1, and the middle of the
# second would be 252.
# Needs Debian's `chromium-headless-shell`, or a Chromium in CHROMIUM, and Node.
#
# Output seen with three 0.187.0, playwright-core 1.65.1, Chromium 156 and Node 20.20.2:
#   10 px: middle 254, last lit pixel at 1.90 standard deviations with level 42
#   0.25 px: middle 44
set -euo pipefail
browser=${CHROMIUM:-$(command -v chromium-headless-shell)}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit --ignore-scripts three@0.187.0 playwright-core@1.65.1
cat >splat.mjs <<'NODE'
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { chromium } from "playwright-core";

const FLOAT = 5126;
const [SIDE, FOCAL, DISTANCE] = [101, 100, 2];
const PAGE = `<script type="importmap">{"imports": {"three": "/three/build/three.webgpu.js",
  "three/webgpu": "/three/build/three.webgpu.js", "three/tsl": "/three/build/three.tsl.js",
  "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as three from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { GLTFGaussianSplatLoaderExtension as Splats } from "three/addons/loaders/GLTFGaussianSplatLoaderExtension.js";
Object.assign(window, { three, GLTFLoader, Splats });
</script>`;

/** A white, opaque, round splat in front of the camera. */
function splat(deviation) {
  const values = {
    POSITION: [0, 0, -DISTANCE],
    "KHR_gaussian_splatting:ROTATION": [0, 0, 0, 1],
    "KHR_gaussian_splatting:SCALE": [deviation, deviation, deviation],
    "KHR_gaussian_splatting:OPACITY": [1],
    // (1 - 0.5) / 0.2820948
    "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0": [1.7724539, 1.7724539, 1.7724539],
  };
  const kinds = { 1: "SCALAR", 3: "VEC3", 4: "VEC4" };
  const names = Object.keys(values);
  const numbers = new Float32Array(Object.values(values).flat());
  let byteOffset = 0;
  const bufferViews = names.map((name) => {
    const view = { buffer: 0, byteOffset, byteLength: 4 * values[name].length };
    byteOffset += view.byteLength;
    return view;
  });
  const accessors = names.map((name, bufferView) => ({
    bufferView, componentType: FLOAT, count: 1, type: kinds[values[name].length],
    ...(name === "POSITION" && { min: values[name], max: values[name] }),
  }));
  const uri = `data:application/octet-stream;base64,${Buffer.from(numbers.buffer).toString("base64")}`;
  return JSON.stringify({
    asset: { version: "2.0" }, extensionsUsed: ["KHR_gaussian_splatting"],
    scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }],
    meshes: [{ primitives: [{
      mode: 0, attributes: Object.fromEntries(names.map((name, index) => [name, index])),
      extensions: { KHR_gaussian_splatting: { kernel: "ellipse", colorSpace: "srgb_rec709_display" } },
    }] }],
    buffers: [{ uri, byteLength: numbers.byteLength }], bufferViews, accessors,
  });
}

/** Runs in the page: red along the middle row. */
async function draw({ text, side, focal }) {
  const { three, GLTFLoader, Splats } = window;
  const renderer = new three.WebGPURenderer({ forceWebGL: true, antialias: false });
  renderer.outputColorSpace = three.LinearSRGBColorSpace;
  renderer.setPixelRatio(1);
  renderer.setSize(side, side);
  await renderer.init();
  const gltf = await new GLTFLoader().register((parser) => new Splats(parser)).parseAsync(text, "");
  const scene = new three.Scene();
  scene.background = new three.Color(0);
  scene.add(gltf.scene);
  const camera = new three.PerspectiveCamera((360 / Math.PI) * Math.atan(side / 2 / focal), 1, 0.01, 100);
  renderer.render(scene, camera);
  const canvas = Object.assign(document.createElement("canvas"), { width: side, height: side });
  const context = canvas.getContext("2d");
  context.drawImage(renderer.domElement, 0, 0);
  const { data } = context.getImageData(0, (side - 1) / 2, side, 1);
  return Array.from({ length: side }, (_, x) => data[4 * x]);
}

const browser = await chromium.launch({
  executablePath: process.argv[2], args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
const page = await browser.newPage();
await page.route("**/*", (route) => {
  const { pathname } = new URL(route.request().url());
  if (pathname === "/") return route.fulfill({ body: PAGE, contentType: "text/html" });
  if (!pathname.startsWith("/three/")) return route.fulfill({ status: 404 });
  return route.fulfill({ body: readFileSync(join("node_modules", pathname)), contentType: "text/javascript" });
});
await page.goto("http://splat.test/");
await page.waitForFunction(() => "Splats" in window);
const middle = (SIDE - 1) / 2;
for (const deviation of [10, 0.25]) {
  const text = splat((deviation * DISTANCE) / FOCAL);
  const row = await page.evaluate(draw, { text, side: SIDE, focal: FOCAL });
  const last = row.findLastIndex((level) => level > 0);
  const far = (last - middle) / Math.sqrt(deviation ** 2 + 0.3);
  console.log(deviation > 1
    ? `${deviation} px: middle ${row[middle]}, last lit pixel at ${far.toFixed(2)} standard deviations with level ${row[last]}`
    : `${deviation} px: middle ${row[middle]}`);
}
console.log(`Chromium ${browser.version()}`);
await browser.close();
NODE
node splat.mjs "$browser" | tee output.txt
cat >expected.txt <<'TEXT'
10 px: middle 254, last lit pixel at 1.90 standard deviations with level 42
0.25 px: middle 44
TEXT
head -2 output.txt | diff expected.txt -
