// Files dropped on the page, including those in folders.

/** Takes files dropped anywhere on the page; returns a function that stops it. */
export function takeDrops(box, take) {
  const over = (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    box.classList.add("over");
  };
  const leave = (event) => {
    // Only if the pointer leaves the window, as it also leaves every element on its way.
    if (!event.relatedTarget) box.classList.remove("over");
  };
  const drop = async (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    box.classList.remove("over");
    take(await filesOf(event.dataTransfer));
  };
  // Runs before the window's own listeners, which refuse unhandled drops.
  const listeners = Object.entries({ dragover: over, dragleave: leave, drop });
  for (const [name, listener] of listeners) document.addEventListener(name, listener);
  return () => { for (const [name, listener] of listeners) document.removeEventListener(name, listener); };
}

/** `[path, file]` of each. The list of items is read before the first await, which clears it. */
async function filesOf(transfer) {
  const items = [...transfer.items].filter((item) => item.kind === "file");
  const found = items.map((item) => [item.webkitGetAsEntry?.(), item.getAsFile()]);
  const lists = await Promise.all(found.map(([entry, file]) =>
    (entry?.isDirectory ? inFolder(entry) : file ? [[file.name, file]] : [])));
  return lists.flat();
}

async function inFolder(folder) {
  const reader = folder.createReader();
  const entries = [];
  for (;;) {
    // A reader returns about a hundred at a time, and none at the end.
    const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (some.length === 0) break;
    entries.push(...some);
  }
  const lists = await Promise.all(entries.map((entry) => (entry.isDirectory ? inFolder(entry) : one(entry))));
  return lists.flat();
}

async function one(entry) {
  const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
  return [[entry.fullPath.replace(/^\//, ""), file]];
}
