// Bundles the page's script and style into priv/static. `npm run build`; `npm run watch` rebuilds on change.
import * as esbuild from "esbuild";
import { mkdirSync, copyFileSync, readFileSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const out = new URL("../priv/static/", import.meta.url).pathname;
mkdirSync(out, { recursive: true });

const options = {
  entryPoints: [
    { in: "js/app.js", out: "studio" },
    { in: "css/studio.css", out: "studio" },
  ],
  bundle: true,
  alias: { situ_live: new URL("../../situ_live/assets/js/situ_live.js", import.meta.url).pathname },
  format: "iife",
  target: ["chrome110", "firefox115", "safari16"],
  minify: !process.argv.includes("--watch"),
  legalComments: "linked",
  logLevel: "warning",
  outdir: out,
};
// The 3D drawing code is a separate module that a page loads with its first 3D panel.
const space = {
  ...options,
  entryPoints: [{ in: "js/space/index.js", out: "space" }],
  format: "esm",
};
// The code that decodes compressed video is loaded with the first such stream.
const video = { ...space, entryPoints: [{ in: "js/video/index.js", out: "video" }] };
// The graph of a pipeline and its layout are loaded by the page that shows it.
const graph = { ...space, entryPoints: [{ in: "js/pipeline/graph.js", out: "graph" }] };
// The script of exported pages, which contains the data and the panels but no LiveView.
const offline = { ...options, entryPoints: [{ in: "js/offline/index.js", out: "offline" }] };
// The worker that computes spectra in its own thread.
const worker = {
  ...options,
  entryPoints: [{ in: "js/spectrogram/worker.js", out: "spectrogram-worker" }],
};
// The sensor and headset pages, and the code for the audio thread.
const sensor = {
  ...options,
  entryPoints: [
    { in: "js/sensor/index.js", out: "sensor" },
    { in: "js/sensor/worklet.js", out: "sensor-worklet" },
    { in: "js/headset/index.js", out: "headset" },
  ],
  format: "esm",
};
for (const f of ["favicon.svg", "theme.js"]) copyFileSync(new URL("css/" + f, import.meta.url).pathname, out + f);

if (process.argv.includes("--watch")) {
  for (const o of [options, space, video, graph, offline, worker, sensor]) await (await esbuild.context(o)).watch();
} else {
  await Promise.all([options, space, video, graph, offline, worker, sensor].map((o) => esbuild.build(o)));
  for (const f of [
    "studio.js",
    "studio.css",
    "theme.js",
    "space.js",
    "video.js",
    "graph.js",
    "spectrogram-worker.js",
    "sensor.js",
    "sensor-worklet.js",
    "headset.js",
  ])
    writeFileSync(out + f + ".gz", gzipSync(readFileSync(out + f), { level: 9 }));
}
