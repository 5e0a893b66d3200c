// A reporter for `node --test`: the files of failed tests, one per line.

export default async function* failed(events) {
  for await (const { type, data } of events) if (type === "test:fail") yield `${data.file ?? data.name}\n`;
}
