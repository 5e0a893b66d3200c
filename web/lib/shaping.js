// The user's crop of exports, pictures and videos, and the scale of exports. The scene and the list
// of exports both show and change them.

/**
 * `now` is `{ isOffered, crop, scale }`: whether there are exports, the crop, and the metres per
 * unit of the poses' world, the last two `null` if there is none. `change(some)` replaces some of
 * it. `heard(does)` calls `does` after each change until the function that it returns is called.
 */
export function newShaping() {
  const hearing = new Set();
  return {
    now: { isOffered: false, crop: null, scale: null },
    change(some) {
      this.now = { ...this.now, ...some };
      for (const does of hearing) does();
    },
    heard(does) {
      hearing.add(does);
      return () => hearing.delete(does);
    },
  };
}

/** The query of an export's address, with its question mark; empty if nothing shapes it. */
export function shapingQuery({ crop, scale }) {
  const query = new URLSearchParams();
  if (crop !== null) query.set("crop", cropText(crop));
  if (scale !== null) query.set("scale", scale);
  return query.size > 0 ? `?${query}` : "";
}

/** A crop as the requests for exports, pictures and videos take it. */
export const cropText = ({ shape, centre, size }) => `${shape}:${[...centre, ...size].join(",")}`;
