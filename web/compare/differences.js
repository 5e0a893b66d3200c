// Options of several jobs: those that differ, and, folded away, those that do not.

import { count, h, plain } from "../lib/dom.js";
import { nameOf, tag } from "./entries.js";
import { table } from "../lib/table.js";
import { optionName } from "../lib/words.js";

const written = (value) =>
  value === undefined ? "not recorded" : Array.isArray(value) ? value.join(", ") : String(value);

/** `{ differing, shared }`: option names, `preset` first, split by whether all jobs agree. */
export function sorted(jobs) {
  const names = [...new Set(jobs.flatMap((job) => Object.keys(job.options)))].sort((a, b) =>
    optionName(a) < optionName(b) ? -1 : 1,
  );
  const agree = (name) => new Set(jobs.map((job) => written(valueOf(job, name)))).size === 1;
  const all = ["preset", ...names];
  return { differing: all.filter((name) => !agree(name)), shared: all.filter(agree) };
}

const valueOf = (job, name) => (name === "preset" ? job.preset : job.options[name]);

/** Nodes for a section; `null` if there are fewer than two jobs. */
export function differences(entries) {
  const there = entries.filter((one) => one.job);
  if (there.length < 2) return null;
  const { differing, shared } = sorted(there.map((one) => one.job));
  const columns = [
    { title: "Option" },
    ...there.map((one) => ({
      title: one.letter,
      head: h("span", { class: "who" }, tag(one), " ", nameOf(one)),
    })),
  ];
  const rows = differing.map((name) => [
    h("b", {}, optionName(name)),
    ...there.map((one) => plain(written(valueOf(one.job, name)))),
  ]);
  return [
    rows.length > 0
      ? table(columns, rows)
      : h("p", {}, "These jobs have the same preset and options."),
    shared.length > 0 &&
      h(
        "details",
        {},
        h(
          "summary",
          {},
          count(shared.length, "identical option"),
        ),
        h(
          "dl",
          {},
          shared.flatMap((name) => [
            h("dt", {}, optionName(name)),
            h("dd", {}, plain(written(valueOf(there[0].job, name)))),
          ]),
        ),
      ),
  ].filter(Boolean);
}
