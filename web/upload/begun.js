// Which uploads this browser has begun: they go on after a reload, when the same files are chosen.

const KEY = "fled uploads";
/** The server keeps them for so long, ms. */
const KEPT = 24 * 3600 * 1000;

const mark = (path, file) => `${path}\n${file.size}\n${file.lastModified}`;

/** `{ mark: { id, at } }`. A browser may refuse to keep anything; then nothing goes on. */
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
  } catch { /* Then a reload begins anew. */ }
}

export const begun = {
  /** The id of the upload of this file, where one was begun. */
  find: (path, file) => read()[mark(path, file)]?.id ?? null,
  keep(path, file, id) {
    write({ ...read(), [mark(path, file)]: { id, at: Date.now() } });
  },
  /** Of these `[path, file]` pairs a job was made, or they are to be sent anew. */
  forget(files) {
    const all = read();
    for (const [path, file] of files) delete all[mark(path, file)];
    write(all);
  },
  count: () => Object.keys(read()).length,
};
