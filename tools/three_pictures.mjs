// Draws a scene with three.js in headless Chromium, from cameras of cameras.json.
//
//     node three_pictures.mjs PACKAGES FILE.glb CAMERAS.json FOLDER NAME...
//
// PACKAGES holds the node_modules with three and playwright-core. Writes FOLDER/NAME.png for each named camera, and
// FOLDER/depths.json: the nearest and the farthest depth that three.js sorts at, by name.

import { readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";

import { inBrowser } from "./in_browser.mjs";

const [packages, file, cameras, folder, ...names] = process.argv.slice(2);
const IMPORTS = {
  "three": "three/build/three.webgpu.js",
  "three/webgpu": "three/build/three.webgpu.js",
  "three/tsl": "three/build/three.tsl.js",
  "three/addons/": "three/examples/jsm/",
};
const SCRIPT = `
  import * as three from "three";
  import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
  import { GLTFGaussianSplatLoaderExtension as Splats } from "three/addons/loaders/GLTFGaussianSplatLoaderExtension.js";
  Object.assign(window, { three, GLTFLoader, Splats })`;

/** Runs in the page: draws the scene as this camera of cameras.json sees it. */
async function draw([path, { width, height, fx, fy, cx, cy, world_to_camera: rows }]) {
  const { three, GLTFLoader, Splats } = window;
  const renderer = new three.WebGPURenderer({ forceWebGL: true, antialias: false });
  // Splats have the colours of the screen already.
  renderer.outputColorSpace = three.LinearSRGBColorSpace;
  renderer.setPixelRatio(1);
  renderer.setSize(width, height);
  document.body.replaceChildren(renderer.domElement);
  await renderer.init();
  const bytes = await (await fetch(`/files/${path}`)).arrayBuffer();
  const gltf = await new GLTFLoader().register((parser) => new Splats(parser)).parseAsync(bytes, "");
  gltf.scene.updateMatrixWorld(true);
  let splats;
  gltf.scene.traverse((object) => { splats = object.isMesh ? object : splats; });
  const scene = new three.Scene();
  scene.background = new three.Color(0);
  scene.add(gltf.scene);

  const camera = new three.PerspectiveCamera();
  Object.assign(camera, { near: 0.01, far: 1000, matrixAutoUpdate: false });
  // From OpenCV's axes in the world of the poses to OpenGL's in that of the file.
  const half = new three.Matrix4().makeScale(1, -1, -1);
  const pose = new three.Matrix4().set(...rows.flat()).invert();
  camera.matrix.copy(splats.matrixWorld).multiply(half).multiply(pose).multiply(half);
  camera.updateMatrixWorld(true);
  const { near, far } = camera;
  camera.projectionMatrix.set(2 * fx / width, 0, 1 - 2 * cx / width, 0, 0, 2 * fy / height, 2 * cy / height - 1, 0,
    0, 0, (far + near) / (near - far), 2 * far * near / (near - far), 0, 0, -1, 0);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  renderer.render(scene, camera);
  const middle = splats.boundingSphere.center.clone().applyMatrix4(splats.matrixWorld).applyMatrix4(camera.matrixWorldInverse);
  const { radius } = splats.boundingSphere;
  return [Math.max(near, -middle.z - radius), -middle.z + radius];
}

await inBrowser(packages, IMPORTS, SCRIPT, async (page) => {
  const known = JSON.parse(readFileSync(cameras));
  const depths = {};
  for (const name of names) {
    const camera = known.find((one) => one.name === name);
    await page.setViewportSize({ width: camera.width, height: camera.height });
    depths[name] = await page.evaluate(draw, [resolve(file), camera]);
    await page.locator("canvas").screenshot({ path: join(folder, `${name}.png`) });
  }
  writeFileSync(join(folder, "depths.json"), JSON.stringify(depths));
});
