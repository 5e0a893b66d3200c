// Tables that become cards on a phone.

import { h } from "./dom.js";

/**
 * A table of `columns`: [{ title, class, head }] (`head` stands where a title is not enough) and `rows`: [[cell, ...], ...]. On a narrow page each row
 * is a card and each cell has its title in front, so the roles are said: as a card it is still a
 * table to whoever hears it.
 */
export function table(columns, rows, properties = {}) {
  const head = h("tr", { role: "row" }, columns.map((column) =>
    h("th", { role: "columnheader", class: column.class ?? "" }, column.head ?? column.title)));
  return h("table", { class: "cards", role: "table", ...properties },
    h("thead", { role: "rowgroup" }, head), h("tbody", { role: "rowgroup" }, rows.map((cells) => row(columns, cells))));
}

/** The same of rows that do not change: a column that says nothing in any of them is left out. */
export function told(columns, rows) {
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
