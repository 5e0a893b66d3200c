// A reporter for `node --test`: the files of failed tests, one per line. A test that a helper defines has the helper's
// file, so the file comes from the stack of its error; without one there, a name that no file has fails the next run.

const IN_STACK = /[^\s(]*\.test\.js/;

function fileOf({ file, name, details }) {
  const named = [file, name].find((path) => path?.endsWith(".test.js"));
  const error = details?.error;
  const stack = [error?.cause?.stack, error?.stack].map((text) => IN_STACK.exec(text ?? "")?.[0]?.replace("file://", ""));
  return named ?? stack.find(Boolean) ?? "the file of a failed test is unknown.test.js";
}

export default async function* failed(events) {
  for await (const { type, data } of events) if (type === "test:fail") yield `${fileOf(data)}\n`;
}
