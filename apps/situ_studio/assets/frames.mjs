// Generates js/data/frames.js from the schema of the binary frames. `npm run frames` writes the file, and a test checks
// that it is up to date.
import { readFileSync, writeFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { format, resolveConfig } from "prettier";

const schema = new URL("../priv/frames.json", import.meta.url);
export const output = fileURLToPath(new URL("js/data/frames.js", import.meta.url));

// By type: the bytes, and the DataView's methods without "get" and "set".
const TYPES = {
  u8: [1, "Uint8"],
  u16: [2, "Uint16"],
  u32: [4, "Uint32"],
  i64: [8, "BigInt64"],
  f64: [8, "Float64"],
};

// Returns the fields with their offsets, and the size.
function placeFields(fields) {
  let at = 0;
  const placed = [];
  for (const [name, type] of fields) {
    if (name) placed.push({ name, type, offset: at, order: type === "u8" ? "" : ", true" });
    at += name ? TYPES[type][0] : type;
  }
  return { placed, size: at };
}

const plusOffset = (offset) => (offset ? `at + ${offset}` : "at");

function generateLayout(layout, fields) {
  const { placed, size } = placeFields(fields);
  const title = layout[0].toUpperCase() + layout.slice(1);
  const reads = placed.map(
    ({ name, type, offset, order }) => `${name}: view.get${TYPES[type][1]}(${plusOffset(offset)}${order}),`,
  );
  const writes = placed.map(
    ({ name, type, offset, order }) => `view.set${TYPES[type][1]}(${plusOffset(offset)}, fields.${name}${order});`,
  );
  return `
    export const ${layout.toUpperCase()}_BYTES = ${size};

    /** @param {DataView} view @param {number} at */
    export function read${title}(view, at) {
      return { ${reads.join("\n")} };
    }

    /** @param {DataView} view @param {number} at @param {ReturnType<typeof read${title}>} fields */
    export function write${title}(view, at, fields) {
      ${writes.join("\n")}
    }
  `;
}

// Returns the text of the generated file.
export async function generateFrames() {
  const { codes, layouts } = JSON.parse(readFileSync(schema, "utf8"));
  const text = [
    "// The headers, codes and flags of the binary frames. Generated from priv/frames.json by `npm run frames`.\n",
    ...Object.entries(codes).map(
      ([group, values]) => `export const ${group.toUpperCase()} = ${JSON.stringify(values)};`,
    ),
    ...Object.entries(layouts).map(([layout, fields]) => generateLayout(layout, fields)),
  ];
  return format(text.join("\n\n"), { ...(await resolveConfig(output)), filepath: output });
}

if (process.argv[1] === fileURLToPath(import.meta.url)) writeFileSync(output, await generateFrames());
