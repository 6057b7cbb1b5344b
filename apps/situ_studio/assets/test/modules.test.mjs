// Checks the page's modules and style sheets: no import cycles, and a limited length.
import test from "node:test";
import { readFileSync, readdirSync } from "node:fs";
import assert from "node:assert/strict";
import { build } from "esbuild";
import { fileURLToPath } from "node:url";

const folder = fileURLToPath(new URL("..", import.meta.url));
const MOST_LINES = 300;

async function readImports() {
  const { metafile } = await build({
    entryPoints: [
      "js/app.js",
      "js/space/index.js",
      "js/pipeline/graph.js",
      "js/sensor/index.js",
      "js/headset/index.js",
    ],
    outdir: "out",
    absWorkingDir: folder,
    alias: { situ_live: fileURLToPath(new URL("../../../situ_live/assets/js/situ_live.js", import.meta.url)) },
    bundle: true,
    metafile: true,
    write: false,
    logLevel: "silent",
  });
  const own = Object.entries(metafile.inputs).filter(([path]) => path.startsWith("js/"));
  return new Map(
    own.map(([path, { imports }]) => [path, imports.map((i) => i.path).filter((p) => p.startsWith("js/"))]),
  );
}

// Returns the first cycle found as a path, or null.
export function findCycle(graph) {
  const done = new Set();
  const visitNode = (node, way) => {
    if (way.includes(node)) return [...way.slice(way.indexOf(node)), node];
    if (done.has(node)) return null;
    for (const next of graph.get(node) ?? []) {
      const found = visitNode(next, [...way, node]);
      if (found) return found;
    }
    done.add(node);
    return null;
  };
  for (const node of graph.keys()) {
    const found = visitNode(node, []);
    if (found) return found;
  }
  return null;
}

test("an import cycle is found", () => {
  assert.deepEqual(
    findCycle(
      new Map([
        ["a", ["b"]],
        ["b", ["c"]],
        ["c", ["b"]],
      ]),
    ),
    ["b", "c", "b"],
  );
  assert.equal(
    findCycle(
      new Map([
        ["a", ["b", "c"]],
        ["b", ["c"]],
        ["c", []],
      ]),
    ),
    null,
  );
});

test("the page's modules have no import cycle", async () => {
  const graph = await readImports();
  assert.ok(graph.size > 30);
  assert.equal(findCycle(graph)?.join(" -> ") ?? null, null);
});

test("no module and no style sheet exceeds the maximum length", async () => {
  const styles = readdirSync(folder + "css").map((name) => "css/" + name);
  for (const path of [...(await readImports()).keys(), ...styles.filter((name) => name.endsWith(".css"))]) {
    const lines = readFileSync(folder + path, "utf8").split("\n");
    assert.ok(lines.length <= MOST_LINES, `${path} has ${lines.length} lines`);
    const long = lines.findIndex((l) => l.length > 140);
    assert.equal(long, -1, `${path}:${long + 1} is too long`);
  }
});
