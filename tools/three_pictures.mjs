// Draws a scene with three.js in headless Chromium, from cameras of cameras.json.
//
//     node three_pictures.mjs PACKAGES FILE.glb CAMERAS.json FOLDER NAME...
//
// PACKAGES holds the node_modules with three and playwright-core. Writes FOLDER/NAME.png for each named camera, and
// FOLDER/depths.json: the nearest and the farthest depth that three.js sorts at, by name.

import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";

const [packages, file, cameras, folder, ...names] = process.argv.slice(2);
const { chromium } = createRequire(`${packages}/`)("playwright-core");
const PAGE = `<!doctype html>
<style>body { margin: 0 }</style>
<script type="importmap">{"imports": {
  "three": "/three/build/three.webgpu.js", "three/webgpu": "/three/build/three.webgpu.js",
  "three/tsl": "/three/build/three.tsl.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
  import * as three from "three";
  import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
  import { GLTFGaussianSplatLoaderExtension as Splats } from "three/addons/loaders/GLTFGaussianSplatLoaderExtension.js";
  Object.assign(window, { three, GLTFLoader, Splats });
</script>`;

/** Runs in the page: draws the scene as this camera of cameras.json sees it. */
async function draw({ width, height, fx, fy, cx, cy, world_to_camera: rows }) {
  const { three, GLTFLoader, Splats } = window;
  const renderer = new three.WebGPURenderer({ forceWebGL: true, antialias: false });
  // Splats have the colours of the screen already.
  renderer.outputColorSpace = three.LinearSRGBColorSpace;
  renderer.setPixelRatio(1);
  renderer.setSize(width, height);
  document.body.replaceChildren(renderer.domElement);
  await renderer.init();
  const bytes = await (await fetch("/scene.glb")).arrayBuffer();
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

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium-headless-shell",
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
const known = JSON.parse(readFileSync(cameras));
const depths = {};
for (const name of names) {
  const camera = known.find((one) => one.name === name);
  const page = await browser.newPage({ viewport: { width: camera.width, height: camera.height } });
  const faults = [];
  page.on("pageerror", (error) => faults.push(error.message));
  await page.route("**/*", (route) => {
    const { pathname } = new URL(route.request().url());
    if (pathname === "/") return route.fulfill({ body: PAGE, contentType: "text/html" });
    if (pathname === "/scene.glb") return route.fulfill({ body: readFileSync(file) });
    if (!pathname.startsWith("/three/")) return route.fulfill({ status: 404 });
    return route.fulfill({ body: readFileSync(join(packages, "node_modules", pathname)), contentType: "text/javascript" });
  });
  await page.goto("http://three.test/");
  await page.waitForFunction(() => "Splats" in window);
  depths[name] = await page.evaluate(draw, camera);
  await page.locator("canvas").screenshot({ path: join(folder, `${name}.png`) });
  if (faults.length > 0) throw new Error(faults.join("\n"));
  await page.close();
}
writeFileSync(join(folder, "depths.json"), JSON.stringify(depths));
await browser.close();
