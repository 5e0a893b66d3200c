// The form of a job's options, made from `/v1/options`.

import { api, h, plain } from "../lib/dom.js";

/** What most people change; the rest is folded away. */
const COMMON = ["rounds", "steps", "size", "cap", "target", "held_out"];
const PRESETS = { preview: "preview: a quick look", standard: "standard", paper: "paper: for a GPU" };

/** After an answer that did not come. */
const AGAIN_MS = 3000;

let schema = null;

/** The schema does not change while a server runs. */
const load = () => (schema ??= api("/v1/options").catch((error) => { schema = null; throw error; }));

/** Our own words, with names between backticks. */
const prose = (text) => text.replaceAll(/\s+/g, " ").split("`").map((part, i) => (i % 2 ? h("code", {}, part) : part));

let forms = 0;

/**
 * Preset and options: `{ preset, root, chosen(), fault(error), fill(preset, options) }`. `chosen`
 * has only what differs from the preset; `fault` shows a refusal at its field and says whether it
 * could.
 */
export function optionsForm() {
  const id = `o${++forms}`;
  const preset = h("select", {}, Object.entries(PRESETS).map(([value, label]) =>
    h("option", { value, selected: value === "standard" }, label)));
  const common = h("div", { class: "options" });
  const rest = h("div", { class: "options" });
  const more = h("details", {}, h("summary", {}, "More options"), rest);
  const root = h("details", { class: "all" }, h("summary", {}, "Options"), common, more);
  const problem = h("p", { class: "problem", role: "alert" });
  root.append(problem);
  let [fields, presets, wanted] = [[], null, null];

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
    const keys = Object.keys(known.properties);
    const ordered = [...COMMON.filter((key) => keys.includes(key)), ...keys.filter((key) => !COMMON.includes(key))];
    fields = ordered.map((key) => field(id, key, resolve(known, known.properties[key])));
    for (const one of fields) (COMMON.includes(one.key) ? common : rest).append(one.root);
    fillIn(wanted ?? {});
  }
  const built = build();

  /** Every field at the preset's value, but for `options`. */
  function fillIn(options) {
    for (const one of fields) one.set(presets[preset.value][one.key], options[one.key]);
  }
  preset.addEventListener("change", () => { if (presets) fillIn({}); });

  function fault(error) {
    const key = error.pointer?.match(/^\/options\/(.+)$/)?.[1];
    const one = fields.find((candidate) => candidate.key === key);
    for (const other of fields) other.say("");
    if (!one) return false;
    root.open = true;
    if (!COMMON.includes(key)) more.open = true;
    one.say(error.detail);
    return true;
  }

  return {
    preset,
    root,
    fault,
    chosen: () => Object.fromEntries(fields.filter((one) => one.differs()).map((one) => [one.key, one.value()])),
    async fill(name, options) {
      preset.value = name;
      wanted = options;
      await built;
      if (presets) fillIn(options);
    },
  };
}

/** A property with what it refers to; a reference may stand beside words of its own. */
function resolve(known, property) {
  const reference = property.$ref ?? property.allOf?.[0]?.$ref;
  if (!reference) return property;
  const target = known.$defs?.[reference.split("/").pop()] ?? {};
  return { ...target, ...property };
}

/** The words that an option may have, with what each means; `null` where it has none. */
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
  const about = { id, "aria-describedby": `${id}-about ${id}-fault` };
  let input;
  if (property.type === "boolean") input = h("input", { type: "checkbox", ...about });
  else if (words) input = h("select", about, words.map(([value]) => h("option", { value }, plain(value))));
  else if (number) {
    const step = property.type === "integer" ? "1" : "any";
    input = h("input", { type: "number", step, min: property.minimum ?? "", max: property.maximum ?? "", ...about });
  } else input = h("input", { type: "text", spellcheck: false, autocomplete: "off", ...about });
  const problem = h("p", { class: "problem", id: `${id}-fault`, role: "alert" });
  const range = number && property.maximum !== undefined ? ` (${(property.minimum ?? 0).toLocaleString()} to ${property.maximum.toLocaleString()})` : "";
  const meaning = h("span", { class: "meaning" });
  const description = h("p", { class: "hint", id: `${id}-about` }, prose((property.description ?? "") + range), meaning);
  const root = h("div", { class: "option" }, h("label", { htmlFor: id }, plain(key)), input, description, problem);
  let usual = null;

  function value() {
    if (property.type === "boolean") return input.checked;
    const text = input.value.trim();
    // An empty field is the preset's value; what is no number goes as it is, and the server says so.
    if (text === "") return usual;
    return number && Number.isFinite(Number(text)) ? Number(text) : text;
  }
  const differs = () => value() !== usual;
  function mark() {
    root.classList.toggle("changed", differs());
    const chosen = words?.find(([word]) => word === input.value)?.[1];
    // What follows is for those who know the paper.
    const [about] = (chosen ?? "").split("Differs from the paper");
    meaning.replaceChildren(...(about ? [h("b", {}, plain(input.value)), ": ", ...prose(about)] : []));
  }
  input.addEventListener("input", () => { mark(); say(""); });

  function say(text) {
    problem.textContent = text;
    if (text) { input.setAttribute("aria-invalid", "true"); input.focus(); } else input.removeAttribute("aria-invalid");
  }
  return {
    key, root, value, differs, say,
    /** `now` over the preset's value, where there is one. */
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
