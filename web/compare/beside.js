// The same view of two jobs side by side, and of all of them in a row.

import { address, h } from "../lib/dom.js";
import { called } from "./entries.js";
import { asked, keep } from "../lib/place.js";
import { split } from "../lib/split.js";
import { thumbnails } from "../lib/strip.js";

const KINDS = [
  ["inputs", "photograph"],
  ["enhanced", "enhanced"],
  ["deblurred", "deblurred"],
  ["renders", "rendered"],
  ["gt", "ground truth"],
];
const hasRounds = (kind) => kind !== "inputs" && kind !== "gt";

/** `{ root, update(entries) }`. */
export function beside() {
  const select = (label) => h("select", { "aria-label": label, onchange: chosen });
  const [left, right, view, kind, round] = [
    "left job",
    "right job",
    "view",
    "picture",
    "round",
  ].map(select);
  kind.append(...KINDS.map(([value, label]) => h("option", { value }, label)));
  const slider = split();
  const strip = thumbnails((side, key) => {
    (side === "left" ? left : right).value = key;
    chosen();
  }, slider);
  const words = h("p", { class: "hint", role: "status" });
  const pictures = h("div", {}, slider.root, slider.tools);
  const field = (label, node) => h("label", {}, label, node);
  const root = h(
    "section",
    { hidden: true },
    h("h2", {}, "The same view side by side"),
    h(
      "div",
      { class: "row fields" },
      field("Left", left),
      field("Right", right),
      field("View", view),
      field("Picture", kind),
      field("Round", round),
    ),
    words,
    pictures,
    strip.root,
  );
  let [entries, begun] = [[], false];

  const find = (id) => entries.find((one) => one.id === id);

  /** Sets the initial choices from the address. */
  function begin() {
    begun = true;
    const wanted = asked();
    kind.value = KINDS.some(([value]) => value === wanted.get("picture"))
      ? wanted.get("picture")
      : "renders";
    const letter = (name) => entries.find((one) => one.letter === wanted.get(name))?.id;
    refill(
      left,
      entries.map((one) => [one.id, called(one)]),
      letter("left") ?? entries[0].id,
    );
    refill(
      right,
      entries.map((one) => [one.id, called(one)]),
      letter("right") ?? entries[1]?.id,
    );
    fillRounds(wanted.get("round"));
    fillViews(wanted.get("view"));
  }

  function fillRounds(value) {
    const most = Math.max(...entries.map((one) => one.rounds.length));
    refill(
      round,
      [
        ["", "delivered or latest"],
        ...Array.from({ length: most }, (_, i) => [String(i + 1), String(i + 1)]),
      ],
      value,
    );
  }

  /** Lists the views that both jobs have, held-out ones first. */
  function fillViews(value) {
    const [a, b] = [left, right].map((side) => find(side.value)?.cameras ?? []);
    const both = a.filter((one) => b.some((other) => other.name === one.name));
    const first = both.find((one) => one.split === "held_out") ?? both[0];
    const isThere = both.some((one) => one.name === value);
    refill(
      view,
      both.map((one) => [one.name, one.split === "held_out" ? `${one.name} (held out)` : one.name]),
      isThere ? value : first?.name,
    );
  }

  function chosen() {
    fillViews(view.value);
    const letter = (side) => find(side.value)?.letter ?? "";
    keep({
      left: letter(left),
      right: letter(right),
      view: view.value,
      picture: kind.value,
      round: round.value,
    });
    draw();
  }

  /** The chosen picture of a job; `null` if the job has none. */
  function pictureOf(one) {
    if (!one || !one.cameras.some((camera) => camera.name === view.value)) return null;
    if (kind.value === "gt" && !hasTruth(one)) return null;
    const at = Number(round.value) || (one.report?.best_round ?? one.rounds.at(-1)?.round);
    if (hasRounds(kind.value) && !one.rounds.some((row) => row.round === at)) return null;
    const folder = hasRounds(kind.value) ? `rounds/${at}/${kind.value}` : kind.value;
    const label = hasRounds(kind.value) ? `${called(one)}, round ${at}` : called(one);
    return {
      key: one.id,
      label,
      url: `v1/jobs/${one.id}/artifacts/${address(`${folder}/${view.value}.jpg`)}`,
    };
  }

  function draw() {
    round.closest("label").hidden = !hasRounds(kind.value);
    const [a, b] = [find(left.value), find(right.value)];
    const shown = [pictureOf(a), pictureOf(b)];
    words.textContent = lack(
      [a, b],
      shown,
      view.value,
      KINDS.find(([value]) => value === kind.value)[1],
    );
    words.hidden = words.textContent === "";
    pictures.hidden = shown.some((one) => !one);
    const all = entries.map(pictureOf).filter(Boolean);
    strip.root.hidden = all.length < 3;
    strip.fill(all);
    strip.mark(left.value, right.value);
    if (!pictures.hidden) slider.show(...shown);
  }

  return {
    root,
    update(now) {
      entries = now.filter((one) => one.job);
      root.hidden = entries.length < 2 || entries.every((one) => one.rounds.length === 0);
      if (root.hidden) return;
      if (begun) {
        for (const side of [left, right])
          refill(
            side,
            entries.map((one) => [one.id, called(one)]),
            side.value,
          );
        fillRounds(round.value);
        fillViews(view.value);
      } else begin();
      draw();
    },
  };
}

const hasTruth = (one) =>
  one.rounds.some((round) => round.records.some((record) => record.reference === "gt"));

/** Why no comparison is shown, or a caution about the one shown. */
function lack([a, b], shown, view, picture) {
  if (!a || !b) return "";
  for (const one of [a, b])
    if (one.cameras.length === 0)
      return `${called(one)} has no pictures yet: no round has finished.`;
  if (!view) return "These jobs share no view: none of their photographs have the same name.";
  const without = [a, b].filter((_, i) => !shown[i]);
  if (without.length > 0) {
    const have = `${without.map(called).join(" and ")} ${without.length === 1 ? "has" : "have"}`;
    return `${have} no picture “${picture}” for this view and round.`;
  }
  if (a.id === b.id) return "Both sides show the same job.";
  return a.job.capture_id === b.job.capture_id
    ? ""
    : "These jobs use different captures: pictures with the same name may show different places.";
}

/** Replaces the options of a choice; keeps its value if that is among them. */
function refill(select, options, value) {
  const known = JSON.stringify(options);
  if (select.known !== known) {
    select.known = known;
    select.replaceChildren(...options.map(([key, text]) => h("option", { value: key }, text)));
  }
  if (options.some(([key]) => key === value)) select.value = value;
}
