// What the user has drawn in the scene to shape its exports; the scene and the list of exports
// both show and change it.

/**
 * `now` is `{ isOffered, crop }`: whether there are exports, and `null` or a crop of them;
 * `change(some)` replaces some of it, and `heard(does)` calls `does` after each change until the
 * function that it returns is called.
 */
export function newShaping() {
  const hearing = new Set();
  return {
    now: { isOffered: false, crop: null },
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

/** A crop as `crop` of an export's address. */
export const cropText = ({ shape, centre, size }) => `${shape}:${[...centre, ...size].join(",")}`;
