// Reads scenes with Spark and prints what it found as JSON: for each file a list of rows, each a Gaussian's centre, sizes,
// rotation x y z w, opacity and colour; or the message of its error.
//
//     node spark.mjs PACKAGES FILE...

import { resolve } from "node:path";

import { inBrowser } from "./in_browser.mjs";

const [packages, ...files] = process.argv.slice(2);
const IMPORTS = {
  "three": "three/build/three.module.js",
  "three/addons/": "three/examples/jsm/",
  "fflate": "fflate/esm/browser.js",
  "@sparkjsdev/spark": "@sparkjsdev/spark/dist/spark.module.js",
};

/** Runs in the page. */
async function read(path) {
  const fileBytes = new Uint8Array(await (await fetch(`/files/${path}`)).arrayBuffer());
  const splats = new window.ExtSplats({ fileBytes, fileName: path });
  const rows = [];
  try {
    await splats.initialized;
  } catch (error) {
    return String(error.message ?? error);
  }
  splats.forEachSplat((_, centre, sizes, rotation, opacity, colour) => {
    rows.push([centre, sizes, rotation].flatMap((vector) => vector.toArray()).concat(opacity, colour.toArray()));
  });
  return rows;
}

await inBrowser(packages, IMPORTS, `import { ExtSplats } from "@sparkjsdev/spark"; Object.assign(window, { ExtSplats })`, async (page) => {
  const found = [];
  for (const file of files) found.push(await page.evaluate(read, resolve(file)));
  console.log(JSON.stringify(found));
});
