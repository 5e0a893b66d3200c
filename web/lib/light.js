// Brings two pictures to the same brightness: brightens the darker until their means agree.

/** Side of the measured copy, px; a mean needs no more. */
const SIDE = 64;
/** More would show only noise. */
const MOST = 64;
const HALVINGS = 24;

/** Encoded values of a loaded picture, 0..=1, of all three channels. */
export function values(image) {
  const canvas = document.createElement("canvas");
  canvas.width = SIDE;
  canvas.height = SIDE;
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0, SIDE, SIDE);
  const bytes = context.getImageData(0, 0, SIDE, SIDE).data;
  return Float64Array.from({ length: SIDE * SIDE * 3 }, (_, i) => bytes[4 * Math.floor(i / 3) + (i % 3)] / 255);
}

/** The mean after a gain, clipped at white as by `filter: brightness()`. */
export const mean = (list, gain = 1) => list.reduce((sum, value) => sum + Math.min(1, value * gain), 0) / list.length;

/** The gains, one of them 1, that raise both pictures to the mean of the brighter. */
export function gains(a, b) {
  const [first, second] = [mean(a), mean(b)];
  return first < second ? [gainTo(a, second), 1] : [1, gainTo(b, first)];
}

/** The gains that raise several pictures to the mean of the brightest. */
export function level(lists) {
  const wanted = Math.max(...lists.map((list) => mean(list)));
  return lists.map((list) => gainTo(list, wanted));
}

function gainTo(list, wanted) {
  if (mean(list) >= wanted) return 1;
  let [low, high] = [1, MOST];
  for (let i = 0; i < HALVINGS; i++) {
    const middle = (low + high) / 2;
    if (mean(list, middle) < wanted) low = middle;
    else high = middle;
  }
  return (low + high) / 2;
}
