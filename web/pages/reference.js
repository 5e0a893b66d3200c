// The API reference, made from openapi.json: each path's purpose, parameters and responses.

import { api, h } from "../lib/dom.js";

const METHODS = ["get", "post", "put", "patch", "delete", "head", "options"];

export function referencePage(main) {
  const content = h("div", {}, h("p", { class: "hint" }, "Loading…"));
  main.append(h("section", {}, h("h1", {}, "API"),
    h("p", { class: "hint" }, "All endpoints of this server. Machine-readable: ",
      h("a", { href: "openapi.json" }, "openapi.json"), ", ", h("a", { href: "openapi.yaml" }, "openapi.yaml"), "."),
    content));
  let gone = false;
  api("openapi.json").then((document) => {
    if (!gone) content.replaceChildren(...groups(document));
  }, (error) => {
    content.replaceChildren(h("p", { class: "problem", role: "alert" }, error.message));
  });
  return () => { gone = true; };
}

/** A heading and its operations for each tag, in the order of the document. */
function groups(document) {
  const byTag = new Map();
  for (const [path, item] of Object.entries(document.paths)) {
    for (const method of METHODS.filter((method) => item[method])) {
      const operation = item[method];
      const tag = operation.tags?.[0] ?? "other";
      if (!byTag.has(tag)) byTag.set(tag, []);
      byTag.get(tag).push(entry(document, method, path, operation, item.parameters ?? []));
    }
  }
  return [...byTag].flatMap(([tag, entries]) => [h("h2", {}, tag), ...entries]);
}

function entry(document, method, path, operation, shared) {
  const words = [operation.summary, operation.description].filter(Boolean).join("\n");
  const parameters = [...shared, ...(operation.parameters ?? [])].map((parameter) => resolved(document, parameter));
  return h("details", { class: "operation" },
    h("summary", {}, h("code", { class: "method" }, method.toUpperCase()), " ", h("code", {}, path), " ",
      h("span", { class: "soft" }, operation.summary ?? "")),
    h("p", {}, words),
    parameters.length > 0 && table("Parameters", parameters.map((parameter) => [
      parameter.name, parameter.in, kind(document, parameter.schema), parameter.description ?? ""])),
    bodies(document, operation.requestBody),
    table("Responses", Object.entries(operation.responses).map(([status, answer]) => {
      const { description, content } = resolved(document, answer);
      return [status, media(document, content), "", description];
    })));
}

function bodies(document, body) {
  if (!body) return false;
  const { content, required } = resolved(document, body);
  const rows = Object.entries(content).flatMap(([type, { schema }]) => {
    const fields = properties(document, schema);
    const whole = [type, required ? "required" : "", kind(document, schema), resolved(document, schema)?.description ?? ""];
    return [whole, ...fields.map(([name, field, needed]) => [
      `  ${name}`, needed ? "required" : "", kind(document, field), resolved(document, field).description ?? field.description ?? ""])];
  });
  return table("Request body", rows);
}

/** The fields of an object: `[name, schema, isRequired]`. */
function properties(document, schema) {
  const whole = resolved(document, schema ?? {});
  const parts = [whole, ...(whole.oneOf ?? []), ...(whole.allOf ?? [])].map((part) => resolved(document, part));
  return parts.flatMap((part) => Object.entries(part.properties ?? {})
    .map(([name, field]) => [name, field, part.required?.includes(name) ?? false]));
}

const media = (document, content) => Object.entries(content ?? {})
  .map(([type, { schema }]) => [type, kind(document, schema)].filter(Boolean).join(": ")).join(", ");

function resolved(document, part) {
  if (!part?.$ref) return part ?? {};
  return part.$ref.split("/").slice(1).reduce((at, name) => at?.[name.replaceAll("~1", "/")], document) ?? {};
}

/** The type of a value, in a word or two. */
function kind(document, schema) {
  if (!schema) return "";
  if (schema.$ref) return schema.$ref.split("/").pop();
  if (schema.enum) return schema.enum.map((value) => JSON.stringify(value)).join(" | ");
  if (schema.oneOf) return schema.oneOf.map((one) => kind(document, one)).join(" | ");
  if (schema.type === "array") return `list of ${kind(document, schema.items) || "anything"}`;
  const type = [schema.type].flat().filter(Boolean).join(" | ");
  return schema.format ? `${type}, ${schema.format}` : type;
}

function table(title, rows) {
  return h("div", { class: "scroll" }, h("table", {}, h("caption", {}, title),
    h("tbody", {}, rows.map((row) => h("tr", {}, row.map((text, at) => h("td", {}, at === 0 ? h("code", {}, text) : text)))))));
}
