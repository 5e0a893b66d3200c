// Addresses, and the state that a page keeps after the `?` of its own, so that links and the back
// button restore it.

/** More lines in a chart would be hard to distinguish. */
export const MOST_COMPARED = 6;

/** The address of a comparison. */
export const comparisonOf = (ids) => `#/compare/${ids.map(encodeURIComponent).join(",")}`;

/**
 * The job and the secret in the address of a shared job, `#/share/JOB/SECRET`; `null` for others.
 * @returns {[string, string] | null}
 */
export function shareOf(hash) {
  const found = hash.match(/^#\/share\/([0-9a-f-]+)\/(fled_[0-9a-f]+)$/);
  return found && [found[1], found[2]];
}

/** The state in the address. */
export const asked = () => new URLSearchParams(location.hash.split("?")[1] ?? "");

/** Writes non-empty values into the address without opening a page. */
export function keep(values) {
  const real = Object.entries(values).filter(([, value]) => value !== "" && value !== null);
  const query = new URLSearchParams(real.map(([name, value]) => [name, String(value)])).toString();
  const [path] = (location.hash || "#/").split("?");
  const now = query ? `${path}?${query}` : path;
  if (now !== location.hash) history.replaceState(history.state, "", now);
}

/** Scrolls to a part of a page, unfolds it and gives it the focus. */
export function leap(part) {
  const fold = part.querySelector("details.fold");
  if (fold && fold.parentElement === part) fold.open = true;
  const title = part.querySelector("h2");
  title.tabIndex = -1;
  part.scrollIntoView();
  title.focus({ preventScroll: true });
}
