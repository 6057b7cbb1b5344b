// node bundle.mjs OUT: bundles the test code: OUT/app.js for the page, OUT/rendered.mjs for Node.
import * as esbuild from "esbuild";
import { fileURLToPath } from "node:url";
import path from "node:path";

const here = path.dirname(fileURLToPath(import.meta.url));
const out = process.argv[2];
await esbuild.build({
  entryPoints: [path.join(here, "app.js")],
  bundle: true,
  outfile: path.join(out, "app.js"),
  logLevel: "error",
});
await esbuild.build({
  entryPoints: [path.join(here, "rendered.mjs")],
  bundle: true,
  platform: "node",
  format: "esm",
  banner: { js: "globalThis.window = globalThis;" },
  outfile: path.join(out, "rendered.mjs"),
  logLevel: "error",
});
