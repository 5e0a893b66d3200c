// Fetches modules ahead: the page lists those that each part imports on demand.

/** Fetches `module` and all that it imports, in parallel: a browser finds them one by one. */
export function preload(module) {
  for (const link of /** @type {NodeListOf<HTMLLinkElement>} */ (document.querySelectorAll("link[data-of]"))) {
    if (!link.rel && link.dataset.of.split(" ").includes(module)) link.rel = "modulepreload";
  }
}
