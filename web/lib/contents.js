// A bar with the parts of a long page, each with its own address: `?part=NAME`.

import { h } from "./dom.js";
import { asked, keep, leap } from "./place.js";

/** Fewer parts need no bar. */
const FEWEST = 3;
/** How long a part stays in place after a jump while the page grows. */
const SETTLED_MS = 8000;

/**
 * `{ root, leave }` for `parts` by name, in `main`; a hidden part has no link yet. Jumps to the
 * part in the address once it appears.
 * @param {HTMLElement} main
 * @param {Record<string, HTMLElement>} parts
 */
export function contents(main, parts) {
  const root = h("nav", { class: "contents", "aria-label": "Parts of this page", hidden: true });
  /** @type {Map<Element, HTMLAnchorElement>} */
  const links = new Map(Object.entries(parts).map(([name, part]) => [part, link(name, part)]));
  let [wanted, settling] = [parts[asked().get("part")], 0];

  function link(name, part) {
    const [path] = location.hash.split("?");
    const go = (event) => {
      if (event.ctrlKey || event.metaKey || event.shiftKey) return;
      event.preventDefault();
      wanted = null;
      keep({ part: name });
      leap(part);
    };
    return h("a", { href: `${path || "#/"}?part=${name}`, onclick: go }, name[0].toUpperCase() + name.slice(1));
  }

  function draw() {
    const order = [...main.querySelectorAll("section:not([hidden])")].filter((part) => links.has(part));
    const now = order.map((part) => links.get(part));
    // Setting the same nodes is also a change and would cause endless redrawing.
    if (now.some((one, i) => one !== root.children[i]) || root.children.length !== now.length) {
      root.replaceChildren(...now);
      root.hidden = now.length < FEWEST;
    }
    if (!wanted || wanted.hidden) return;
    leap(wanted);
    settling ||= setTimeout(settle, SETTLED_MS);
  }

  // New content above a part moves it: it is held in place for a while, or until the user acts.
  const settle = () => { wanted = null; };
  const touches = ["wheel", "pointerdown", "keydown"];
  for (const touch of touches) addEventListener(touch, settle, { passive: true });
  const grown = new ResizeObserver(draw);
  grown.observe(main);

  const changes = new MutationObserver(draw);
  changes.observe(main, { childList: true, subtree: true, attributeFilter: ["hidden"] });
  const seen = new IntersectionObserver((all) => {
    for (const { target, isIntersecting } of all) {
      const link = links.get(target);
      if (isIntersecting) link.setAttribute("aria-current", "true");
      else link.removeAttribute("aria-current");
      // On a phone the bar is wider than the page.
      if (isIntersecting) root.scrollLeft = link.offsetLeft - root.clientWidth / 3;
    }
  }, { rootMargin: "-8% 0px -91% 0px" });
  for (const part of links.keys()) seen.observe(part);
  function leave() {
    clearTimeout(settling);
    for (const one of [changes, seen, grown]) one.disconnect();
    for (const touch of touches) removeEventListener(touch, settle);
  }
  return { root, leave };
}
