// The difference of two pictures, as a picture.

/** Gain of the difference; small differences would otherwise look black. */
export const TIMES = 4;

/**
 * The address of a picture of |a - b|, times `TIMES`, of the encoded values of each channel; the
 * second picture is scaled to the size of the first. The caller releases it
 * (`URL.revokeObjectURL`).
 */
export async function difference(a, b) {
  const [first, second] = await Promise.all([a, b].map(read));
  const { width, height } = first;
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  const pixels = (image) => {
    context.drawImage(image, 0, 0, width, height);
    return context.getImageData(0, 0, width, height);
  };
  const [one, other] = [pixels(first), pixels(second)];
  amplify(one.data, other.data);
  context.putImageData(one, 0, 0);
  return URL.createObjectURL(await canvas.convertToBlob({ type: "image/png" }));
}

/** Writes the difference of two lists of RGBA bytes into the first. */
export function amplify(one, other) {
  for (let i = 0; i < one.length; i++) {
    one[i] = i % 4 === 3 ? 255 : Math.min(255, TIMES * Math.abs(one[i] - other[i]));
  }
}

async function read(url) {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url}: ${answer.status}`);
  return createImageBitmap(await answer.blob());
}
