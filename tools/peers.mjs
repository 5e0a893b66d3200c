// Reads a scene or a mesh with three.js' own loaders and prints what they found as JSON.
//
//     node peers.mjs FOLDER FILE.glb|FILE.spz|FILE.mesh.ply|FILE.mesh.glb
//
// FOLDER holds the node_modules with three. Printed of a mesh are, for each vertex, its place, normal and colour in linear
// light, and the vertices of each triangle. Printed of a scene are, for each Gaussian, its centre, its covariance (xx, xy, xz, yy,
// yz, zz), its colour and opacity in 0 to 255, and its higher harmonics in steps of 1/128 from 128, by degree; and the matrix
// of the node, column by column.

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

/** The only mesh in a binary glTF. */
async function onlyMesh() {
  const [GLTFLoader, Extension] = [await loader("GLTFLoader"), await loader("GLTFGaussianSplatLoaderExtension")];
  const gltf = await new GLTFLoader().register((parser) => new Extension(parser)).parseAsync(bytes, "");
  gltf.scene.updateMatrixWorld(true);
  const found = [];
  gltf.scene.traverse((object) => {
    if (object.isMesh) found.push(object);
  });
  if (found.length !== 1) throw new Error(`${found.length} objects instead of one`);
  return found[0];
}

async function ofGltf() {
  const { splatGeometry, matrixWorld } = await onlyMesh();
  return { splats: splatGeometry, node: matrixWorld.elements };
}

async function ofMesh() {
  const read = async () => new (await loader("PLYLoader"))().parse(bytes);
  const { attributes, index } = file.endsWith(".ply") ? await read() : (await onlyMesh()).geometry;
  const rows = (attribute) => Array.from({ length: attribute.count }, (_, i) => [attribute.getX(i), attribute.getY(i), attribute.getZ(i)]);
  const [position, normal, colour] = [attributes.position, attributes.normal, attributes.color].map(rows);
  return { position, normal, colour, triangles: Array.from(index.array) };
}

async function ofSpz() {
  const SPZLoader = await loader("SPZLoader");
  return { splats: await new SPZLoader().parse(bytes), node: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] };
}

async function ofScene() {
  const { splats, node } = await (file.endsWith(".glb") ? ofGltf() : ofSpz());
  const { position, covariance, color } = splats.attributes;
  const harmonics = [1, 2, 3].map((degree) => splats.attributes[`sphericalHarmonics${degree}`]).filter(Boolean);
  const words = harmonics.map(({ array, itemSize }) => ({ bytes: Array.from(new Uint8Array(array.buffer)), row: 4 * itemSize }));
  return {
    count: position.count,
    node,
    position: Array.from(position.array),
    covariance: Array.from(covariance.array),
    colour: Array.from(color.array),
    harmonics: words,
  };
}

console.log(JSON.stringify(await (/\.mesh\.(ply|glb)$/.test(file) ? ofMesh() : ofScene())));
