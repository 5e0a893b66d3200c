// Tables that become cards on a phone.

import { h } from "./dom.js";

/**
 * A table of `columns`: [{ title, class, head }] (`head` replaces the title if given) and `rows`:
 * [[cell, ...], ...]. On a narrow page each row is a card and each cell has its title in front, so
 * explicit roles keep it a table for screen readers.
 */
export function table(columns, rows, properties = {}) {
  const head = h("tr", { role: "row" }, columns.map((column) =>
    h("th", { role: "columnheader", class: column.class ?? "" }, column.head ?? column.title)));
  return h("table", { class: "cards", role: "table", ...properties },
    h("thead", { role: "rowgroup" }, head), h("tbody", { role: "rowgroup" }, rows.map((cells) => row(columns, cells))));
}

/** The same for rows that do not change, without columns that are empty in all of them. */
export function staticTable(columns, rows) {
  const says = columns.map((_, i) => rows.some((cells) => !isEmpty(cells[i])));
  return table(columns.filter((_, i) => says[i]), rows.map((cells) => cells.filter((_, i) => says[i])));
}

const isEmpty = (cell) => cell === "" || cell === null || cell === undefined;

/** One row of such a table. */
export function row(columns, cells) {
  return h("tr", { role: "row" }, cells.map((cell, i) => {
    const style = `${columns[i].class ?? ""}${isEmpty(cell) ? " empty" : ""}`;
    return h("td", { role: "cell", class: style.trim(), "data-label": columns[i].title }, h("div", {}, isEmpty(cell) ? "" : cell));
  }));
}
