// The browser's check of a chosen file before it is sent.

import { h } from "../lib/dom.js";

/** The server reads all three kinds; the browser shows the first. */
const SHOWN = /\.(jpe?g|jfif|mpo|png|webp)$/i;
const READ = /\.(tiff?|heic|heif|hif|zip|mp4|mov|m4v)$/i;
/** Raw files, as src/capture/image/signature.rs lists them. */
const RAW = /\.(3fr|arw|cr[23w]|dcr|dng|erf|fff|gpr|iiq|kdc|mef|mos|mrw|n[er][fw]|orf|pef|raf|rw[2l]|sr[2fw]|x3f)$/i;
/** Shortest acceptable longest side of a photograph, px. */
const LEAST = 64;
/** Files beside photographs: poses and models. */
const BESIDE = /\.(json|npy|txt|bin|csv)$/i;

/** `{ picture, fault }` of a file: a thumbnail, and an element for its fault. */
export function looked(path, file) {
  const picture = h("span", { class: "thumb" });
  const fault = h("span", { class: "bad" });
  const isShown = SHOWN.test(path);
  if (file.size === 0) fault.textContent = "empty file";
  else if (!isShown && !READ.test(path) && !RAW.test(path) && !BESIDE.test(path)) fault.textContent = "not a photograph; it will not be used";
  else if (isShown) picture.append(thumbnail(file, fault));
  return { picture, fault };
}

function thumbnail(file, fault) {
  const url = URL.createObjectURL(file);
  const image = h("img", { alt: "", loading: "lazy", decoding: "async", src: url });
  const done = () => URL.revokeObjectURL(url);
  image.addEventListener("load", () => {
    const [width, height] = [image.naturalWidth, image.naturalHeight];
    if (Math.max(width, height) < LEAST) fault.textContent = `too small: ${width} × ${height} px`;
    done();
  });
  image.addEventListener("error", () => {
    fault.textContent = "cannot be read as a picture";
    image.remove();
    done();
  });
  return image;
}
