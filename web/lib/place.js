// Addresses, and the state that a page keeps behind the `?` of its own: links and the way back lead
// to it.

/** One can tell so many lines apart. */
export const MOST_COMPARED = 6;

/** The address of a comparison. */
export const comparisonOf = (ids) => `#/compare/${ids.map(encodeURIComponent).join(",")}`;

/** The state in the address. */
export const asked = () => new URLSearchParams(location.hash.split("?")[1] ?? "");

/** Writes values into the address; what is empty is left out. No page is opened by that. */
export function keep(values) {
  const real = Object.entries(values).filter(([, value]) => value !== "" && value !== null);
  const query = new URLSearchParams(real.map(([name, value]) => [name, String(value)])).toString();
  const [path] = (location.hash || "#/").split("?");
  const now = query ? `${path}?${query}` : path;
  if (now !== location.hash) history.replaceState(history.state, "", now);
}

/** Goes to a part of a page, unfolded; so does the focus. */
export function leap(part) {
  const fold = part.querySelector("details.fold");
  if (fold && fold.parentElement === part) fold.open = true;
  const title = part.querySelector("h2");
  title.tabIndex = -1;
  part.scrollIntoView();
  title.focus({ preventScroll: true });
}
