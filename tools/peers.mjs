// Reads a scene with three.js' own loaders and prints what they found as JSON.
//
//     node peers.mjs FOLDER FILE.glb|FILE.spz
//
// FOLDER holds the node_modules with three. Printed are, for each Gaussian, its centre, its covariance (xx, xy, xz, yy,
// yz, zz), its colour and opacity in 0 to 255, and its higher harmonics in steps of 1/128 from 128, by degree.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

// Parts of three expect a browser's names.
globalThis.self = globalThis;
globalThis.ProgressEvent = class {};

const [folder, file] = process.argv.slice(2);
const require = createRequire(`${folder}/`);
const loader = async (name) => (await import(pathToFileURL(require.resolve(`three/addons/loaders/${name}.js`))))[name];
const bytes = new Uint8Array(readFileSync(file)).buffer;

async function ofGltf() {
  const [GLTFLoader, Extension] = [await loader("GLTFLoader"), await loader("GLTFGaussianSplatLoaderExtension")];
  const gltf = await new GLTFLoader().register((parser) => new Extension(parser)).parseAsync(bytes, "");
  gltf.scene.updateMatrixWorld(true);
  const found = [];
  gltf.scene.traverse((object) => {
    if (object.isMesh) found.push(object);
  });
  if (found.length !== 1) throw new Error(`${found.length} objects instead of one`);
  return { splats: found[0].splatGeometry, translation: found[0].matrixWorld.elements.slice(12, 15) };
}

async function ofSpz() {
  const SPZLoader = await loader("SPZLoader");
  return { splats: await new SPZLoader().parse(bytes), translation: [0, 0, 0] };
}

const { splats, translation } = await (file.endsWith(".glb") ? ofGltf() : ofSpz());
const { position, covariance, color } = splats.attributes;
const harmonics = [1, 2, 3].map((degree) => splats.attributes[`sphericalHarmonics${degree}`]).filter(Boolean);
const words = harmonics.map(({ array, itemSize }) => ({ bytes: Array.from(new Uint8Array(array.buffer)), row: 4 * itemSize }));
console.log(JSON.stringify({
  count: position.count,
  translation,
  position: Array.from(position.array),
  covariance: Array.from(covariance.array),
  colour: Array.from(color.array),
  harmonics: words,
}));
