// The form of a job's options, made from `/v1/options`.

import { api, h, plain, prose } from "../lib/dom.js";
import { lacksGpu } from "../lib/machine.js";
import { optionName } from "../lib/words.js";

/** Options by purpose; the rest are for experts and folded away. */
const GROUPS = {
  Result: ["size", "rounds", "target", "held_out"],
  Speed: ["minutes", "steps", "cap"],
  Poses: ["pose_source", "refine_poses", "late_views"],
};
/** Options that compare methods or choose machines; only for the API and the command line. */
const UNASKED = ["adapter", "detail", "lut_scope", "enhance", "noise", "loss", "schedule", "key_points"];
const PRESETS = {
  auto: "auto: high with a good GPU, else standard",
  preview: "preview: a quick look",
  standard: "standard",
  high: "high: for a GPU",
  paper: "paper: for a GPU",
};
/** Those that a machine without a GPU cannot run in a reasonable time. */
const FOR_GPUS = ["high", "paper"];

/** Delay after a failed request. */
const AGAIN_MS = 3000;

let schema = null;

/** The schema does not change while a server runs. */
const load = () => (schema ??= api("v1/options").catch((error) => { schema = null; throw error; }));

let forms = 0;

/**
 * Preset and options: `{ preset, root, chosen(), check(), fault(error), fill(preset, options),
 * asFor(job) }`. `chosen` has only what differs from the preset; `check` shows the error of each
 * field and returns whether there is none; `fault` shows a refusal at its field and returns whether
 * it could; `asFor` returns whether a job has the chosen preset and options.
 */
export function optionsForm() {
  const id = `o${++forms}`;
  const preset = h("select", {}, Object.entries(PRESETS).map(([value, label]) =>
    h("option", { value, selected: value === "auto" }, label)));
  const groups = h("div");
  const rest = h("div", { class: "options" });
  const more = h("details", {}, h("summary", {}, "Expert options"), rest);
  const kept = h("p", { class: "hint" });
  const root = h("details", { class: "all" }, h("summary", {}, "Options"), groups, more, kept);
  const problem = h("p", { class: "problem", role: "alert" });
  root.append(problem);
  lacksGpu().then((isLacking) => {
    if (!isLacking) return;
    for (const name of FOR_GPUS) {
      const option = preset.querySelector(`[value=${name}]`);
      option.disabled = true;
      option.textContent = `${name}: needs a GPU, which this machine lacks`;
    }
  });
  let [fields, presets, wanted, unasked] = [[], null, null, {}];

  async function build() {
    /** @type {any} */
    let known = null;
    while (!known) {
      try {
        known = await load();
        problem.textContent = "";
      } catch (error) {
        problem.textContent = error.message;
        await new Promise((resolve) => { setTimeout(resolve, AGAIN_MS); });
        if (!root.isConnected) return;
      }
    }
    presets = known.presets;
    const make = (key) => field(id, key, resolve(known, known.properties[key]));
    const keys = Object.keys(known.properties).filter((key) => !UNASKED.includes(key));
    for (const [title, members] of Object.entries(GROUPS)) {
      const group = members.filter((key) => keys.includes(key)).map(make);
      fields.push(...group);
      groups.append(h("fieldset", {}, h("legend", {}, title), h("div", { class: "options" }, group.map((one) => one.root))));
    }
    const others = keys.filter((key) => !fields.some((one) => one.key === key)).map(make);
    fields.push(...others);
    rest.append(...others.map((one) => one.root));
    fillIn(wanted ?? {});
  }
  const built = build();

  /** Sets every field to the preset's value, except those in `options`. */
  function fillIn(options) {
    const usual = presets[preset.value];
    for (const one of fields) one.set(usual[one.key], options[one.key]);
    unasked = Object.fromEntries(UNASKED.filter((key) => key in options && options[key] !== usual[key]).map((key) => [key, options[key]]));
    const words = Object.entries(unasked).map(([key, value]) => `${optionName(key)} “${value}”`);
    kept.textContent = words.length > 0 ? `Kept from that job: ${words.join(", ")}.` : "";
  }
  preset.addEventListener("change", () => { if (presets) fillIn({}); });

  function fault(error) {
    const key = error.pointer?.match(/^\/options\/(.+)$/)?.[1];
    const one = fields.find((candidate) => candidate.key === key);
    for (const other of fields) other.say("");
    if (!one) return false;
    reveal(one);
    one.say(error.detail);
    one.focus();
    return true;
  }

  function reveal(one) {
    root.open = true;
    if (rest.contains(one.root)) more.open = true;
  }

  function check() {
    const wrong = fields.filter((one) => { one.say(one.wrong()); return one.wrong(); });
    wrong.forEach(reveal);
    wrong[0]?.focus();
    return wrong.length === 0;
  }

  const chosen = () => ({ ...unasked, ...Object.fromEntries(fields.filter((one) => one.differs()).map((one) => [one.key, one.value()])) });

  return {
    preset,
    root,
    fault,
    check,
    chosen,
    asFor(job) {
      if (!presets || job.preset !== preset.value) return false;
      const all = { ...presets[preset.value], ...chosen() };
      // The adapter only says where it ran.
      return Object.entries(all).every(([key, value]) => key === "adapter" || job.options[key] === value);
    },
    async fill(name, options) {
      preset.value = name;
      wanted = options;
      await built;
      if (presets) fillIn(options);
    },
  };
}

