// Uploads that this browser has begun; they resume after a reload if the same files are chosen.

const KEY = "fled uploads";
/** How long the server keeps them, ms. */
const KEPT = 24 * 3600 * 1000;

const mark = (path, file) => `${path}\n${file.size}\n${file.lastModified}`;

/** `{ mark: { id, at } }`. If the browser refuses storage, uploads do not resume. */
function read() {
  try {
    const all = Object.entries(JSON.parse(localStorage.getItem(KEY) ?? "{}"));
    return Object.fromEntries(all.filter(([, { at }]) => Date.now() - at < KEPT));
  } catch {
    return {};
  }
}

function write(all) {
  try {
    localStorage.setItem(KEY, JSON.stringify(all));
  } catch { /* Uploads restart after a reload. */ }
}

export const begun = {
  /** The id of a begun upload of this file, if any. */
  find: (path, file) => read()[mark(path, file)]?.id ?? null,
  keep(path, file, id) {
    write({ ...read(), [mark(path, file)]: { id, at: Date.now() } });
  },
  /** Forgets these `[path, file]` pairs, because a job has them or they must be sent again. */
  forget(files) {
    const all = read();
    for (const [path, file] of files) delete all[mark(path, file)];
    write(all);
  },
  /** Marks these `[path, file]` pairs as complete, but refused as photographs of a job. */
  refuse(files) {
    const all = read();
    for (const [path, file] of files) {
      const entry = all[mark(path, file)];
      if (entry) entry.isRefused = true;
    }
    write(all);
  },
  /** The ids of the uploads that the server may still have, by whether they were refused. */
  left() {
    const all = Object.values(read());
    const ids = (isRefused) => all.filter((one) => Boolean(one.isRefused) === isRefused).map(({ id }) => id);
    return { refused: ids(true), interrupted: ids(false) };
  },
  /** Forgets uploads by their ids. */
  drop(ids) {
    write(Object.fromEntries(Object.entries(read()).filter(([, { id }]) => !ids.includes(id))));
  },
};
