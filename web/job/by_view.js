// Every photograph of a job in a list that can be sorted: its score, exposure, shake and position.

import { h, show, folding } from "../lib/dom.js";
import { table } from "../lib/table.js";
import { places, positionWord } from "./poses.js";
import { delivered, gained } from "./verdict.js";

/** Columns in which the smallest value is the worst. */
const SCORES = ["Gain, dB", "Score, dB"];

/** Positions that need attention. */
const ODD = ["doubtful", "taken_out", "not_found"];

const number = (digits, sign = false) => (value) => {
  const text = Math.abs(value).toFixed(digits);
  const before = value < 0 && Number(text) !== 0 ? "−" : sign && value > 0 ? "+" : "";
  return before + text;
};

/**
 * The columns: title, value of a row by which it is sorted, its text, and whether the largest value
 * comes first.
 */
const COLUMNS = [
  { title: "Photograph", of: ({ name }) => name },
  { title: "Gain, dB", of: ({ gain }) => gain, words: number(1, true) },
  { title: "Score, dB", of: ({ score }) => score, words: number(1) },
  { title: "Exposure, stops", of: ({ stops }) => stops, words: number(2, true) },
  { title: "Shake, px", of: ({ shake }) => shake, words: number(1), isFalling: true },
  { title: "Position", of: ({ place }) => place },
  { title: "Matches", of: ({ fitting }) => fitting, words: (value, { matches }) => `${value} of ${matches}` },
  { title: "Error, px", of: ({ error }) => error, words: number(2), isFalling: true },
  { title: "Likeness", of: ({ fit }) => fit, words: number(2) },
];

/** `{ root, update(report) }`; `open(name)` shows the pictures of a view. */
export function byView(open) {
  const root = folding("Scores by view");
  const sorts = h("select", { "data-key": "sort by", onchange: () => sort(sorts.value) });
  const hint = h("p", { class: "hint" });
  let [rows, columns, known, by, isTurned] = [[], [], "", "", false];

  /** Sorts by a column, or turns the order of the current one. */
  function sort(title) {
    isTurned = by === title && !isTurned;
    by = title;
    draw();
  }

  function draw() {
    const column = columns.find(({ title }) => title === by) ?? columns[0];
    const isFalling = Boolean(column.isFalling) !== isTurned;
    const heads = columns.map((one) => ({ ...one, head: headOf(one, one === column ? isFalling : null) }));
    const list = table(heads, sorted(rows, column, isFalling).map((one) => cells(one)));
    list.querySelectorAll("th").forEach((head, i) => {
      if (columns[i] === column) head.setAttribute("aria-sort", isFalling ? "descending" : "ascending");
    });
    list.classList.add("views");
    list.setAttribute("aria-label", "Scores by view");
    // Between a phone, where rows are cards, and a desk it is wider than the page.
    const framed = h("div", { class: "scroll", tabIndex: 0, role: "region", "aria-label": "Table of scores" }, list);
    const isWorst = !isFalling && SCORES.includes(column.title);
    hint.textContent = `${isWorst ? "Worst first. " : ""}Choose a photograph to see it before and after.`;
    sorts.value = by;
    const held = root.contains(document.activeElement) && document.activeElement.getAttribute("data-key");
    show(root, Object.assign(h("div", {}, h("label", { class: "sorts" }, "Sort by", sorts), hint, framed), { gist: gist() }));
    if (held) [...root.querySelectorAll("[data-key]")].find((one) => one.dataset.key === held)?.focus();
  }

  const headOf = ({ title }, isFalling) => h("button", { type: "button", class: "sort", "data-key": title, onclick: () => sort(title) },
    title, isFalling === null ? "" : h("span", { "aria-hidden": "true" }, isFalling ? " ▾" : " ▴"));

  function cells(one) {
    return columns.map(({ of, words, title }) => {
      const value = of(one);
      if (title === "Photograph") return one.isSeen ? h("button", { type: "button", class: "link", onclick: () => open(value) }, value) : value;
      if (value === undefined || value === null) return "";
      const text = words ? words(value, one) : value;
      return isBad(title, one) ? h("span", { class: "bad" }, text) : text;
    });
  }

  const isBad = (title, one) => (title === "Gain, dB" && one.gain < 0) || (title === "Position" && ODD.includes(one.status))
    || (title === "Shake, px" && one.isShaken);

  const first = () => columns.find(({ title }) => SCORES.includes(title))?.title ?? "Photograph";

  function gist() {
    const odd = rows.filter(({ status }) => ODD.includes(status)).length;
    return odd > 0 ? `${odd} not placed` : `${rows.length} placed`;
  }

  return {
    root,
    update(report) {
      const now = JSON.stringify([report.rounds.length, report.registered, report.best_round]);
      if (now === known) return;
      known = now;
      rows = rowsOf(report);
      columns = COLUMNS.filter(({ of }) => rows.some((one) => of(one) !== undefined && of(one) !== null));
      if (rows.length === 0) return;
      sorts.replaceChildren(...columns.map(({ title }) => h("option", { value: title }, title)));
      if (!columns.some(({ title }) => title === by)) [by, isTurned] = [first(), false];
      draw();
    },
  };
}

/** Rows without a value come last in either order. */
function sorted(rows, { of }, isFalling) {
  const isNone = (one) => of(one) === undefined || of(one) === null;
  const order = (a, b) => {
    const [x, y] = [of(a), of(b)];
    return typeof x === "string" ? x.localeCompare(y, undefined, { numeric: true }) : x - y;
  };
  const some = rows.filter((one) => !isNone(one)).sort(order);
  return [...(isFalling ? some.reverse() : some), ...rows.filter(isNone)];
}

function rowsOf(report) {
  const views = new Map((delivered(report) ?? report.rounds.at(-1))?.views?.map((view) => [view.name, view]));
  const usual = usualReference([...views.values()]);
  const light = report.exposure?.views ?? {};
  return places(report).map(({ name, status, matches, fitting, error_px: error, fit }) => {
    const view = views.get(name);
    return {
      name, status, fit, error, matches,
      place: positionWord(status),
      fitting: matches > 0 ? fitting : undefined,
      gain: view && gained(view),
      score: view?.reference === usual ? view?.psnr_cc_db : undefined,
      stops: light[name]?.stops,
      shake: view?.shake_px,
      isShaken: view?.is_shaken === true,
      isSeen: view?.registered === true,
    };
  });
}

/** The reference of most scored views; scores against different ones do not compare. */
function usualReference(views) {
  const counts = new Map();
  for (const { reference, psnr_cc_db: score } of views) {
    if (Number.isFinite(score)) counts.set(reference, (counts.get(reference) ?? 0) + 1);
  }
  return [...counts].sort(([, a], [, b]) => b - a)[0]?.[0];
}