/** A property with its references resolved; a reference may have its own description beside it. */
function resolve(known, property) {
  const reference = property.$ref ?? property.allOf?.[0]?.$ref;
  if (!reference) return property;
  const target = known.$defs?.[reference.split("/").pop()] ?? {};
  return { ...target, ...property };
}

/** The words an option accepts, each with its meaning; `null` if it has none. */
function choices(property) {
  if (property.enum) return property.enum.map((value) => [value, ""]);
  const words = property.oneOf?.flatMap((one) => (one.const !== undefined
    ? [[one.const, one.description ?? ""]] : (one.enum ?? []).map((value) => [value, ""])));
  return words?.length > 0 ? words : null;
}

function field(form, key, property) {
  const id = `${form}-${key}`;
  const words = choices(property);
  const number = ["integer", "number"].includes(property.type);
  // A number within bounds, or a word.
  const orWord = property.anyOf?.find((one) => one.type === "integer" && one.maximum !== undefined);
  const word = orWord && property.anyOf.find((one) => one.const !== undefined)?.const;
  const bounds = orWord ?? property;
  const about = { id, "aria-describedby": `${id}-about ${id}-fault` };
  let input;
  if (property.type === "boolean") input = h("input", { type: "checkbox", ...about });
  else if (words) input = h("select", about, words.map(([value]) => h("option", { value }, plain(value))));
  else if (number) {
    const step = property.type === "integer" ? "1" : "any";
    input = h("input", { type: "number", step, min: property.minimum ?? "", max: property.maximum ?? "", ...about });
  } else input = h("input", { type: "text", spellcheck: false, autocomplete: "off", ...about });
  const problem = h("p", { class: "problem", id: `${id}-fault`, role: "alert" });
  const [least, most] = [bounds.minimum ?? 0, bounds.maximum ?? Number.MAX_SAFE_INTEGER].map((value) => value.toLocaleString("en"));
  const range = (number || orWord) && bounds.maximum !== undefined ? ` (${least} to ${most})` : "";
  const meaning = h("span", { class: "meaning" });
  const description = h("p", { class: "hint", id: `${id}-about` }, h("code", {}, key), ": ", prose((property.description ?? "") + range), meaning);
  const root = h("div", { class: "option" }, h("label", { htmlFor: id }, optionName(key)), input, description, problem);
  let usual = null;

  function value() {
    if (property.type === "boolean") return input.checked;
    const text = input.value.trim();
    // An empty field means the preset's value; a non-number is sent as it is, and refused.
    if (text === "") return usual;
    return (number || orWord) && Number.isFinite(Number(text)) ? Number(text) : text;
  }
  /** Its violation of the schema, in a sentence. */
  function wrong() {
    if (!(number || orWord) || (input.value.trim() === "" && !input.validity.badInput)) return "";
    if (word && input.value.trim() === word) return "";
    const now = Number(input.value);
    const isWhole = bounds.type !== "integer" || Number.isSafeInteger(now);
    const isWithin = now >= (bounds.minimum ?? 0) && now <= (bounds.maximum ?? Infinity);
    if (!input.validity.badInput && isWhole && isWithin) return "";
    const kind = bounds.type === "integer" ? "a whole number" : "a number";
    return `${optionName(key)}: enter ${kind} ${bounds.maximum === undefined ? `from ${least}` : `from ${least} to ${most}`}${word ? `, or ${word}` : ""}.`;
  }
  const differs = () => value() !== usual;
  function mark() {
    root.classList.toggle("changed", differs());
    const chosen = words?.find(([word]) => word === input.value)?.[1];
    // The rest is for readers of the paper.
    const [about] = (chosen ?? "").split("Differs from the paper");
    meaning.replaceChildren(...(about ? [h("b", {}, plain(input.value)), ": ", ...prose(about)] : []));
  }
  input.addEventListener("input", () => { mark(); say(""); });

  function say(text) {
    problem.textContent = text;
    if (text) input.setAttribute("aria-invalid", "true");
    else input.removeAttribute("aria-invalid");
  }
  return {
    key, root, value, differs, say, wrong,
    focus: () => input.focus(),
    /** Sets `now`, if given, else the preset's value. */
    set(presets, now) {
      usual = presets;
      if (property.type === "boolean") input.checked = now ?? usual;
      else input.value = String(now ?? usual);
      if (!words && property.type !== "boolean") input.placeholder = String(usual);
      say("");
      mark();
    },
  };
}
