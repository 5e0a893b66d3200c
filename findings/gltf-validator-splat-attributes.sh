#!/usr/bin/env bash
# gltf-validator 2.0.0-dev.3.10 reports errors in every glTF with Gaussian splats, whatever is in it.
#
# KHR_gaussian_splatting names its attributes "KHR_gaussian_splatting:ROTATION" and the like: glTF lets an extension
# prefix its own. The validator does not know the extension, says so as information, and then calls each such attribute
# an error, MESH_PRIMITIVE_INVALID_ATTRIBUTE, so that a valid splat file fails a check for errors. The same file without
# these attributes has none.
#
# Output seen with Node 20.20.2:
#   with the attributes of splats: 4 errors: MESH_PRIMITIVE_INVALID_ATTRIBUTE
#   without: 0 errors:
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit gltf-validator@2.0.0-dev.3.10
cat >check.mjs <<'NODE'
import validator from "gltf-validator";

const FLOAT = 5126;
// One splat: where it is, how it is turned, its size, opacity and colour.
const values = {
  POSITION: [1, 2, 3],
  "KHR_gaussian_splatting:ROTATION": [0, 0, 0, 1],
  "KHR_gaussian_splatting:SCALE": [0.1, 0.1, 0.1],
  "KHR_gaussian_splatting:OPACITY": [0.5],
  "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0": [0.2, 0.1, 0],
};
const KINDS = { 1: "SCALAR", 3: "VEC3", 4: "VEC4" };

function splat(hasAttributes) {
  const names = Object.keys(values).filter((name) => hasAttributes || name === "POSITION");
  const numbers = new Float32Array(names.flatMap((name) => values[name]));
  let offset = 0;
  const bufferViews = names.map((name) => {
    const view = { buffer: 0, byteOffset: offset, byteLength: 4 * values[name].length };
    offset += view.byteLength;
    return view;
  });
  const accessors = names.map((name, bufferView) => {
    const accessor = { bufferView, componentType: FLOAT, count: 1, type: KINDS[values[name].length] };
    return name === "POSITION" ? { ...accessor, min: values[name], max: values[name] } : accessor;
  });
  const primitive = { mode: 0, attributes: Object.fromEntries(names.map((name, index) => [name, index])) };
  if (hasAttributes) {
    primitive.extensions = { KHR_gaussian_splatting: { kernel: "ellipse", colorSpace: "srgb_rec709_display" } };
  }
  const uri = `data:application/octet-stream;base64,${Buffer.from(numbers.buffer).toString("base64")}`;
  return JSON.stringify({
    asset: { version: "2.0" },
    ...(hasAttributes && { extensionsUsed: ["KHR_gaussian_splatting"] }),
    scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }], meshes: [{ primitives: [primitive] }],
    buffers: [{ uri, byteLength: numbers.byteLength }], bufferViews, accessors,
  });
}

async function errors(text) {
  const { issues } = await validator.validateString(text);
  const codes = issues.messages.filter((message) => message.severity === 0).map((message) => message.code);
  return { count: issues.numErrors, codes: [...new Set(codes)] };
}

const [withAttributes, without] = [await errors(splat(true)), await errors(splat(false))];
console.log(`with the attributes of splats: ${withAttributes.count} errors: ${withAttributes.codes.join(", ")}`);
console.log(`without: ${without.count} errors: ${without.codes.join(", ")}`);
if (without.count !== 0) throw new Error("the plain file is no longer valid: nothing is shown");
if (withAttributes.codes.join() !== "MESH_PRIMITIVE_INVALID_ATTRIBUTE" || withAttributes.count !== 4) {
  throw new Error("what the validator says of splats has changed");
}
NODE
node check.mjs
