// The request that creates a job like this one, to copy: curl, Python and JavaScript.

import { api, h } from "../lib/dom.js";

/**
 * The request in each language, once the job is over; the token is left out.
 * @param {import("fled-api").Job} job
 * @param {boolean} needsToken Whether the server requires a token.
 */
export async function requestOf(job, needsToken) {
  const { presets } = await api("v1/options");
  const usual = presets[job.preset] ?? {};
  const options = Object.entries(job.options)
    .filter(([key, value]) => JSON.stringify(value) !== JSON.stringify(usual[key]));
  const order = {
    capture_id: job.capture_id,
    preset: job.preset,
    options: Object.fromEntries(options),
    ...(job.name && { name: job.name }),
    ...(job.priority && { priority: job.priority }),
  };
  const url = new URL("v1/jobs", location.href).href;
  const texts = {
    curl: curl(url, order, needsToken),
    Python: python(url, order, needsToken),
    JavaScript: javaScript(url, order, needsToken),
  };
  const root = h("div", {},
    h("p", { class: "hint" }, "Starts a job of the same photographs with the same options. ",
      needsToken && "It takes the token from the variable FLED_TOKEN."),
    Object.entries(texts).map(([language, text], i) => h("details", { open: i === 0 },
      h("summary", {}, language),
      h("pre", { tabIndex: 0, "aria-label": language }, text),
      copy(language, text))));
  return Object.assign(root, { gist: Object.keys(texts).join(", ") });
}

function copy(language, text) {
  const button = h("button", {
    type: "button",
    class: "small",
    "aria-label": `Copy ${language}`,
    onclick: copied,
  }, "Copy");
  async function copied() {
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      // Without TLS a page may not use the clipboard; a selection can be copied by hand.
      getSelection().selectAllChildren(button.previousElementSibling);
      button.textContent = "Selected: copy it";
    }
  }
  return button;
}

/** A word of a shell. */
const quoted = (text) => `'${text.replaceAll("'", "'\\''")}'`;

function curl(url, order, needsToken) {
  const lines = [
    `curl ${quoted(url)}`,
    needsToken && '--header "Authorization: Bearer $FLED_TOKEN"',
    '--header "Content-Type: application/json"',
    `--data-raw ${quoted(JSON.stringify(order, null, 2))}`,
  ];
  return lines.filter(Boolean).join(" \\\n  ");
}

const PYTHON = { true: "True", false: "False", null: "None" };

/** A value in Python; a string of JSON is one of Python, too. */
function literal(value, indent = "") {
  const deeper = `${indent}    `;
  const block = (open, items, close) => {
    const lines = items.map((item) => `${deeper}${item},\n`).join("");
    return items.length === 0 ? open + close : `${open}\n${lines}${indent}${close}`;
  };
  if (Array.isArray(value)) return block("[", value.map((one) => literal(one, deeper)), "]");
  if (value !== null && typeof value === "object") {
    const pair = ([key, one]) => `${JSON.stringify(key)}: ${literal(one, deeper)}`;
    return block("{", Object.entries(value).map(pair), "}");
  }
  const text = JSON.stringify(value);
  return PYTHON[text] ?? text;
}

const TOKEN_IN_PYTHON = 'headers["Authorization"] = "Bearer " + os.environ["FLED_TOKEN"]\n';

const python = (url, order, needsToken) => `import json
${needsToken ? "import os\n" : ""}from urllib.request import Request, urlopen

order = ${literal(order)}
headers = {"Content-Type": "application/json"}
${needsToken ? TOKEN_IN_PYTHON : ""}address = ${JSON.stringify(url)}
request = Request(address, json.dumps(order).encode(), headers)
with urlopen(request) as answer:
    print(json.load(answer)["id"])
`;

const TOKEN_IN_JAVASCRIPT = "headers.Authorization = `Bearer ${process.env.FLED_TOKEN}`;\n";

const javaScript = (url, order, needsToken) => `const order = ${JSON.stringify(order, null, 2)};
const headers = { "Content-Type": "application/json" };
${needsToken ? TOKEN_IN_JAVASCRIPT : ""}const address = ${JSON.stringify(url)};
const body = JSON.stringify(order);
const answer = await fetch(address, { method: "POST", headers, body });
const job = await answer.json();
if (!answer.ok) throw new Error(job.detail);
console.log(job.id);
`;
